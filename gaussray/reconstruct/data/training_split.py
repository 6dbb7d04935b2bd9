"""Which pictures of a capture a scene is fitted to, and which are held out to score it."""

from collections.abc import Sequence
from shlex import quote

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureError


# Cameras that a sentence names; more are counted.
_NAMED = 4
_SAME_PICTURES = (
    "Give it capture.crop, scale, background and clip_start, if they are set, as truth_crop, ..."
)


def demand_training_pictures(capture: Capture, frames: Sequence[int] = ()) -> None:
    """Refuse a capture without a picture to fit a scene to.

    Args:
        capture: the capture.
        frames: what capture.frames was set to; empty for all instants.

    Raises:
        CaptureError: No pinhole view is of split `train`.
    """
    if any(view.split == "train" for view in capture.views):
        return
    held = len(capture.views)
    if held:
        others = "capture.test=[CAMERA] holds out a camera by its name."
        if _has_one_camera(capture, frames):
            others = f"its single camera cannot be held out. {_instants(capture, frames)}".rstrip()
        raise CaptureError(
            f"{capture.folder}: there must be pictures to fit a scene to, but "
            f"{'the only one is' if held == 1 else f'all {held} are'} held out (split test). "
            f"capture.test=[] fits all of them, and {others}"
        )
    effects = sum(len(views) for views in capture.effects.values())
    also = f" Its {effects} pictures of camera effects only score a scene." if effects else ""
    raise CaptureError(
        f"{capture.folder}: there must be pictures to fit a scene to, but it has no pinhole "
        f"pictures.{also} Add frames to transforms.json."
    )


def division_sentence(capture: Capture, chosen: bool, frames: Sequence[int] = ()) -> str:
    """How many pictures are fitted and how many held out, why, and how to change that.

    Args:
        capture: the capture, of which some pictures are for training.
        chosen: whether capture.test was set; otherwise the capture's format decides.
        frames: what capture.frames was set to; empty for all instants.
    """
    held = [view for view in capture.views if view.split != "train"]
    fitted = len(capture.views) - len(held)
    if not held and _has_one_camera(capture, frames):
        told = f"Fits all {fitted} pictures of a single camera. {_instants(capture, frames)}"
        return told.rstrip()
    if not held:
        told = (
            f"Fits all {fitted} pictures. None is held out to score the scene; "
            "capture.test=[CAMERA] holds out a camera."
        )
        between = _instants(capture, frames) if frames and frames[2] > 1 else ""
        return f"{told} Without that, {between}" if between else told
    names = list(dict.fromkeys(view.camera_name for view in held))
    listed = ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
    why = "as capture.test says" if chosen else "as the capture's format or files say"
    return (
        f"Fits {fitted} of {len(capture.views)} pictures and holds out {len(held)} to score the "
        f"scene by `gaussray evaluate` ({'camera' if len(names) == 1 else 'cameras'} {listed}), "
        f"{why}. capture.test=[] fits all, capture.test=[CAMERA, ...] holds out others."
    )


def _has_one_camera(capture: Capture, frames: Sequence[int]) -> bool:
    """Whether all pictures are of one camera, at three instants or more, or at those that were
    chosen of its instants."""
    views = capture.views
    several = len({view.time for view in views}) > 2
    return len({view.camera_name for view in views}) == 1 and (several or len(frames) > 0)


def _instants(capture: Capture, frames: Sequence[int]) -> str:
    """How instants are held out where a camera cannot be; empty if none is between fitted ones.

    Args:
        capture: a capture.
        frames: first, last and step of the instants that are fitted; empty for all of them.
    """
    first, last, step = frames or (0, -1, 1)
    fewer = max(step, 2)
    # Halfway: next to an instant that was fitted the scene looks better than in between.
    middle = first + fewer // 2
    if 0 <= last < middle:
        return ""
    score = (
        f"`gaussray evaluate scene=OUT {quote(f'truth={capture.folder}')} "
        f"truth_frames=[{middle},{last},{fewer}] evaluate.split=all`"
    )
    if step > 1:
        return f"{score} scores the scene at instants in between. {_SAME_PICTURES}"
    return (
        f"To hold out every other instant, set capture.frames=[{first},{last},2]; then {score} "
        f"scores the scene at the others. {_SAME_PICTURES}"
    )
