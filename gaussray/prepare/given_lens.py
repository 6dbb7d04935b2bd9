"""The known lenses of cameras whose poses are estimated (`poses.lens`)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaussray.prepare.calibrations.known_camera import opencv_camera
from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.like_names import like_name
from gaussray.prepare.calibrations.resized import resized_lens
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.findings.finding import Finding
from gaussray.prepare.lens_models import LensKeyValues, lens_fov
from gaussray.prepare.sources import Source
from gaussray.runtime.output import first_of
from gaussray.runtime.progress import say


# The lens of each camera's pictures of each size, by the camera's name and columns and rows.
LensesBySize = dict[tuple[str, tuple[int, int]], LensKeyValues]
# Coefficients that the line about a lens shows.
_SHOWN = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def given_lenses(
    lens: str | tuple[float, ...], sources: Sequence[Source]
) -> tuple[LensesBySize, list[Finding]]:
    """The lens of each camera's pictures, with a line that tells which it is.

    One lens serves all cameras. The lenses of a file with several, unless they are equal, serve
    those of their names (`like_name`).

    Args:
        lens: file of a lens, or fx fy cx cy and coefficients k1 k2 p1 p2 as OpenCV has them.
        sources: cameras of the input.

    Returns:
        Lenses by camera and size of the pictures, and a warning of each size that is not that of
        the calibration.

    Raises:
        FileNotFoundError: There is no such file.
        PrepareError: The file holds no lens, none of a camera, or one of pictures of another shape.
    """
    if isinstance(lens, str):
        where, lenses = Path(lens).name, read_lenses(lens)
    else:
        where, lenses = "poses.lens", {"": _lens_of_numbers(lens)}
    named = {source.name: _chosen(lenses, source.name) for source in sources}
    _check_own(named, lenses)
    chosen = {camera: lenses[name] for camera, name in named.items()}
    result: LensesBySize = {}
    findings: dict[str, Finding] = {}
    for source in sources:
        own = chosen[source.name]
        if not own["w"]:
            _check_one_size([other for other in sources if chosen[other.name] == own])
        for size in dict.fromkeys(source.sizes):
            key = source.name, size
            result[key], finding = resized_lens(own, source.name, size, "poses.lens")
            if finding is not None:
                findings.setdefault(finding.text.partition(":")[2], finding)
    _tell(where, list(result.values()))
    return result, list(findings.values())


def _lens_of_numbers(numbers: Sequence[float]) -> LensKeyValues:
    """The lens of fx fy cx cy and OpenCV's coefficients, of pictures of any size."""
    fx, fy, cx, cy, *distortion = numbers
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    coefficients = np.array(distortion, np.float64)
    return opencv_camera("poses.lens", "lens", matrix, coefficients, np.eye(3, 4)).lens


def _check_own(named: dict[str, str], lenses: dict[str, LensKeyValues]) -> None:
    """Refuse one of several lenses for two cameras: the names of one of them say another."""
    users: dict[str, str] = {}
    for camera, name in named.items():
        if name in users and not _are_equal(lenses):
            raise PrepareError(
                f"poses.lens must have a lens for each camera, got {name} for {users[name]} and "
                f"{camera}. Call each video or folder as the file calls its camera."
            )
        users[name] = camera


def _are_equal(lenses: dict[str, LensKeyValues]) -> bool:
    first = next(iter(lenses.values()))
    return all(lens == first for lens in lenses.values())


def _chosen(lenses: dict[str, LensKeyValues], camera: str) -> str:
    """The name of a camera's lens: the first one if all are equal, or that of its name."""
    if _are_equal(lenses):
        return next(iter(lenses))
    name = like_name(list(lenses), camera)
    if name is None:
        raise PrepareError(
            f"poses.lens must hold one lens or one for each camera, got none of {camera} among "
            f"{first_of(list(lenses))}. Call the video or folder as one of them, or give a file "
            "with one lens."
        )
    return name


def _check_one_size(sources: Sequence[Source]) -> None:
    """Refuse pictures of several sizes with a lens that may be of any of them."""
    different = dict.fromkeys(size for source in sources for size in source.sizes)
    sizes = [f"{width} x {height}" for width, height in different]
    if len(sizes) > 1:
        raise PrepareError(
            "poses.lens does not tell of which size its pictures were, and those of the input must "
            f"have one size then, got {first_of(sizes)}. Give a file with the size."
        )


def _tell(where: str, lenses: Sequence[LensKeyValues]) -> None:
    """Say which lens is used, or how wide the lenses are if there are several."""
    first = lenses[0]
    angles = sorted(lens_fov(lens) for lens in lenses)
    if all(lens == first for lens in lenses):
        bent = [f"{key}={first[key]:.4g}" for key in _SHOWN if first.get(key)]
        shown = f"fx={first['fl_x']:.6g} fy={first['fl_y']:.6g} ({angles[0]:.1f} degrees across), "
        kind = "a fisheye with " if "FISHEYE" in first["camera_model"] else ""
        shown += kind + (" ".join(bent) or "no distortion")
    else:
        shown = f"{angles[0]:.1f} to {angles[-1]:.1f} degrees across"
    say(f"The lens of {where} stays as it is while poses are found: {shown}.")
