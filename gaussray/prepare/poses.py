"""Features, matches, then poses: estimated, or known and triangulated."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from gaussray.capture.mask_folder import MASK_FOLDER
from gaussray.capture.spread import evenly_spread
from gaussray.prepare import features, merging
from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.calibrations.same_poses import pairs_of_one_pose
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.full_pictures import MANY_FEATURES, full_pictures
from gaussray.prepare.given_lens import LensesBySize
from gaussray.prepare.mapping import estimate_poses, poses_with_given_lenses, verify
from gaussray.prepare.masks import write_matching_masks
from gaussray.prepare.media import write_matching_pictures
from gaussray.prepare.missing_poses import missing_poses_reason
from gaussray.prepare.options import PrepareOptions
from gaussray.prepare.overlays import check_overlays, overlay_reason, without_overlays
from gaussray.prepare.panels.failures import holds_views
from gaussray.prepare.placement import Placement
from gaussray.prepare.sources import Source
from gaussray.prepare.standing_cameras import (
    standing_by_options,
    standing_cameras,
    tell_standing,
)
from gaussray.prepare.timeline import Timeline, moving_stride, thinned_timeline
from gaussray.prepare.triangulation import triangulate
from gaussray.runtime.output import first_of
from gaussray.runtime.progress import say


# With known cameras, points may be so many pixels off for each 1000 pixels of width: enough to show
# a calibration that does not fit.
_KNOWN_ERROR = 8.0
# Database of COLMAP with the features of all pictures, beside their folders.
_FEATURES = "features.db"


def find_poses(
    sources: Sequence[Source],
    timeline: Timeline,
    files: dict[str, list[Path]],
    known: dict[str, KnownCamera] | None,
    work: Path,
    options: PrepareOptions,
    lenses: LensesBySize | None = None,
) -> Placement:
    """Poses, lenses and points of the cameras.

    Cameras that stand still have one pose; the features of several timestamps are merged. Moving
    cameras have a pose for each timestamp, of which `stride` tells how many are used. Both may be
    in one capture.

    Args:
        sources: the cameras.
        timeline: the capture's timestamps.
        files: for each camera the file of each timestamp.
        known: calibrated cameras, None to estimate them.
        work: folder for pictures and databases of COLMAP.
        options: options of the frames and of the poses.
        lenses: lenses that are known and stay as they are where poses are estimated, None to
            estimate them, too.

    Raises:
        PrepareError: The pictures do not share enough, or demand what they cannot have.
    """
    everyone = frozenset(source.name for source in sources)
    if known is not None:
        lenses = {(s.name, size): known[s.name].lens for s in sources for size in s.sizes}
    still, written = standing_by_options(everyone, timeline, known, options), None
    untold = False
    if still is None:
        written = _write_pictures(sources, timeline, files, everyone, work, options)
        _extract(work, written, lenses, options)
        _check_features(work / _FEATURES)
        found = standing_cameras(work / _FEATURES, written, options.poses.seed)
        still, untold = found or frozenset(), found is None
        tell_standing(found, everyone)
    if known is not None and still < everyone:
        raise PrepareError(
            "poses.calibration must be of cameras that stand still, got pictures that move. "
            "Leave it out to estimate poses, or set poses.rig=still if most of each picture "
            "moves before a camera that does not."
        )
    stride = moving_stride(sources, timeline, still, options.frames)
    if stride > 1:
        _tell_stride(timeline, [s.name for s in sources if s.name not in still], stride)
        timeline = thinned_timeline(timeline, stride)
        files = {name: own[::stride] for name, own in files.items()}
    told_by_all = len(timeline.times) <= options.frames.instants and stride == 1
    if written is None or (still < everyone and not told_by_all):
        # Other files, with other numbers, than those that told which cameras stand still.
        work = work / "placed"
        written = _write_pictures(sources, timeline, files, still, work, options)
        _extract(work, written, lenses, options)
        if known is None:
            _check_features(work / _FEATURES)
    once = any(map(holds_views, sources))
    placement = _placed(work, written, still, known, options, lenses is not None, once)
    total, used = len(timeline.times), options.frames.instants
    more = min(2 * used, total) if still and total > used else 0
    taken, full = options.poses.features, frozenset[str]()
    if taken < MANY_FEATURES:
        full = full_pictures(work / _FEATURES, taken, _masks_in(work))
    return dataclasses.replace(
        placement,
        stride=stride,
        more_instants=more,
        full_pictures=full,
        fov_given=options.poses.fov > 0,
        rig_untold=untold,
    )


def _check_features(database: Path) -> None:
    """Refuse pictures most of which have no feature, before they are compared."""
    if not features.median_features(database):
        raise PrepareError(missing_poses_reason(database))


def _tell_stride(timeline: Timeline, moving: Sequence[str], stride: int) -> None:
    total, several = len(timeline.times), len(moving) > 1
    say(
        f"{first_of(moving)}: the camera{'s' if several else ''} move{'' if several else 's'}, and "
        f"every picture needs a pose of its own: {-(-total // stride)} of {total} timestamps are "
        f"used. frames.rate={timeline.rate:.6g} takes them all."
    )


def _write_pictures(
    sources: Sequence[Source],
    timeline: Timeline,
    files: dict[str, list[Path]],
    still: frozenset[str],
    work: Path,
    options: PrepareOptions,
) -> list[MatchingPicture]:
    """Pictures for COLMAP, of cameras that stand still a few timestamps spread over the capture.
    Folders have numbers for names, because a list of pairs has spaces."""
    last = len(timeline.times) - 1
    few = evenly_spread(range(last + 1), options.frames.instants)
    pictures = []
    for k, source in enumerate(sources):
        chosen = few if source.name in still else range(last + 1)
        frames = [int(timeline.frames[source.name][i]) for i in chosen]
        sizes = [source.size(frame) for frame in frames]
        names = write_matching_pictures(files[source.name], chosen, work / f"{k:03d}", sizes)
        if options.poses.masks:
            mask_folder = work / MASK_FOLDER / f"{k:03d}"
            write_matching_masks(files[source.name], chosen, mask_folder, names, sizes)
        for name, i, frame, size in zip(names, chosen, frames, sizes, strict=True):
            photograph = "" if source.is_video else source.pictures[frame].name
            picture = MatchingPicture(f"{k:03d}/{name}", source.name, i, size, photograph)
            pictures.append(picture)
    return pictures


def _masks_in(work: Path) -> Path | None:
    masks = work / MASK_FOLDER
    return masks if masks.is_dir() else None


def _extract(
    work: Path,
    written: Sequence[MatchingPicture],
    lenses: LensesBySize | None,
    options: PrepareOptions,
) -> None:
    own = lenses is not None or options.poses.intrinsics == "own"
    groups: dict[tuple, list[MatchingPicture]] = {}
    for picture in written:
        groups.setdefault((picture.camera * own, picture.size), []).append(picture)
    if lenses is None and options.poses.intrinsics == "shared" and len(groups) > 1:
        sizes = ", ".join(f"{w} x {h}" for _, (w, h) in groups)
        raise PrepareError(
            f"poses.intrinsics must be own or auto for pictures of several sizes, got shared and "
            f"{sizes}."
        )
    database = work / _FEATURES
    features.extract_features(database, work, list(groups.values()), options.poses, _masks_in(work))
    if lenses is not None:
        features.set_lenses(database, {p.file: lenses[p.camera, p.size] for p in written})


def _placed(
    work: Path,
    written: Sequence[MatchingPicture],
    still: frozenset[str],
    known: dict[str, KnownCamera] | None,
    options: PrepareOptions,
    lenses_given: bool,
    once: bool,
) -> Placement:
    """Match, merge the timestamps of cameras that stand still, and find poses or points; at once or
    not at all of pictures that surely hold several views."""
    database, seed = work / _FEATURES, options.poses.seed
    pairs = features.matched_pairs(written, still)
    if known is not None:
        # From one place nothing can be triangulated.
        camera = {picture.file: picture.camera for picture in written}
        alike = {frozenset(pair) for pair in pairs_of_one_pose(known)}
        pairs = [pair for pair in pairs if frozenset(map(camera.__getitem__, pair)) not in alike]
    features.match_features(database, pairs, seed)
    keypoints = features.read_keypoints(database, written)
    if still:
        merged, raw = work / "merged.db", features.raw_matches(database)
        keypoints = merging.merged_database(database, merged, written, keypoints, raw, still)
        verify(merged, seed)
        database = merged
    pictures = {picture.file: picture for picture in written if picture.file in keypoints}
    merged_times = len(pictures) < len(written)
    overlays = without_overlays(database, work, pictures, keypoints)
    if overlays:
        verify(database, seed)
    if known is None:
        if reason := check_overlays(overlays, database, pictures):
            raise PrepareError(reason)
        try_moving = merged_times and not overlays
        try:
            if lenses_given:
                model = poses_with_given_lenses(database, work, options.poses, try_moving)
            else:
                model = estimate_poses(database, work, options.poses, try_moving, once)
        except PrepareError as error:
            reason = overlay_reason(overlays) + " " if overlays else ""
            raise PrepareError(f"{reason}{error}") from error
    else:
        cameras = {file: known[picture.camera] for file, picture in pictures.items()}
        widest = max(camera.lens["w"] for camera in cameras.values())
        model = triangulate(
            database,
            work,
            {file: camera.pose for file, camera in cameras.items()},
            {file: camera.lens for file, camera in cameras.items()},
            _KNOWN_ERROR * widest / 1000,
        )
    matches = features.verified_matches(database)
    return Placement(
        model, pictures, keypoints, matches, still, known is not None, overlays=tuple(overlays)
    )
