"""Masks of photographs: which file beside the pictures it is, and where it goes in a capture."""

import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.mask_folder import MASK_FOLDER, mask_in
from gaussray.capture.orientation import stored_orientation, upright_pixels
from gaussray.capture.picture_file import open_image, picture_size, read_levels
from gaussray.dataset.images import write_image
from gaussray.prepare.photographs import HEIC_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline
from gaussray.runtime.progress import say


_FOLDERS = (MASK_FOLDER, "mask")


def copy_masks(sources: Sequence[Source], timeline: Timeline, files: dict[str, list[Path]]) -> None:
    """Put the masks of photographs into a capture, as `masks/CAMERA/a.jpg.png` of
    `images/CAMERA/a.jpg`, upright as the pictures are; white pixels count.

    A line says how many pictures have one, a warning how many masks have another size than their
    picture, which are left out.

    Args:
        sources: the cameras.
        timeline: the frames that are used.
        files: for each camera the copied picture of each timestamp.
    """
    found, wrong, count = 0, [], 0
    # Pictures of one folder have names of their own, also if these say several cameras.
    alone = len({path.parent for source in sources for path in source.pictures}) == 1
    alone = alone and not any(source.is_video for source in sources)
    for source in sources:
        for i, copy in zip(timeline.frames[source.name], files[source.name], strict=True):
            if source.is_video:
                continue
            target = written_mask(copy)
            mask = mask_of(source.pictures[i], alone=alone)
            levels = None if mask is None else _levels(mask, source.pictures[i], copy)
            count += 1
            if levels is not None:
                write_image(target, levels)
                found += 1
                continue
            # Of an earlier run.
            target.unlink(missing_ok=True)
            wrong += [] if mask is None else [mask]
    if found:
        say(f"{found} of {count} pictures have a mask, whose white pixels count in the fit.")
    if wrong:
        warnings.warn(
            f"{len(wrong)} masks, first {wrong[0]}, have another size than their picture, and are "
            "left out. Write them as large as the pictures.",
            CaptureWarning,
            stacklevel=2,
        )


def written_mask(copy: Path) -> Path:
    """Where the mask of a picture of a capture is, if it has one: that of `images/cam01/a.jpg` is
    `masks/cam01/a.jpg.png`. Frames of videos have none.

    Args:
        copy: the picture (`copy_media`).
    """
    camera = copy.parent
    return camera.parent.with_name(MASK_FOLDER) / camera.name / f"{copy.name}.png"


def write_matching_masks(
    files: Sequence[Path],
    index: Sequence[int],
    folder: Path,
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
) -> None:
    """Copy the masks of one camera's pictures for COLMAP, as `0003.jpg.png` of `0003.jpg`; white
    ones for pictures without, of which it would find no features otherwise.

    Args:
        files: the camera's file at each timestamp, in a capture.
        index: timestamps whose pictures are written (`write_matching_pictures`).
        folder: folder of the masks; made if it does not exist.
        names: names of the pictures' files.
        sizes: width and height in pixels of each picture.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for i, name, (width, height) in zip(index, names, sizes, strict=True):
        mask = written_mask(files[i])
        if mask.is_file():
            shutil.copyfile(mask, folder / f"{name}.png")
        else:
            write_image(folder / f"{name}.png", np.full((height, width, 3), 255, np.uint8))


def mask_of(picture: Path, *, alone: bool) -> Path | None:
    """The mask of a picture, by its name; None if there is none.

    That of `images/a.jpg` is `masks/a.png`, `masks/a.jpg.png` or `masks/a.jpg`, beside the folder
    of the pictures; that of `cam01/a.jpg` is in `masks/cam01/`, beside the camera's folder or one
    further up. Or they are in a folder `masks/` within that of the pictures. `mask/` serves as well
    as `masks/`.

    Args:
        picture: a photograph.
        alone: whether all pictures are in one folder; masks without a folder of a camera are not
            those of one of several folders.
    """
    camera = picture.parent
    homes = [camera.parent / name / camera.name for name in _FOLDERS]
    homes += [camera.parent.parent / name / camera.name for name in _FOLDERS]
    homes += [camera / name for name in _FOLDERS]
    homes += [camera.parent / name for name in _FOLDERS if alone]
    found = (mask_in(home, picture.name) for home in homes if home != camera)
    return next((mask for mask in found if mask is not None), None)


def _levels(mask: Path, picture: Path, copy: Path) -> UInt8[np.ndarray, "h w 3"] | None:
    """A mask upright, black and white; None if it has another size than its picture."""
    width, height = picture_size(mask)
    levels, wanted = read_levels(mask, width, height), picture_size(copy)
    if (width, height) != wanted and picture.suffix.lower() not in HEIC_SUFFIXES:
        # It may lie as the file of the picture does, which EXIF turns.
        levels = upright_pixels(levels, stored_orientation(open_image(picture).spec()))
    if levels.shape[1::-1] != wanted:
        return None
    white = levels.max(axis=-1, keepdims=True) >= 128
    return np.broadcast_to(np.where(white, 255, 0).astype(np.uint8), levels.shape)
