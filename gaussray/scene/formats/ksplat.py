"""Reads `.ksplat` files (GaussianSplats3D): sections of Gaussians, whole or in half precision.

After the header, of 4096 bytes, come the headers of the sections, of 1024 bytes each, then the
sections. A section holds the sizes of its buckets that are not full, the centres of all buckets,
and a record for each Gaussian: place, scale, quaternion w x y z, red green blue alpha as bytes, and
the harmonics above degree 0, by degree and then by colour. In the compressions 1 and 2 places are
16-bit steps from the centre of their bucket, the rest is in half precision, and in compression 2
harmonics are bytes of a range that the header states.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within
from gaussray.scene.formats.splat_file import finite_gaussians
from gaussray.scene.gaussians import Gaussians


_HEADER, _SECTION_HEADER = 4096, 1024
# The first version with these headers.
_VERSION = (0, 1)
# Coefficients of a colour above degree 0.
_ABOVE = {0: 0, 1: 3, 2: 8}
# Types of the places, of scales and quaternions, and of the harmonics.
_TYPES = {0: ("<f4", "<f4", "<f4"), 1: ("<u2", "<f2", "<f2"), 2: ("<u2", "<f2", "u1")}
# Steps on either side of a bucket's centre, and the range of harmonics, of files that state none.
_STEPS, _RANGE = 32767, 1.5


class _Section(NamedTuple):
    """What the header of a section says."""

    gaussians: int
    bucket_size: int
    buckets: int
    bucket_width: float
    bucket_bytes: int
    steps: int
    full_buckets: int
    other_buckets: int
    degree: int


def read_ksplat(path: Path | str) -> Gaussians:
    """The Gaussians of a `.ksplat` file; records that are not finite are dropped
    with a warning.

    Raises:
        ValueError: The file is none of this format, is cut short, or holds no finite Gaussian.
        FileNotFoundError: The file does not exist.
    """
    with opened(path) as file:
        head = file.read(_HEADER)
        if len(head) < _HEADER or tuple(head[:2]) < _VERSION:
            raise _damaged(path, f"a header of {_HEADER} bytes, version 0.1 or newer")
        counts, level = np.frombuffer(head, "<u4", 5), int(np.frombuffer(head, "<u2", 11)[10])
        if level not in _TYPES:
            raise _damaged(path, f"compression 0, 1 or 2, got {level}")
        # The largest number of Gaussians; a file that leaves it out has only the number in use.
        sections, total = int(counts[1]), int(counts[3] or counts[4])
        if not total:
            raise _damaged(path, "at least one Gaussian")
        within(path, "the millions of Gaussians", total, "points", 1e6)
        if not 0 < sections <= total:
            raise _damaged(path, f"1 to {total} sections, got {sections}")
        low, high = (float(x) for x in np.frombuffer(head, "<f4", 2, 36))
        bounds = (low or -_RANGE, high or _RANGE)
        headers = [_section(path, file.read(_SECTION_HEADER)) for _ in range(sections)]
        if sum(section.gaussians for section in headers) != total:
            raise _damaged(path, f"{total} Gaussians in its sections")
        parts = [_read_section(path, file, section, level, bounds) for section in headers]
    most = max(part[-1].shape[1] for part in parts)
    padded = [(*rest, np.pad(x, ((0, 0), (0, most - x.shape[1]), (0, 0)))) for *rest, x in parts]
    return finite_gaussians(path, *(np.concatenate(part) for part in zip(*padded, strict=True)))


def _damaged(path: Path | str, rule: str) -> ValueError:
    return ValueError(f"{path}: a .ksplat file must have {rule}. Copy or export it again.")


def _section(path: Path | str, head: bytes) -> _Section:
    """The header of a section."""
    if len(head) < _SECTION_HEADER:
        raise _damaged(path, f"{_SECTION_HEADER} bytes for the header of each section")
    words, halves = np.frombuffer(head, "<u4"), np.frombuffer(head, "<u2")
    section = _Section(
        gaussians=int(words[1]),
        bucket_size=int(words[2]),
        buckets=int(words[3]),
        bucket_width=float(np.frombuffer(head, "<f4")[4]),
        bucket_bytes=int(halves[10]),
        steps=int(words[6]) or _STEPS,
        full_buckets=int(words[8]),
        other_buckets=int(words[9]),
        degree=int(halves[20]),
    )
    if section.degree not in _ABOVE:
        raise _damaged(path, f"harmonics up to degree 2, got {section.degree}")
    listed = section.full_buckets + section.other_buckets
    if section.bucket_bytes not in (0, 12) or not listed <= section.buckets <= section.gaussians:
        raise _damaged(path, "buckets with centres of 12 bytes, at most one for each Gaussian")
    return section


def _read_section(
    path: Path | str, file, section: _Section, level: int, bounds: tuple[float, float]
) -> tuple[np.ndarray, ...]:
    """Places, quaternions, scales, colours with alpha as bytes, and harmonics above degree 0."""
    places, numbers, harmonics = _TYPES[level]
    above = _ABOVE[section.degree]
    record = np.dtype(
        [
            *(("mean", places, 3), ("scale", numbers, 3), ("quat", numbers, 4)),
            *(("rgba", "u1", 4), ("above", harmonics, 3 * above)),
        ]
    )

    def table(kind: np.dtype | str, count: int) -> Shaped[np.ndarray, " count"]:
        data = file.read(count * np.dtype(kind).itemsize)
        if len(data) < count * np.dtype(kind).itemsize:
            raise _damaged(path, f"{section.gaussians} Gaussians in a section, but it is cut short")
        return np.frombuffer(data, kind)

    lengths = table("<u4", section.other_buckets)
    centers = table("<f4", section.buckets * section.bucket_bytes // 4).reshape(-1, 3)
    rows = table(record, section.gaussians)
    mean = rows["mean"].astype(np.float32)
    if level:
        full = np.full(section.full_buckets, section.bucket_size)
        bucket = _owners(path, np.concatenate([full, lengths]), len(rows), len(centers))
        step = section.bucket_width / 2 / section.steps
        mean = (mean - section.steps) * np.float32(step) + centers[bucket]
    values = rows["above"].astype(np.float32)
    if level == 2:
        low, high = bounds
        values = low + values / 255 * (high - low)
    return (
        mean,
        rows["quat"].astype(np.float32),
        rows["scale"].astype(np.float32),
        rows["rgba"],
        _by_coefficient(values, section.degree),
    )


def _owners(
    path: Path | str, sizes: Int[np.ndarray, " buckets"], count: int, buckets: int
) -> Int[np.ndarray, " gaussians"]:
    """The bucket of every Gaussian: they are listed bucket by bucket."""
    if len(sizes) != buckets or int(sizes.sum()) < count:
        raise _damaged(path, f"{count} Gaussians in the {buckets} buckets of a section")
    return np.repeat(np.arange(len(sizes)), np.minimum(sizes, count))[:count]


def _by_coefficient(
    values: Float[np.ndarray, "gaussians above"], degree: int
) -> Float[np.ndarray, "gaussians coefficients 3"]:
    """Harmonics as (coefficient, colour); files list those of each colour, degree by degree."""
    parts, first = [], 0
    for own in range(1, degree + 1):
        size = 2 * own + 1
        block = values[:, first : first + 3 * size].reshape(-1, 3, size)
        parts.append(np.swapaxes(block, 1, 2))
        first += 3 * size
    return np.concatenate(parts, axis=1) if parts else np.zeros((len(values), 0, 3), np.float32)
