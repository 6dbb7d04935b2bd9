"""From videos to a capture: frames, one clock, poses, checks."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gaussray.capture.formats.transforms import PINHOLE_FILE, POINT_FILES
from gaussray.io.atomic import write_json
from gaussray.prepare import document
from gaussray.prepare.calibrated_cameras import check_calibrated_cameras
from gaussray.prepare.calibrations.assign import assign_cameras, stills_by_camera
from gaussray.prepare.calibrations.known_camera import KnownCamera
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.colmap import pycolmap, quiet_colmap
from gaussray.prepare.details import check_details
from gaussray.prepare.epipolar import epipolar_pairs
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.exposure import (
    exposure_gains,
    observed_levels,
    picture_gains,
    point_levels,
)
from gaussray.prepare.facts import facts_of
from gaussray.prepare.findings.cameras import camera_findings
from gaussray.prepare.findings.clocks import sync_findings
from gaussray.prepare.findings.doubtful_motion import doubtful_motion_findings
from gaussray.prepare.findings.epipolar_lines import epipolar_findings
from gaussray.prepare.findings.exposures import exposure_findings, picture_exposure_findings
from gaussray.prepare.findings.finding import Finding, merged_findings
from gaussray.prepare.findings.lenses import lens_findings
from gaussray.prepare.findings.points import point_findings
from gaussray.prepare.findings.same_pictures import same_picture_findings
from gaussray.prepare.given_lens import given_lenses
from gaussray.prepare.leftovers import WORK_PREFIX, mark_work, remove_leftovers
from gaussray.prepare.masks import copy_masks
from gaussray.prepare.media import copy_media
from gaussray.prepare.options import PrepareOptions
from gaussray.prepare.overlays import overlay_reason
from gaussray.prepare.panels.failures import panels_in_errors
from gaussray.prepare.placement import Placement
from gaussray.prepare.poses import find_poses
from gaussray.prepare.sources import Source, find_sources
from gaussray.prepare.stray_poses import without_strays
from gaussray.prepare.sync import Sync, synchronise
from gaussray.prepare.timeline import (
    Timeline,
    common_timeline,
    resampled,
    tell_assumed_rate,
    tell_numbers,
    thinned_timeline,
)
from gaussray.prepare.video_masks import find_video_masks
from gaussray.runtime.lock import locks_output
from gaussray.runtime.progress import say


# Facts of a prepared capture, for its report.
FACTS_FILE = "prepare.json"

# Pairs of pictures whose epipolar lines are drawn.
_PAIRS = 6


@locks_output
def prepare_capture(
    videos: Path | str, out: Path | str, *, options: PrepareOptions | None = None
) -> dict[str, Any]:
    """Make a capture of videos, or of folders of pictures.

    Args:
        videos: folder with a video, or a folder of pictures, for each camera; or one video.
        out: folder of the capture: transforms.json, points3d.ply, the frames, and prepare.json
            with what the checks found.
        options: how clocks, frames and poses are found.

    Returns:
        The content of prepare.json.

    Raises:
        FileNotFoundError: The folder or the calibration does not exist.
        PrepareError: No capture can be made; the message says why and what to do. If the checks
            say so, prepare.json is written and transforms.json is not.
        OSError: Another process writes to `out`, or it cannot be written.
    """
    options, out = options or PrepareOptions(), Path(out)
    remove_leftovers(out)
    pycolmap()
    sources, known, remarks = _calibrated(find_sources(videos), options)
    if known is None:
        check_details(sources)
    lenses = None
    if options.poses.lens is not None:
        lenses, resized = given_lenses(options.poses.lens, sources)
        remarks = [*remarks, *resized]
    sync = synchronise(sources, options.sync)
    timeline = common_timeline(sources, sync, options.frames)
    tell_numbers(sources, timeline)
    tell_assumed_rate(sources, timeline, options.frames)
    if len(sources) == 1 and not options.frames.rate and resampled(sources, timeline):
        used, count = len(timeline.times), sources[0].count
        say(f"{sources[0].name}: {used} of {count} frames are used; frames.rate takes others.")
    video_masks = find_video_masks(sources, out)
    # Pictures are about to be replaced: the poses of an earlier run must not stay beside them.
    (out / PINHOLE_FILE).unlink(missing_ok=True)
    files = copy_media(sources, timeline, out)
    copy_masks(sources, timeline, files, video_masks, out, needed=options.poses.masks)
    out.mkdir(parents=True, exist_ok=True)
    folder = tempfile.TemporaryDirectory(dir=out, prefix=WORK_PREFIX)
    with panels_in_errors(sources), folder as work, quiet_colmap():
        mark_work(Path(work))
        placement = find_poses(sources, timeline, files, known, Path(work), options, lenses)
        files = {name: own[:: placement.stride] for name, own in files.items()}
        placement, strays = without_strays(placement)
        # All timestamps tell how well the clocks agree.
        clocks = sync_findings(sources, sync, timeline)
        timeline = thinned_timeline(timeline, placement.stride)
        remarks = [*remarks, *strays, *clocks]
        return _checked(sources, sync, timeline, files, placement, remarks, out, options)


def refusal(facts: dict[str, Any]) -> str:
    """The message about the findings that rule a capture out; empty if none does."""
    bad = [finding for finding in facts["findings"] if finding["level"] == "refuse"]
    return " ".join(
        f"{finding['subject']}: {finding['text']}. {finding['remedy']}" for finding in bad
    )


def _calibrated(
    sources: list[Source], options: PrepareOptions
) -> tuple[list[Source], dict[str, KnownCamera] | None, list[Finding]]:
    """The cameras of the input with those of the calibration, None if there is none."""
    if not options.poses.calibration:
        return sources, None, []
    calibration = read_calibration(options.poses.calibration)
    sources = stills_by_camera(calibration, sources)
    known, remarks, absent = assign_cameras(calibration, sources)
    # Of a camera without a pose the video is left out.
    sources = [source for source in sources if source.name in known]
    check_calibrated_cameras(list(known), absent, calibration.left_out)
    return sources, known, remarks


def _checked(
    sources: Sequence[Source],
    sync: Sync,
    timeline: Timeline,
    files: dict[str, list[Path]],
    placement: Placement,
    remarks: Sequence[Finding],
    out: Path,
    options: PrepareOptions,
) -> dict[str, Any]:
    """Run the checks and write the capture, unless one of them rules it out."""
    levels = observed_levels(placement, files)
    pairs = epipolar_pairs(placement, _PAIRS)
    gains = exposure_gains(placement, levels)
    found = [*doubtful_motion_findings(placement), *remarks]
    found += camera_findings(placement)
    found += same_picture_findings(placement, files)
    found += lens_findings(placement) if placement.model.pictures else []
    found += point_findings(placement)
    found += epipolar_findings(placement, pairs)
    found += exposure_findings(gains, levels.clipped)
    found += picture_exposure_findings(
        picture_gains(placement, levels), photographs=timeline.is_static
    )
    facts = facts_of(sources, sync, timeline, files, placement, pairs, gains, out)
    facts["findings"] = [finding._asdict() for finding in merged_findings(found)]
    write_json(out / FACTS_FILE, facts)
    if message := refusal(facts):
        (out / PINHOLE_FILE).unlink(missing_ok=True)
        if placement.overlays:
            message = f"{overlay_reason(placement.overlays)} {message}"
        raise PrepareError(f"{out}: no capture was written. {message}")
    points = placement.model.points
    if len(points):
        document.write_points(out / POINT_FILES[0], points, point_levels(placement, levels))
    content = document.capture_document(placement, timeline, files, out, options.frames.readout)
    if not len(points):
        del content["ply_file_path"]
    write_json(out / PINHOLE_FILE, content)
    return facts
