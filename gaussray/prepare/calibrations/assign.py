"""Gives the cameras of a calibration to those of the input."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gaussray.prepare.calibrations.known_camera import Calibration, KnownCamera
from gaussray.prepare.calibrations.like_names import like_name
from gaussray.prepare.calibrations.listed_values import named_in_order
from gaussray.prepare.calibrations.pair_names import check_pair, named_pair, names_in_order
from gaussray.prepare.calibrations.resized import resized_lens
from gaussray.prepare.calibrations.same_poses import pairs_of_one_pose
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.names_of_cameras import camera_in_name
from gaussray.prepare.sources import Source
from gaussray.runtime.progress import say


class AssignedCameras(NamedTuple):
    """The cameras of a calibration that are those of the input.

    Args:
        cameras: camera by source name.
        findings: a warning for every source that is left out or whose size differs, and for
            photographs of one pose.
        absent: cameras of the calibration, with a pose, that no source is of.
    """

    cameras: dict[str, KnownCamera]
    findings: list[Finding]
    absent: list[str]


def assign_cameras(calibration: Calibration, sources: Sequence[Source]) -> AssignedCameras:
    """The calibrated camera of each source, its lens for the source's size of pictures.

    A camera belongs to a source if it is the only one of the same name; else of the same letters
    and digits, whatever their case; else of the same last number (`cam01`, `1`); else if its name
    is a part of the source's (`back`, `session_back`). Of two sources that are given the cameras of
    a stereo calibration, which has no names, the names say which is the first: left and right, 0
    and 1, or 1 and 2. Cameras that have an order alone are those of the sources in natural order.

    Args:
        calibration: its cameras. One of pictures of another size is used as it is if the sizes
            differ by at most 16 rows and columns, which an encoder adds or drops, and scaled if
            the pictures have the same shape.
        sources: cameras of the input; one whose camera the calibration leaves out is left out too.

    Raises:
        PrepareError: A source has no camera of its name, or one for pictures of another shape; two
            sources have one camera, or cameras of one pose, unless these are single photographs; or
            none is left.
    """
    check_pair(calibration, [source.name for source in sources])
    calibration = named_in_order(
        _pair_of(calibration, sources), [source.name for source in sources]
    )
    listed = [camera.name for camera in calibration.cameras]
    names = [*listed, *calibration.left_out]
    given: dict[str, str] = {}
    result, findings, unsized = {}, [], []
    for source in sources:
        name = like_name(names, source.name)
        if name is None:
            raise PrepareError(
                f"poses.calibration must name every camera, got no {source.name} among "
                f"{', '.join(names)}. {_unnamed_remedy(sources)}"
            )
        if name in calibration.left_out:
            findings.append(_left_out(source.name, name, calibration.left_out[name]))
            continue
        other = next((key for key, value in given.items() if value == name), None)
        if other is not None:
            raise PrepareError(
                f"poses.calibration must have a camera for each video, got {name} for both {other} "
                f"and {source.name}. Rename one of them, or take away what is not of {name}."
            )
        given[source.name] = name
        camera = calibration.cameras[listed.index(name)]
        lens, finding = resized_lens(
            camera.lens, source.name, (source.width, source.height), "poses.calibration"
        )
        findings += [finding] if finding else []
        unsized += [finding] if finding and not camera.lens["w"] else []
        result[source.name] = KnownCamera(source.name, lens, camera.pose)
    if unsized:
        more = f" (and of {len(unsized) - 1} more cameras alike)" if len(unsized) > 1 else ""
        say(f"{unsized[0].text}{more}. {unsized[0].remedy}")
    if not result:
        reasons = "; ".join(f"{name} {reason}" for name, reason in calibration.left_out.items())
        raise PrepareError(
            f"poses.calibration must have a pose for a camera of videos, got {reasons[:400]}. "
            "Calibrate these cameras, or leave poses.calibration out to estimate poses."
        )
    absent = [name for name in listed if name not in given.values()]
    return AssignedCameras(result, findings + _check_poses(result, sources), absent)


def _pair_of(calibration: Calibration, sources: Sequence[Source]) -> Calibration:
    """A calibration, the cameras of a stereo calibration called as the sources, with a line."""
    order = names_in_order([source.name for source in sources])
    if calibration.is_pair and order is not None:
        say(
            f"poses.calibration: {order[0]} is its first (left) camera, and {order[1]} its second "
            "(right) one."
        )
    return named_pair(calibration, order or ())


def _unnamed_remedy(sources: Sequence[Source]) -> str:
    if len(sources) == 1 and not sources[0].is_video:
        return (
            "If its pictures are of several cameras, put each picture into a folder of its own "
            "name, that of its camera."
        )
    return "Rename the video or folder, or take it away."


def stills_by_camera(calibration: Calibration, sources: Sequence[Source]) -> list[Source]:
    """The cameras of the input, each picture as one if there is a single folder of pictures that
    are called as the calibration's cameras, one picture each: `11.jpg` of camera 11.

    Args:
        calibration: its cameras.
        sources: cameras of the input.
    """
    if len(sources) != 1 or sources[0].count < 2 or sources[0].is_video or calibration.in_order:
        return list(sources)
    (folder,) = sources
    calibration = named_pair(calibration, [path.stem for path in folder.pictures])
    names = [*(camera.name for camera in calibration.cameras), *calibration.left_out]
    for name_of in (str, camera_in_name):
        stems = [name_of(path.stem) for path in folder.pictures]
        given = [like_name(names, stem) if stem else None for stem in stems]
        if None not in given and len(set(given)) == len(given):
            say(f"{folder.path}: each of the {len(stems)} pictures is of the camera of its name.")
            return [
                dataclasses.replace(folder, name=stem, pictures=(path,), sizes=(size,))
                for stem, path, size in zip(stems, folder.pictures, folder.sizes, strict=True)
            ]
    return list(sources)


def _left_out(source: str, name: str, reason: str) -> Finding:
    text = f"{source}: left out, because {name} {reason} in the calibration"
    return Finding("warn", "cameras", text, "Calibrate it, or take its video away.")


def _check_poses(cameras: dict[str, KnownCamera], sources: Sequence[Source]) -> list[Finding]:
    """Warn of photographs of one pose, which are not matched with each other; refuse other cameras
    of one pose, and cameras that all are: nothing can be triangulated from them."""
    pairs = pairs_of_one_pose(cameras)
    stills = {source.name for source in sources if not source.is_video and source.count == 1}
    all_alike = len(pairs) == len(cameras) * (len(cameras) - 1) / 2
    for one, two in pairs:
        placeholder = np.array_equal(cameras[one].pose, np.eye(3, 4))
        if all_alike or placeholder or not {one, two} <= stills:
            raise PrepareError(
                f"poses.calibration must give each camera a pose of its own, got the same rotation "
                f"and translation for {one} and {two}, as if they had not been calibrated or one "
                "had been copied. Calibrate the poses (extrinsics) of both again, or take one of "
                "them away."
            )
    if not pairs:
        return []
    more = f", and {len(pairs) - 1} more pairs," if len(pairs) > 1 else ""
    text = (
        f"{pairs[0][0]} and {pairs[0][1]}{more} have the same pose in the calibration. They are "
        "not matched with each other"
    )
    return [Finding("warn", "cameras", text, "If one was copied, calibrate it again.")]
