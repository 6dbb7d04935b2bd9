"""Writes label layers: named channels of an EXR, or integers as a gray PNG."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaussray.dataset.images import write_pixels
from gaussray.io.safe.openimageio import oiio
from gaussray.io.safe.pictures import complaint, open_picture


# Last letters of the channel names of vectors.
_AXES = ("x", "y", "z", "w")


def channel_names(layers: Mapping[str, np.ndarray]) -> list[str]:
    """Channel names of layers, in order: `depth`, or `normal.x`, `normal.y`, `normal.z`."""
    return [
        name if image.ndim == 2 else f"{name}.{_AXES[i]}"
        for name, image in layers.items()
        for i in range(1 if image.ndim == 2 else image.shape[2])
    ]


def write_layers(path: Path | str, layers: Mapping[str, np.ndarray]) -> None:
    """Write layers as the channels of an EXR of 32-bit floats, atomically.

    Args:
        path: an `.exr` file.
        layers: arrays [h, w] or [h, w, up to 4] of one size, by name. Integers must be below 2^24,
            which floats represent exactly. NaN and infinity are written as they are.

    Raises:
        ValueError: the suffix is not .exr, or an integer is too large.
    """
    path, names = Path(path), channel_names(layers)
    if path.suffix != ".exr":
        raise ValueError(f"{path}: layers must be written as .exr, got {path.suffix!r}.")
    for name, image in layers.items():
        if image.dtype.kind in "iu" and np.abs(image).max(initial=0) >= 1 << 24:
            raise ValueError(f"{path}: {name} must be below 2^24, got {np.abs(image).max()}.")
    planes = [image.reshape(*image.shape[:2], -1) for image in layers.values()]
    _write(path, np.concatenate(planes, axis=2, dtype=np.float32), names)


def read_layers(path: Path | str) -> dict[str, np.ndarray]:
    """The channels of an EXR by name, each [h, w] of 32-bit floats.

    Raises:
        OSError: the file cannot be read.
    """
    names, pixels = _read(path, oiio.FLOAT)
    return {name: pixels[..., i] for i, name in enumerate(names)}


def read_integers(path: Path | str) -> np.ndarray:
    """The whole numbers [h, w] of a gray PNG, as int32.

    Raises:
        OSError: the file cannot be read.
    """
    _, pixels = _read(path, oiio.UNKNOWN)
    return pixels[..., 0].astype(np.int32)


def _read(path: Path | str, kind: "oiio.BASETYPE") -> tuple[list[str], np.ndarray]:
    """Names and values [h, w, channels] of a picture's channels; UNKNOWN is the type stored."""
    try:
        image = open_picture(path)
    except OSError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise OSError(f"{path}: the layers cannot be read: {reason}") from None
    names = list(image.spec().channelnames)
    pixels = image.read_image(image.spec().format.basetype if kind == oiio.UNKNOWN else kind)
    image.close()
    if pixels is None:
        raise OSError(f"{path}: the layers cannot be read: {complaint(image)}")
    return names, pixels


def write_integers(path: Path | str, codes: np.ndarray) -> None:
    """Write integers as a gray PNG, of 16 bits if one is above 255.

    Args:
        path: the file, `.png`.
        codes: integers [h, w] in 0..65535.

    Raises:
        ValueError: the suffix is not .png, or an integer is out of range.
    """
    path, largest = Path(path), int(codes.max(initial=0))
    if path.suffix != ".png" or codes.min(initial=0) < 0 or largest >= 1 << 16:
        raise ValueError(
            f"{path}: codes must be from 0 to 65535 in a .png, got {codes.min(initial=0)} to "
            f"{largest}."
        )
    _write(path, codes.astype(np.uint8 if largest < 256 else np.uint16)[..., None], ["Y"])


def _write(path: Path, image: np.ndarray, names: list[str]) -> None:
    kind = {"float32": oiio.FLOAT, "uint8": oiio.UINT8, "uint16": oiio.UINT16}[image.dtype.name]
    spec = oiio.ImageSpec(image.shape[1], image.shape[0], image.shape[2], kind)
    spec.channelnames = names
    write_pixels(path, image, spec)
