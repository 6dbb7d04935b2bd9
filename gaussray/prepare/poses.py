"""Features, matches, then poses: estimated, or known and triangulated."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from gaussray.prepare import features, merging
from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.mapping import estimate_poses, triangulate, verify
from gaussray.prepare.media import write_matching_pictures
from gaussray.prepare.options import PrepareOptions
from gaussray.prepare.sources import Source
from gaussray.prepare.sparse_model import SparseModel
from gaussray.prepare.timeline import Timeline


# With known cameras, points may be so many pixels off for each 1000 pixels of width: enough to show
# a calibration that does not fit.
_KNOWN_ERROR = 8.0


@dataclasses.dataclass(frozen=True, eq=False)
class Placement:
    """What matching and mapping have found.

    Args:
        model: Poses, lenses and points of the registered pictures.
        pictures: Camera and timestamp of every picture that was matched, by file. Of a camera that
            stands still it is the first timestamp; `keypoints` say which feature is of which.
        keypoints: Keypoints by file.
        matches: Verified matches by pair of files.
        still: The cameras stand still.
        known: Poses and lenses come from a calibration.
    """

    model: SparseModel
    pictures: dict[str, MatchingPicture]
    keypoints: dict[str, Keypoints]
    matches: dict[tuple[str, str], Int[np.ndarray, "m 2"]]
    still: bool
    known: bool


def find_poses(
    sources: Sequence[Source],
    timeline: Timeline,
    files: dict[str, list[Path]],
    known: dict[str, KnownCamera] | None,
    work: Path,
    options: PrepareOptions,
) -> Placement:
    """Poses, lenses and points of the cameras.

    Cameras that stand still have one pose; the features of several timestamps are merged. Moving
    cameras have a pose for each timestamp.

    Args:
        sources: The cameras.
        timeline: The capture's timestamps.
        files: For each camera the file of each timestamp.
        known: Calibrated cameras, None to estimate them.
        work: Folder for pictures and databases of COLMAP.
        options: Options of the frames and of the poses.

    Raises:
        PrepareError: The pictures do not share enough, or demand what they cannot have.
    """
    chosen = _instants(timeline, options.frames.instants)
    still = _is_known_still(sources, timeline, known, options)
    groups, database = _groups(sources, options, known is not None), work / "features.db"
    if still is not False:
        written = _write_pictures(sources, files, chosen, work)
        _extract(database, work, written, groups, sources, known, options)
        if still is None:
            still = _stands_still(database, written, sources, options)
    if not still:
        if known is not None:
            raise PrepareError(
                "poses.calibration must be of cameras that stand still, got pictures that move. "
                "Leave it out to estimate poses, or set poses.rig=still if most of each picture "
                "moves before a camera that does not."
            )
        written = _write_pictures(sources, files, range(len(timeline.times)), work)
        database = work / "moving.db"
        _extract(database, work, written, groups, sources, known, options)
        return _placed_moving(database, written, work, options)
    return _placed_still(database, written, known, work, options)


def _instants(timeline: Timeline, count: int) -> list[int]:
    """Timestamps spread over the capture."""
    last = len(timeline.times) - 1
    return sorted({round(x) for x in np.linspace(0, last, min(count, last + 1))})


def _is_known_still(
    sources: Sequence[Source],
    timeline: Timeline,
    known: dict[str, KnownCamera] | None,
    options: PrepareOptions,
) -> bool | None:
    """Whether the cameras stand still, None if their pictures must be asked."""
    if timeline.is_static:
        return False
    if options.poses.rig != "auto":
        return options.poses.rig == "still"
    if known is not None or len(timeline.times) == 1:
        return True
    return None


def _groups(sources: Sequence[Source], options: PrepareOptions, known: bool) -> list[list[str]]:
    """Names of the cameras that share intrinsics."""
    if known or options.poses.intrinsics == "own":
        return [[source.name] for source in sources]
    by_size: dict[tuple[int, int], list[str]] = {}
    for source in sources:
        by_size.setdefault((source.width, source.height), []).append(source.name)
    if options.poses.intrinsics == "shared" and len(by_size) > 1:
        sizes = ", ".join(f"{w} x {h}" for w, h in by_size)
        raise PrepareError(
            f"poses.intrinsics must be own or auto for pictures of several sizes, got shared and "
            f"{sizes}."
        )
    return list(by_size.values())


def _write_pictures(
    sources: Sequence[Source], files: dict[str, list[Path]], chosen: Sequence[int], work: Path
) -> list[MatchingPicture]:
    """Pictures for COLMAP. Folders have numbers for names, because a list of pairs has spaces."""
    pictures = []
    for k, source in enumerate(sources):
        size = source.width, source.height
        names = write_matching_pictures(files[source.name], chosen, work / f"{k:03d}", size)
        for name, i in zip(names, chosen, strict=True):
            pictures.append(MatchingPicture(f"{k:03d}/{name}", source.name, i))
    return pictures


def _extract(
    database: Path,
    work: Path,
    written: Sequence[MatchingPicture],
    groups: Sequence[Sequence[str]],
    sources: Sequence[Source],
    known: dict[str, KnownCamera] | None,
    options: PrepareOptions,
) -> None:
    sizes = {source.name: (source.width, source.height) for source in sources}
    pictures = [[p for p in written if p.camera in group] for group in groups]
    features.extract_features(database, work, pictures, sizes, options.poses)
    if known is not None:
        lenses = {name: camera.lens for name, camera in known.items()}
        features.set_lenses(database, lenses, {p.file: p.camera for p in written})


def _stands_still(
    database: Path,
    written: Sequence[MatchingPicture],
    sources: Sequence[Source],
    options: PrepareOptions,
) -> bool:
    """Whether most cameras show their first picture again in their last one."""
    ends: dict[str, list[MatchingPicture]] = {}
    for picture in written:
        ends.setdefault(picture.camera, []).append(picture)
    pairs = [(found[0].file, found[-1].file) for found in ends.values() if len(found) > 1]
    features.match_features(database, pairs, options.poses.seed)
    keypoints = features.read_keypoints(database, written)
    matches = features.raw_matches(database)
    votes = []
    for source in sources:
        first, last = ends[source.name][0].file, ends[source.name][-1].file
        rows = matches.get((first, last), np.zeros((0, 2), int))
        votes.append(merging.stands_still(keypoints[first], keypoints[last], rows, source.width))
    return 2 * sum(votes) >= len(votes)


def _placed_still(
    database: Path,
    written: Sequence[MatchingPicture],
    known: dict[str, KnownCamera] | None,
    work: Path,
    options: PrepareOptions,
) -> Placement:
    seed = options.poses.seed
    features.match_features(database, features.same_instant_pairs(written), seed)
    keypoints = features.read_keypoints(database, written)
    merged = work / "merged.db"
    raw = features.raw_matches(database)
    keypoints = merging.merged_database(database, merged, written, keypoints, raw)
    verify(merged, seed)
    pictures = {picture.file: picture for picture in written if picture.file in keypoints}
    if known is None:
        model = estimate_poses(merged, work, options.poses)
    else:
        cameras = {file: known[picture.camera] for file, picture in pictures.items()}
        widest = max(camera.lens["w"] for camera in cameras.values())
        model = triangulate(
            merged,
            work,
            {file: camera.pose for file, camera in cameras.items()},
            {file: camera.lens for file, camera in cameras.items()},
            _KNOWN_ERROR * widest / 1000,
        )
    matches = features.verified_matches(merged)
    return Placement(model, pictures, keypoints, matches, True, known is not None)


def _placed_moving(
    database: Path, written: Sequence[MatchingPicture], work: Path, options: PrepareOptions
) -> Placement:
    features.match_features(database, features.all_pairs(written), options.poses.seed)
    model = estimate_poses(database, work, options.poses)
    keypoints = features.read_keypoints(database, written)
    matches = features.verified_matches(database)
    pictures = {picture.file: picture for picture in written}
    return Placement(model, pictures, keypoints, matches, False, False)
