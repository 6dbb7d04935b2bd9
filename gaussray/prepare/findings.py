"""What the checks say about an input: good, doubtful or unusable, with what to do about it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.exposure import LEAST_SHARED
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.lens_check import is_unreadable, lens_complaint
from gaussray.prepare.lens_models import lens_fov
from gaussray.prepare.options import SyncOptions
from gaussray.prepare.poses import Placement
from gaussray.prepare.sources import Source
from gaussray.prepare.sparse_model import camera_centres, observations_by_picture
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import Timeline, of_one_rate, resampled


# Pixels, for each 1000 pixels of width, above which reprojection and epipolar errors are doubtful
# or, with known cameras, show another calibration.
DOUBTFUL_ERROR, DOUBTFUL_LINES, WRONG_LINES = 1.5, 3.0, 25.0
# Matches of a pair that prove something: wide baselines give some twenty that are all wrong.
EVIDENCE = 40
# Fewest observations of a picture, share of pictures that must be registered, stops of exposure.
OBSERVATIONS, REGISTERED, STOPS = 100, 0.5, 0.15
# Angle in degrees between a camera and its next neighbour, seen from the middle of the points.
APART = 45.0
# Focal lengths of cameras whose pictures have one size may differ by this share.
_FOCALS = 0.15


class Finding(NamedTuple):
    """One result of a check.

    Args:
        level: `good`, `warn` or `refuse`.
        subject: what it is about: sync, cameras, lens, points, epipolar lines, exposure.
        text: what was found.
        remedy: what to do about it; empty if nothing.
    """

    level: str
    subject: str
    text: str
    remedy: str = ""


def sync_findings(
    sources: Sequence[Source], sync: Sync, timeline: Timeline, options: SyncOptions
) -> list[Finding]:
    """Confidence of the offsets, rates that differ, and pictures that are not used.

    Args:
        sources: cameras of the input.
        sync: offsets of their clocks, with confidence and disagreement.
        timeline: rate of the timestamps; disagreements above half a frame are reported.
        options: the confidence from which on an offset is trusted.
    """
    findings = []
    videos = [source.name for source in sources if source.is_video]
    weak = [name for name in videos if sync.confidence[name] < options.trust]
    if sync.method not in ("none", "known") and len(videos) > 1:
        by = f"by {sync.method}, confidence {min(sync.confidence[n] for n in videos):.2f} or more"
        if not weak:
            findings.append(Finding("good", "sync", f"all videos are synchronised {by}"))
        else:
            findings.append(
                Finding(
                    "warn",
                    "sync",
                    f"{', '.join(weak)}: no trusted synchronisation by {sync.method}; taken to "
                    "start with the first camera",
                    "If they do not, give sync.offsets=[...]; fit.refine=[offset] refines what is "
                    "off by less than a few frames.",
                )
            )
    elif len(videos) > 1:
        text = "the videos start together" if sync.method == "none" else "the offsets are given"
        findings.append(Finding("good", "sync", text))
    off = {n: d for n, d in sync.disagreement.items() if d > 0.5 / max(timeline.rate, 1)}
    if off:
        findings.append(
            Finding(
                "warn",
                "sync",
                f"pairs of cameras disagree by {1000 * max(off.values()):.0f} ms about "
                f"{', '.join(off)}",
                "Look at a fast event in each video; give sync.offsets=[...] if they are off.",
            )
        )
    # Videos of one rate show every frame that they were asked for.
    if not of_one_rate(sources) and (names := resampled(sources, timeline)):
        findings.append(
            Finding(
                "warn",
                "sync",
                f"{', '.join(names)} show their nearest frames at {timeline.rate:.4g} per second; "
                "the remaining shift of each frame is recorded as the delay of its shutter",
                "Record all cameras at one rate to use all their frames.",
            )
        )
    folders = [source for source in sources if not source.is_video]
    left = {s.name: s.count - len(np.unique(timeline.frames[s.name])) for s in folders}
    # Otherwise it is the user's own choice of times.
    if any(left.values()) and len({source.count for source in folders}) > 1:
        told = ", ".join(f"{count} of {name}" for name, count in left.items() if count)
        findings.append(
            Finding(
                "warn",
                "sync",
                f"pictures that are not used: {told}; folders of pictures are cameras that take "
                f"pictures at the same times, and all of them have {len(timeline.times)}",
                "Give each folder as many. Photographs of a still scene belong in one folder, "
                "whatever their sizes.",
            )
        )
    return findings


def camera_findings(placement: Placement) -> list[Finding]:
    """Registered pictures, and the angles between neighbours."""
    model = placement.model
    total, found = len(placement.pictures), len(model.pictures)
    missing = [p for f, p in placement.pictures.items() if f not in model.pictures]
    remedy = (
        "Add cameras between their neighbours, or pictures with more texture; poses.features=16384 "
        "and frames.instants=10 find more matches; poses.fov=DEGREES if you know the lens; or give "
        "a calibration."
    )
    if found < max(2, REGISTERED * total):
        text = f"only {found} of {total} pictures have a pose"
        return [Finding("refuse", "cameras", text, remedy)]
    if missing:
        names = ", ".join(picture_name(p, placement) for p in missing[:8])
        text = f"{found} of {total} pictures have a pose; left out: {names}"
        findings = [Finding("warn", "cameras", text, remedy)]
    else:
        kind = "a calibrated" if placement.known else "a"
        findings = [Finding("good", "cameras", f"all {total} pictures have {kind} pose")]
    if len(model.points) and found > 1:
        apart = neighbour_angles(placement)
        cameras = [placement.pictures[file].camera for file in model.pictures]
        apart = np.where([camera in placement.still for camera in cameras], apart, 0)
        far = np.flatnonzero(apart > APART)
        if len(far):
            names = ", ".join(cameras[k] for k in far)
            findings.append(
                Finding(
                    "warn",
                    "cameras",
                    f"{names}: the next camera is {np.max(apart):.0f} degrees away, seen from the "
                    "middle of the points; surfaces between them are guessed",
                    "Place cameras 15 to 30 degrees from each other.",
                )
            )
    return findings


def lens_findings(placement: Placement) -> list[Finding]:
    """Lenses that no camera has; focal lengths that differ between like cameras."""
    findings, focals, complaints = [], {}, {}
    lenses = camera_lenses(placement)
    for name, lens in lenses.items():
        focals.setdefault((lens["w"], lens["h"]), {})[name] = lens["fl_x"]
        complaints.setdefault(lens_complaint(lens), []).append(name)
    for (level, reason), names in complaints.items():
        listed = ", ".join(names[:8]) + ("..." if len(names) > 8 else "")
        if level and placement.known:
            unread = any(is_unreadable(lenses[name]) for name in names)
            findings.append(_calibrated_lens(listed, reason, unread))
        elif level:
            findings.append(
                Finding(
                    level,
                    "lens",
                    f"{listed}: estimated {reason}",
                    "Estimate less: poses.intrinsics=shared poses.model=pinhole; give the rough "
                    "field of view in degrees, poses.fov=70; or give a calibration.",
                )
            )
    for same in focals.values():
        spread = max(same.values()) / min(same.values()) - 1
        if spread > _FOCALS and not placement.known:
            low, high = min(same, key=same.get), max(same, key=same.get)
            text = (
                f"the focal lengths of {low} ({same[low]:.4g} pixels) and {high} "
                f"({same[high]:.4g}) differ although their pictures have one size"
            )
            remedy = "If the cameras are alike, poses.intrinsics=shared."
            findings.append(Finding("warn", "lens", text, remedy))
    fovs = [round(lens_fov(lens)) for lens in lenses.values()]
    across = f"{min(fovs)}" if min(fovs) == max(fovs) else f"{min(fovs)} to {max(fovs)}"
    if placement.model.focal_source == "guess":
        text = (
            "the pictures do not tell the focal length: one 20 % shorter or longer explains them "
            f"as well; {across} degrees across the width are a guess"
        )
        remedy = "If you know the lens, poses.fov=DEGREES; or give a calibration."
        findings.append(Finding("warn", "lens", text, remedy))
    if not findings:
        text = f"horizontal fields of view of {across} degrees"
        if placement.model.focal_source == "expected":
            text += ", as expected: the pictures do not tell"
        findings.append(Finding("good", "lens", text))
    return findings


def _calibrated_lens(names: str, reason: str, unread: bool) -> Finding:
    """The finding about an unusual lens of a calibration, which is refused only if readers refuse
    it."""
    remedy = "Check that the file is of this camera, zoom and picture size."
    if "turns back within" in reason:
        remedy += " Calibrate again with the board at the edges, too"
        remedy += ", or take the video away." if unread else "; these pixels do not count."
    return Finding(
        "refuse" if unread else "warn", "lens", f"{names}: the calibration has {reason}", remedy
    )


def point_findings(placement: Placement) -> list[Finding]:
    """Reprojection errors and numbers of observations."""
    model = placement.model
    if not len(model.points):
        text = "no point is seen by two cameras"
        remedy = (
            "The capture then starts from points on pictures alone (docs/reconstruction.md); check "
            "by the epipolar lines that calibration and videos belong together."
        )
        return [Finding("warn", "points", text, remedy)]
    shown = [placement.pictures[file] for file in model.pictures]
    counts = zip(shown, observations_by_picture(model), strict=True)
    few = [picture_name(p, placement) for p, count in counts if count < OBSERVATIONS]
    scale = max(lens["w"] for lens in model.lenses) / 1000
    median = float(np.median(model.observations.error))
    findings = []
    if median > DOUBTFUL_ERROR * scale:
        text = f"the median reprojection error is {median:.2f} pixels"
        remedy = "fit.refine=[pose,lens] may repair it; look at the epipolar lines first."
        findings.append(Finding("warn", "points", text, remedy))
    if few:
        names = ", ".join(few[:8]) + ("..." if len(few) > 8 else "")
        findings.append(
            Finding(
                "warn",
                "points",
                f"{names}: fewer than {OBSERVATIONS} observations; the pose is weak",
                "Cameras closer to each other, larger pictures, more texture; frames.instants=10.",
            )
        )
    if not findings:
        text = f"{len(model.points)} points, median reprojection error {median:.2f} pixels"
        findings.append(Finding("good", "points", text))
    return findings


def epipolar_findings(placement: Placement, pairs: Sequence[EpipolarPair]) -> list[Finding]:
    """Distances of matches from the epipolar lines; the test of a known calibration.

    Args:
        placement: lenses, and whether they come from a calibration.
        pairs: pairs of pictures; those with fewer than `EVIDENCE` matches do not count.
    """
    scale = max((lens["w"] for lens in placement.model.lenses), default=1000) / 1000
    known = [pair for pair in pairs if np.isfinite(pair.median) and pair.count >= EVIDENCE]
    if not known:
        text = "no two pictures share enough matches to test the poses"
        remedy = "Check by eye that the drawn lines pass through the same things, if there are any."
        return [Finding("warn", "epipolar lines", text, remedy)]
    typical = float(np.median([pair.median for pair in known]))
    text = f"matches are {typical:.2f} pixels from their epipolar lines (median of the pairs)"
    if typical > WRONG_LINES * scale and placement.known:
        remedy = (
            "The calibration is not of these pictures: check the order of the cameras, their "
            "names, zoom, and that no camera was moved since."
        )
        return [Finding("refuse", "epipolar lines", text, remedy)]
    if typical > DOUBTFUL_LINES * scale:
        if placement.known:
            text += "; compare the result without poses.calibration"
        remedy = "fit.refine=[pose,lens] may repair it; a new calibration is better."
        return [Finding("warn", "epipolar lines", text, remedy)]
    return [Finding("good", "epipolar lines", text)]


def exposure_findings(gains: dict[str, tuple[np.ndarray, int]]) -> list[Finding]:
    """Differences of brightness between cameras."""
    known = {name: gain for name, (gain, count) in gains.items() if count >= LEAST_SHARED}
    if len(known) < 2:
        text = "too few shared points to compare the cameras' exposures"
        remedy = "fit.refine=[exposure] if pictures of one thing differ in brightness."
        return [Finding("warn", "exposure", text, remedy)] if len(gains) > 1 else []
    worst = max(known, key=lambda name: np.abs(known[name]).max())
    size = float(np.abs(known[worst]).max())
    if size > STOPS:
        text = f"{worst} differs from the mean of all cameras by up to {size:.2f} stops"
        remedy = "fit.refine=[exposure]; better: lock exposure and white balance when recording."
        return [Finding("warn", "exposure", text, remedy)]
    return [Finding("good", "exposure", f"cameras agree to {size:.2f} stops")]


def picture_name(picture: MatchingPicture, placement: Placement) -> str:
    """What messages call a picture. A camera that stands still has one pose, for which its name
    stands; a photograph is called as its file, with its camera if there are several.

    Args:
        picture: one of the placement.
        placement: the cameras that stand still, and all pictures.
    """
    if picture.camera in placement.still:
        return picture.camera
    if not picture.photograph:
        return f"{picture.camera} {picture.instant}"
    alone = len({other.camera for other in placement.pictures.values()}) == 1
    return picture.photograph if alone else f"{picture.camera}/{picture.photograph}"


def camera_lenses(placement: Placement) -> dict[str, dict]:
    """The lens of each registered camera by name."""
    model = placement.model
    return {
        placement.pictures[file].camera: lens
        for file, lens in zip(model.pictures, model.lenses, strict=True)
    }


def picture_errors(placement: Placement) -> dict[str, tuple[int, float, float]]:
    """Observations, median and 90th percentile of the errors in pixels, by camera."""
    seen, model = placement.model.observations, placement.model
    names = [placement.pictures[file].camera for file in model.pictures]
    result = {}
    for name in dict.fromkeys(names):
        mine = np.isin(seen.picture, [k for k, other in enumerate(names) if other == name])
        error = seen.error[mine]
        middle, high = np.percentile(error, [50, 90]) if len(error) else (np.nan, np.nan)
        pictures = names.count(name)
        result[name] = len(error) // pictures, float(middle), float(high)
    return result


def neighbour_angles(placement: Placement) -> np.ndarray:
    """For each picture the angle in degrees to the next one, seen from the middle of the points."""
    centres = camera_centres(placement.model)
    middle = np.median(placement.model.points, axis=0)
    direction = centres - middle
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    cosine = np.clip(direction @ direction.T, -1, 1)
    np.fill_diagonal(cosine, -1)
    return np.degrees(np.arccos(cosine.max(axis=1)))
