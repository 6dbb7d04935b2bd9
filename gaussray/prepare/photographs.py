"""Photographs as cameras and phones store them: turned by a tag, or as HEIC."""

import shutil
import struct
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Shaped

from gaussray.capture.orientation import TRANSPOSED, stored_orientation, upright_pixels
from gaussray.capture.picture_file import open_image, read_levels
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.limits import within
from gaussray.io.safe.openimageio import oiio
from gaussray.io.safe.pictures import complaint
from gaussray.prepare.errors import PrepareError


HEIC_SUFFIXES = (".heic", ".heif")
PHOTOGRAPH_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm", ".pnm"),
    *HEIC_SUFFIXES,
)
# EXIF tags by which COLMAP knows a focal length, their numbers and types.
_MAKER = {"Make": (271, str), "Model": (272, str)}
_FOCAL = {"Exif:FocalLength": (37386, float), "Exif:FocalLengthIn35mmFilm": (41989, int)}
_EXIF_BLOCK = 0x8769
# Quality of the JPEG files that are written: errors of a fraction of a level.
_QUALITY = "jpeg:97"


def photograph_size(path: Path) -> tuple[int, int]:
    """Columns and rows of a photograph as it is seen: upright, as its EXIF orientation says.

    Raises:
        OSError: The file is no picture of a known format.
        PrepareError: It is a HEIC file, and pillow-heif is not installed.
    """
    if path.suffix.lower() in HEIC_SUFFIXES:
        return _opened_heic(path).size
    spec = open_image(path).spec()
    if stored_orientation(spec) >= TRANSPOSED:
        return spec.height, spec.width
    return spec.width, spec.height


def copy_stems(pictures: Sequence[Path]) -> list[str]:
    """Names without suffix of the copies of a folder's pictures, by which their cameras are called:
    those of the pictures; where several would be the same, as of `a.jpg` and `a.png`, the whole
    names of these."""
    stems = [path.stem for path in pictures]
    while True:
        counts = Counter(map(str.lower, stems))
        unique = [
            path.name if counts[stem.lower()] > 1 else stem
            for path, stem in zip(pictures, stems, strict=True)
        ]
        if unique == stems:
            return stems
        stems = unique


def copied_photograph(source: Path, folder: Path, stem: str = "") -> Path:
    """Put a photograph into a folder, as a file that other tools read as it is seen.

    A file of a common format that stands upright is copied. One that its EXIF orientation turns
    becomes a JPEG of its pixels upright, a HEIC file a JPEG as well: a capture's readers, COLMAP
    among them, read neither. Its focal length is kept (EXIF). A copy that exists with the time of
    its source is kept.

    Args:
        source: the photograph.
        folder: folder of the copy.
        stem: name of the copy without suffix (`copy_stems`); empty: that of the photograph.

    Returns:
        The path of the copy.

    Raises:
        OSError: The file is no picture of a known format, or damaged.
        PrepareError: It is a HEIC file, and pillow-heif is not installed.
    """
    spec = None if source.suffix.lower() in HEIC_SUFFIXES else open_image(source).spec()
    stem = stem or source.stem
    # Where the output is the folder of the photographs, these stay as they are.
    in_place = folder.exists() and folder.samefile(source.parent)
    if spec is not None and stored_orientation(spec) == 1:
        target = source if in_place else folder / f"{stem}{source.suffix}"
        copy_changed(source, target)
        return target
    target = folder / f"{source.name if in_place else stem}.jpg"
    if not (_is_of(target, source) and photograph_size(target) == photograph_size(source)):
        if spec is None:
            levels, tags = _heic_levels(source), _heic_tags(source)
        else:
            levels = read_levels(source, spec.width, spec.height)
            levels = upright_pixels(levels, stored_orientation(spec))
            tags = {name: spec.getattribute(name) for name in (*_MAKER, *_FOCAL)}
        with atomic_path(target) as partial:
            _write_jpeg(partial, levels, tags)
            shutil.copystat(source, partial)
    return target


def copy_changed(source: Path, target: Path) -> None:
    """Copy a file unless the target is the same already.

    Args:
        source: the file.
        target: its copy.
    """
    if not (_is_of(target, source) and target.stat().st_size == source.stat().st_size):
        with atomic_path(target) as partial:
            shutil.copy2(source, partial)


def _is_of(target: Path, source: Path) -> bool:
    return target.is_file() and target.stat().st_mtime_ns == source.stat().st_mtime_ns


def _write_jpeg(path: Path, levels: np.ndarray, tags: dict[str, Any]) -> None:
    spec = oiio.ImageSpec(levels.shape[1], levels.shape[0], 3, "uint8")
    spec.attribute("Compression", _QUALITY)
    spec.attribute("jpeg:subsampling", "4:4:4")
    for name, value in tags.items():
        if value is not None:
            spec.attribute(name, value)
    file = oiio.ImageOutput.create("jpeg")
    if file is None:
        raise OSError(f"{path}: the picture cannot be written: {complaint(oiio)}")
    done = file.open(str(path), spec) and file.write_image(np.ascontiguousarray(levels))
    if not (file.close() and done):
        raise OSError(f"{path}: the picture cannot be written: {complaint(file)}")


def _heif() -> ModuleType:
    try:
        import pillow_heif
    except ImportError:
        raise PrepareError(
            "HEIC photographs need pillow-heif: pip install 'gaussray[prepare]', or save them as "
            "JPEG."
        ) from None
    return pillow_heif


def _opened_heic(path: Path):
    """The main picture of a HEIC file, 8 bits a channel, as it is seen; not yet decoded."""
    heif = _heif()
    if not path.is_file():
        raise FileNotFoundError(f"{path}: the picture does not exist.")
    try:
        picture = heif.open_heif(path, convert_hdr_to_8bit=True)
    except Exception as error:
        raise OSError(f"{path}: the picture cannot be opened: {error}") from None
    within(path, "its megapixels", picture.size[0] * picture.size[1], "picture", 1e6)
    return picture


def _heic_levels(path: Path) -> Shaped[np.ndarray, "h w 3"]:
    picture = _opened_heic(path)
    try:
        levels = np.asarray(picture)
    except Exception as error:
        message = f"{path}: the picture is truncated or corrupt: {error}. Copy it again."
        raise OSError(message) from None
    return levels[..., :3] if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)


def _heic_tags(path: Path) -> dict[str, Any]:
    from PIL import Image

    exif = Image.Exif()
    try:
        exif.load(_opened_heic(path).info.get("exif") or b"")
        parts = (_MAKER, exif), (_FOCAL, exif.get_ifd(_EXIF_BLOCK))
        return {
            name: kind(block[number])
            for tags, block in parts
            for name, (number, kind) in tags.items()
            if number in block
        }
    except (ValueError, SyntaxError, TypeError, ZeroDivisionError, struct.error):
        return {}  # Damaged tags: the focal length is estimated without them.
