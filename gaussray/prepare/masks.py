"""Masks of photographs: which file beside the pictures it is, and where it goes in a capture."""

import functools
import re
import shutil
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.mask_folder import MASK_FOLDER, mask_in
from gaussray.capture.orientation import stored_orientation, upright_pixels
from gaussray.capture.picture_file import open_image, picture_size, read_levels
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.input_files import files_in
from gaussray.prepare.photographs import HEIC_SUFFIXES, PHOTOGRAPH_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline
from gaussray.runtime.output import counted, first_of
from gaussray.runtime.progress import say


_FOLDERS = (MASK_FOLDER, "mask")
# What a mask may have behind the name of its picture: a_mask.png, a.mask.png.
_MARK = re.compile(r"[ ._-]masks?$")
# The masks of a folder by the names of their pictures without suffix, in small letters.
MarkedMasks = dict[str, Path]


def copy_masks(
    sources: Sequence[Source],
    timeline: Timeline,
    files: dict[str, list[Path]],
    *,
    needed: bool = False,
) -> None:
    """Put the masks of photographs into a capture, as `masks/CAMERA/a.jpg.png` of
    `images/CAMERA/a.jpg`, upright as the pictures are; white pixels count.

    A line says how many pictures have one, a warning how many masks have another size than their
    picture, which are left out, or that a folder of masks has none of these pictures or is of a
    video, whose masks are not read.

    Args:
        sources: the cameras.
        timeline: the frames that are used.
        files: for each camera the copied picture of each timestamp.
        needed: whether there must be a mask (`poses.masks`).

    Raises:
        PrepareError: A mask is needed, and no picture has one.
    """
    _warn_of_masks_of_videos(sources)
    found, wrong, count = 0, [], 0
    # Pictures of one folder have names of their own, also if these say several cameras.
    alone = len({path.parent for source in sources for path in source.pictures}) == 1
    alone = alone and not any(source.is_video for source in sources)
    marked = functools.cache(marked_masks)
    for source in sources:
        for i, copy in zip(timeline.frames[source.name], files[source.name], strict=True):
            if source.is_video:
                continue
            target = written_mask(copy)
            mask = mask_of(source.pictures[i], alone=alone, marked=marked)
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
    if not found:
        _tell_none(sources, alone, needed, bool(wrong))


def _warn_of_masks_of_videos(sources: Sequence[Source]) -> None:
    """Warn of folders of masks that belong to videos: beside a video that is alone in its folder,
    or of the camera's name in a folder of masks."""
    found: dict[Path, Source] = {}
    for source in (source for source in sources if source.is_video):
        home = source.path.parent
        alone = len(files_in(home, VIDEO_SUFFIXES)) == 1
        places = [home / name for name in _FOLDERS] if alone else []
        places += [up / name / source.name for up in (home, home.parent) for name in _FOLDERS]
        for place in places:
            if place.is_dir() and files_in(place, PHOTOGRAPH_SUFFIXES):
                found.setdefault(place, source)
    if found:
        place, source = next(iter(found.items()))
        inner = source.path.stem != source.name
        folder = source.path.parent if inner else source.path.with_suffix("")
        # In the name of numbered files, ffmpeg takes %% for %.
        frames = f"{str(folder).replace('%', '%%')}/%06d.png"
        warnings.warn(
            f"{first_of([str(path) for path in found])}: masks are not read with videos. To use "
            "masks, write the frames of each video as pictures into a folder of its camera, "
            f"`mkdir -p {quote(str(folder))} && ffmpeg -i {quote(str(source.path))} "
            f"-fps_mode passthrough {quote(frames)}`, move the video out of the input, and call "
            "the masks as the pictures.",
            CaptureWarning,
            stacklevel=3,
        )


def _tell_none(sources: Sequence[Source], alone: bool, needed: bool, wrong: bool) -> None:
    """Warn of a folder of masks that has none of the pictures; refuse that masks are needed.

    Args:
        sources: the cameras.
        alone: whether all pictures are in one folder.
        needed: whether there must be a mask.
        wrong: whether there are masks of another size, which are told already.
    """
    first = next((source.pictures[0] for source in sources if source.pictures), None)
    expected = None if first is None else _expected_mask(first, alone)
    if needed:
        remedy = (
            "Videos have none: write their frames as pictures, or set poses.masks=false."
            if expected is None
            else f"The mask of {first} would be {expected}. Put it there, or set poses.masks=false."
        )
        reason = "none of the size of its picture" if wrong else "none"
        raise PrepareError(f"poses.masks=true needs masks of the pictures, got {reason}. {remedy}")
    if expected is None or wrong:
        return
    # Files of several cameras may lie beside the folder of this one's masks.
    further = expected.parent.parent
    homes = [expected.parent, *([further] if further.name in _FOLDERS else [])]
    homes = [home for home in homes if home.is_dir()]
    if masks := [path for home in homes for path in files_in(home, PHOTOGRAPH_SUFFIXES)]:
        warnings.warn(
            f"{masks[0].parent}: no picture has its name in {counted(len(masks), 'file')}, such as "
            f"{masks[0].name}, so no mask is used. That of {first} would be {expected}.",
            CaptureWarning,
            stacklevel=3,
        )


def _expected_mask(picture: Path, alone: bool) -> Path:
    """A file that would be the mask of a picture, in the folder of masks that there is."""
    camera = picture.parent
    homes = [place / name for place in (camera, camera.parent) for name in _FOLDERS]
    homes += [] if alone else [camera.parent.parent / name for name in _FOLDERS]
    default = camera.parent / MASK_FOLDER
    home = next((home for home in homes if home.is_dir() and home != camera), default)
    if not alone and home.parent != camera:
        home = home / camera.name
    return home / f"{picture.stem}.png"


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


def marked_masks(folder: Path) -> MarkedMasks:
    """The masks of a folder that are called as their picture and `_mask` or `.mask`, in letters of
    any case, by the picture's name without suffix in small letters.

    Args:
        folder: a folder of masks, which may not exist.
    """
    files = files_in(folder, PHOTOGRAPH_SUFFIXES) if folder.is_dir() else []
    found: MarkedMasks = {}
    # Of several of one picture a PNG counts first: a JPEG blurs the border.
    for path in sorted(files, key=lambda path: path.suffix.lower() != ".png"):
        stem = path.stem.lower()
        if _MARK.search(stem):
            found.setdefault(_MARK.sub("", stem), path)
    return found


def mask_of(
    picture: Path, *, alone: bool, marked: Callable[[Path], MarkedMasks] = marked_masks
) -> Path | None:
    """The mask of a picture, by its name; None if there is none.

    That of `images/a.jpg` is `masks/a.png`, `masks/a.jpg.png`, `masks/a.jpg`, `masks/a_mask.png`
    or `masks/a.mask.png`, beside the folder of the pictures; that of `cam01/a.jpg` is in
    `masks/cam01/`, beside the camera's folder or one further up. Or they are in a folder `masks/`
    within that of the pictures. `mask/` serves as well as `masks/`.

    Args:
        picture: a photograph.
        alone: whether all pictures are in one folder; masks without a folder of a camera are not
            those of one of several folders.
        marked: `marked_masks`, or the same with a memory, for many pictures of one folder.
    """
    camera = picture.parent
    homes = [camera.parent / name / camera.name for name in _FOLDERS]
    homes += [camera.parent.parent / name / camera.name for name in _FOLDERS]
    homes += [camera / name for name in _FOLDERS]
    homes += [camera.parent / name for name in _FOLDERS if alone]
    names = picture.stem.lower(), picture.name.lower()
    for home in (home for home in homes if home != camera):
        if (mask := mask_in(home, picture.name)) is not None:
            return mask
        if mask := next((marked(home)[name] for name in names if name in marked(home)), None):
            return mask
    return None


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
