"""Reads SOG scenes (Spatially Ordered Gaussians, PlayCanvas), version 2: bytes in pictures.

`meta.json` names the pictures, which are lossless; a pixel is a Gaussian, row by row. The two
pictures of means are the low and high bytes of sixteen bits between `mins` and `maxs` of
sign(x) log(1 + |x|). Quaternions have three bytes, -sqrt(1/2) to sqrt(1/2), and 252 plus the place
of the largest of w x y z. Bytes of scales and colours are entries of a codebook of 256 (logarithms
of scales; constant harmonics), the fourth byte of sh0 is the opacity. Other harmonics are rows of a
palette of up to 65,536: its picture has 64 entries a row, a pixel for each coefficient. Files lie
in a folder or in one ZIP archive.
"""

import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from gaussray.io.safe.files import inside, opened, parse_json, read_json
from gaussray.io.safe.limits import limits, within
from gaussray.io.safe.openimageio import oiio
from gaussray.io.safe.pictures import complaint, open_picture
from gaussray.scene.formats.compressed_ply import smallest_three
from gaussray.scene.gaussians import Gaussians


META = "meta.json"
_HALF = np.sqrt(0.5)
# Entries in a row of the palette's picture, and the numbers of coefficients of its bands.
_PALETTE, _BANDS = 64, (0, 3, 8, 15)
_QUAT = 252

# A picture's bytes [pixels, 4] from its name.
Texture = Callable[[str], tuple[UInt8[np.ndarray, "pixels 4"], int]]


def read_sog(path: Path | str) -> Gaussians:
    """The Gaussians of a SOG scene.

    Args:
        path: the archive (`.sog`), the folder, or its meta.json.

    Raises:
        ValueError: The scene is of another version, damaged, or exceeds a limit.
        FileNotFoundError: A file does not exist.
    """
    path = Path(path)
    if path.is_dir() or path.name == META:
        meta = path / META if path.is_dir() else path
        return _gaussians(
            meta, read_json(meta), lambda name: _pixels(inside(meta.parent, name, meta))
        )
    try:
        with opened(path) as file, zipfile.ZipFile(file) as archive:
            content = parse_json(f"{path}: {META}", _member(path, archive, META, "text", 1e6))
            with tempfile.TemporaryDirectory() as folder:

                def texture(name: str) -> tuple[np.ndarray, int]:
                    # OpenImageIO reads files.
                    packed = Path(folder) / f"texture{Path(name).suffix}"
                    packed.write_bytes(_member(path, archive, name, "arrays", 1e9))
                    return _pixels(packed)

                return _gaussians(path, content, texture)
    except (zipfile.BadZipFile, NotImplementedError, EOFError) as error:
        raise ValueError(f"{path}: must be a ZIP archive of a SOG scene, got {error}.") from None


def _member(path: Path, archive: zipfile.ZipFile, name: str, key: str, unit: float) -> bytes:
    """The bytes of a file of the archive, within a limit."""
    try:
        info = archive.getinfo(name)
    except KeyError:
        raise ValueError(f"{path}: the archive must hold {name!s:.80}. Export it again.") from None
    within(path, f"{name} in {'MB' if unit == 1e6 else 'GB'}", info.file_size, key, unit)
    with archive.open(info) as file:
        # An archive may say less than it holds.
        return file.read(min(info.file_size, int(getattr(limits(), key) * unit)) + 1)


def _pixels(path: Path) -> tuple[np.ndarray, int]:
    """The bytes of a picture [pixels, 4], row by row, and its width."""
    config = oiio.ImageSpec()
    # Colours of transparent pixels are data here.
    config.attribute("oiio:UnassociatedAlpha", 1)
    file = open_picture(path, config)
    spec = file.spec()
    data = file.read_image(0, 0, 0, spec.nchannels, oiio.UINT8)
    file.close()
    if data is None or spec.nchannels not in (3, 4):
        raise ValueError(f"{path.name}: must be a picture of four channels, {complaint(file)}.")
    pixels = np.asarray(data, np.uint8).reshape(-1, spec.nchannels)
    if spec.nchannels == 3:
        pixels = np.concatenate([pixels, np.full((len(pixels), 1), 255, np.uint8)], axis=1)
    return pixels, spec.width


def _gaussians(path: Path, meta: Any, texture: Texture) -> Gaussians:
    if not isinstance(meta, dict) or meta.get("version") != 2:
        version = meta.get("version") if isinstance(meta, dict) else None
        raise ValueError(
            f"{path}: must be a SOG scene of version 2, got {version!s:.80}. Convert it with "
            "splat-transform."
        )
    count = meta.get("count")
    if type(count) is not int or count < 1:
        raise ValueError(f"{path}: count must be at least 1, got {count!s:.80}.")
    within(path, "the millions of Gaussians", count, "points", 1e6)

    def columns(key: str, index: int = 0) -> np.ndarray:
        pixels, _ = texture(_file(path, meta, key, index))
        if len(pixels) < count:
            raise ValueError(f"{path}: {key} must have {count} pixels, got {len(pixels)}.")
        return pixels[:count]

    low, high = (columns("means", i)[:, :3].astype(np.int64) for i in (0, 1))
    ends = [_numbers(path, meta["means"], key, 3) for key in ("mins", "maxs")]
    bent = ends[0] + (ends[1] - ends[0]) * ((high << 8 | low) / 65535)
    turns, color, size = columns("quats"), columns("sh0"), columns("scales")[:, :3]
    largest = turns[:, 3].astype(int) - _QUAT
    if (largest < 0).any():
        raise ValueError(f"{path}: the fourth byte of quats must be at least {_QUAT}.")
    first = _numbers(path, meta["sh0"], "codebook", 256)[color[:, :3]][:, None]
    values = (
        np.sign(bent) * np.expm1(np.abs(bent)),
        smallest_three(largest, (turns[:, :3] / 255 * 2 - 1) * _HALF),
        np.exp(_numbers(path, meta["scales"], "codebook", 256)[size]),
        np.clip(color[:, 3] / 255, 0.5 / 255, 1 - 0.5 / 255),
        np.concatenate([first, _rest(path, meta, columns, texture)], axis=1),
    )
    return Gaussians(*(jnp.asarray(value, jnp.float32) for value in values))


def _file(path: Path, meta: dict[str, Any], key: str, index: int) -> str:
    block = meta.get(key)
    files = block.get("files") if isinstance(block, dict) else None
    if not isinstance(files, list) or len(files) <= index or not isinstance(files[index], str):
        raise ValueError(f"{path}: {key}.files must name its pictures.")
    return files[index]


def _numbers(path: Path, block: dict[str, Any], key: str, count: int) -> Float[np.ndarray, " n"]:
    """A list of finite numbers."""
    try:
        values = np.array(block.get(key), np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise ValueError(f"{path}: {key} must be {count} finite numbers.")
    return values


def _rest(
    path: Path, meta: dict[str, Any], columns: Callable[..., np.ndarray], texture: Texture
) -> Float[np.ndarray, "gaussians rest 3"]:
    """The harmonics above the constant one, by the label of each Gaussian in the palette."""
    block = meta.get("shN")
    bands = block.get("bands") if isinstance(block, dict) else 0
    if type(bands) is not int or not 0 <= bands < len(_BANDS):
        raise ValueError(f"{path}: shN.bands must be 0 to 3, got {bands!s:.80}.")
    if not bands or not isinstance(block, dict):
        return np.zeros((meta["count"], 0, 3))
    each = _BANDS[bands]
    pixels, width = texture(_file(path, meta, "shN", 0))
    labels = columns("shN", 1).astype(np.int64)
    label = labels[:, 0] | labels[:, 1] << 8
    if width != _PALETTE * each or label.max() * each >= len(pixels):
        raise ValueError(
            f"{path}: the palette of shN must have {_PALETTE * each} columns and a row for every "
            f"{_PALETTE} of its entries."
        )
    # Entries follow one another within a row of pixels, rows below one another.
    palette = _numbers(path, block, "codebook", 256)[pixels[:, :3]].reshape(-1, each, 3)
    return palette[label]
