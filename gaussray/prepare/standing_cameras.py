"""Which cameras stand still: by the options, or by whether their pictures show the same places."""

from collections.abc import Sequence
from pathlib import Path

from gaussray.prepare import features, merging
from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.options import PrepareOptions
from gaussray.prepare.timeline import Timeline
from gaussray.runtime.output import first_of
from gaussray.runtime.progress import say


# A camera stands still if so large a share of its picture stays where it is (`staying_share`), and
# moves if at most so small a share does; fewer features that timestamps share tell nothing.
_STILL, _MOVING, _TELLING = 0.5, 0.2, 30


def standing_by_options(
    everyone: frozenset[str],
    timeline: Timeline,
    known: dict[str, KnownCamera] | None,
    options: PrepareOptions,
) -> frozenset[str] | None:
    """The cameras that stand still by the options and the calibration; None if their pictures must
    tell.

    Args:
        everyone: all cameras.
        timeline: the capture's timestamps; photographs are of cameras that move.
        known: calibrated cameras, None to estimate them.
        options: options of the poses (`poses.rig`).
    """
    if timeline.is_static or options.poses.rig == "moving":
        return frozenset()
    if options.poses.rig == "still" or known is not None or len(timeline.times) == 1:
        return everyone
    return None


def standing_cameras(
    database: Path, written: Sequence[MatchingPicture], seed: int
) -> frozenset[str] | None:
    """The cameras that show their first picture again in the middle one and in the last one; None
    if that cannot be told of any camera.

    Most of the cameras decide about one whose own pictures do not: of which hardly a feature is
    found again, as where most of a picture moves, or half of them stay.

    Args:
        database: COLMAP database with the features, which gets the matches of these pictures.
        written: the pictures, in the order of time.
        seed: for the verification of matches.
    """
    shown: dict[str, list[MatchingPicture]] = {}
    for picture in written:
        shown.setdefault(picture.camera, []).append(picture)
    pairs = {
        name: [(own[0].file, other.file) for other in {own[len(own) // 2], own[-1]} - {own[0]}]
        for name, own in shown.items()
    }
    features.match_features(database, sorted(sum(pairs.values(), [])), seed)
    keypoints = features.read_keypoints(database, written)
    matches = features.raw_matches(database)
    shares: dict[str, float | None] = {}
    for name, own in pairs.items():
        found = [
            merging.staying_share(keypoints[a], keypoints[b], rows, shown[name][0].size)
            for a, b in own
            if (rows := matches.get((a, b))) is not None and len(rows) >= _TELLING
        ]
        shares[name] = min(found, default=None)
    known = [share for share in shares.values() if share is not None]
    if not known:
        return None
    most = 2 * sum(share >= _STILL for share in known) >= len(known)

    def stands_still(share: float | None) -> bool:
        return most if share is None or _MOVING < share < _STILL else share >= _STILL

    return frozenset(name for name, share in shares.items() if stands_still(share))


def tell_standing(found: frozenset[str] | None, everyone: frozenset[str]) -> None:
    """Say which cameras stand still, by their pictures, and how to say otherwise.

    Args:
        found: the cameras that stand still; None if the pictures do not tell.
        everyone: all cameras.
    """
    if found is None:
        say(
            "The pictures of no camera share enough features to tell whether it stands still: all "
            "are taken to move (poses.rig=still: they do not)."
        )
    elif found == everyone:
        say("By their pictures, all cameras stand still (poses.rig=moving: they do not).")
    elif not found:
        say("By their pictures, all cameras move (poses.rig=still: they do not).")
    else:
        say(
            f"By their pictures, cameras stand still ({first_of(sorted(found))}) or move "
            f"({first_of(sorted(everyone - found))}). If only what they show moves, set "
            "poses.rig=still."
        )
