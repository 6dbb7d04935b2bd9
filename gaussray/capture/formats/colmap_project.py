"""Which folder of a COLMAP project holds a model together with its pictures."""

import itertools
import struct
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from gaussray.capture.formats.colmap_files import listed_images, model_folder
from gaussray.capture.formats.picture_places import other_spellings
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.io.safe.files import opened


# The folder of undistorted pictures and their model, in a project of COLMAP's reconstructors.
DENSE_FOLDERS = ("dense/0", "dense")
# Pictures of a model that are sought. In images.bin, bytes before a name, and from there those in
# which its end and a number are.
_LOOKED_AT = 300
_POSE_BYTES, _LONGEST = 64, 4096


def project_folder(folder: Path) -> Path:
    """The folder of a project with a model and its pictures: itself or one of `DENSE_FOLDERS`.

    Of several with a model it is the first in which a picture of its model lies: reconstructors
    leave the original pictures elsewhere, and write the undistorted ones beside their own model.
    """
    places = [folder, *(folder / name for name in DENSE_FOLDERS)]
    models = [(place, model) for place in places if (model := model_folder(place)) is not None]
    if len(models) < 2:
        return models[0][0] if models else folder
    return next((place for place, model in models if _has_pictures(place, model)), models[0][0])


def _has_pictures(folder: Path, model: Path) -> bool:
    """Whether a picture of a model, or a folder or video of its camera, lies in its folder. Of the
    model the first few hundred names count, and one that cannot be read has no pictures here."""
    images = model / "images.bin"
    try:
        if images.is_file():
            listed = _first_names(images)
        else:
            listed = (image.name for image in listed_images(model / "images.txt"))
        names = list(itertools.islice(listed, _LOOKED_AT))
    except (OSError, OverflowError, ValueError, struct.error):
        return False
    inside = [name for name in map(PurePosixPath, names) if _is_inside(name)]
    roots = [root for root in (folder / "images", folder, folder / "videos") if root.is_dir()]
    for root in roots:
        videos = {p.stem for p in root.iterdir() if p.suffix.lower() in VIDEO_SUFFIXES}
        if any(_is_held(root, name, videos) for name in inside):
            return True
    return any(other_spellings(root, [str(name) for name in inside]) for root in roots)


def _is_inside(name: PurePosixPath) -> bool:
    return bool(name.parts) and not name.is_absolute() and ".." not in name.parts


def _is_held(root: Path, name: PurePosixPath, videos: set[str]) -> bool:
    """Whether a folder holds a picture, or a folder or video of its camera: called as the picture,
    without the last suffix, or as the first folder of its path."""
    first = name.parts[0] if len(name.parts) > 1 else name.stem
    try:
        return (
            (root / name).is_file()
            or not videos.isdisjoint((name.stem, first))
            or any(
                place.is_dir() and any(place.iterdir())
                for place in (root / name.with_suffix(""), root / first)
            )
        )
    except (OSError, ValueError):
        # A path that no file system has, or a folder that must not be read.
        return False


def _first_names(path: Path) -> Iterator[str]:
    """The names in images.bin from its start, without reading what is between them."""
    with opened(path) as file:
        (count,) = struct.unpack("<Q", file.read(8))
        for _ in range(min(count, _LOOKED_AT)):
            row = file.read(_POSE_BYTES + _LONGEST)
            end = row.index(b"\0", _POSE_BYTES)
            (seen,) = struct.unpack_from("<Q", row, end + 1)
            yield row[_POSE_BYTES:end].decode("utf-8", "replace")
            file.seek(end + 9 + 24 * seen - len(row), 1)
