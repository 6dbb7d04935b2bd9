"""Masks of pictures: which file beside the pictures it is, and where it goes in a capture."""

import functools
import shutil
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.mask_folder import MASK_FOLDER, mask_in
from gaussray.capture.orientation import stored_orientation, upright_pixels
from gaussray.capture.picture_file import open_image, picture_size, read_levels
from gaussray.capture.videos import VIDEO_SUFFIXES, frame_of
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.input_files import files_in
from gaussray.prepare.photographs import HEIC_SUFFIXES, PHOTOGRAPH_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline
from gaussray.prepare.unused_inputs import MASK_MARK
from gaussray.prepare.video_masks import (
    MASK_FOLDERS,
    black_and_white,
    masks_of_video,
    write_video_masks,
)
from gaussray.runtime.output import counted
from gaussray.runtime.progress import say


# The masks of a folder by the names of their pictures without suffix, in small letters.
MarkedMasks = dict[str, Path]


def copy_masks(
    sources: Sequence[Source],
    timeline: Timeline,
    files: dict[str, list[Path]],
    *,
    needed: bool = False,
) -> None:
    """Put the masks of pictures into a capture, as `masks/CAMERA/a.jpg.png` of
    `images/CAMERA/a.jpg`, upright as the pictures are, and as `masks/CAMERA/0003.png` of frame 3 of
    a video; white pixels count.

    A line says how many pictures have one, a warning how many masks have another size than their
    photograph, which are left out, or that a folder of masks has none of these pictures.

    Args:
        sources: the cameras.
        timeline: the frames that are used.
        files: for each camera the copied picture of each timestamp.
        needed: whether there must be a mask (`poses.masks`).

    Raises:
        PrepareError: A mask is needed, and no picture has one; or those of a video do not fit it.
    """
    found, wrong, count = 0, [], 0
    # Pictures of one folder have names of their own, also if these say several cameras.
    alone = len({path.parent for source in sources for path in source.pictures}) == 1
    alone = alone and not any(source.is_video for source in sources)
    marked = functools.cache(marked_masks)
    for source in sources:
        if source.is_video:
            masks = _copy_video_masks(source, timeline.frames[source.name], files[source.name])
            found, count = found + masks, count + len(files[source.name])
            continue
        for i, copy in zip(timeline.frames[source.name], files[source.name], strict=True):
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


def _copy_video_masks(source: Source, frames: np.ndarray, files: Sequence[Path]) -> int:
    """Put the masks of the used frames of a video into a capture, and count them."""
    targets = {int(i): written_mask(copy) for i, copy in zip(frames, files, strict=True)}
    masks = masks_of_video(source)
    for target in targets.values():
        # Of an earlier run.
        target.unlink(missing_ok=True)
    if masks is None:
        return 0
    write_video_masks(source, masks, targets)
    return len(files)


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
            _video_remedy(sources[0])
            if expected is None
            else f"The mask of {first} would be {expected}. Put it there, or set poses.masks=false."
        )
        reason = "none of the size of its picture" if wrong else "none"
        raise PrepareError(f"poses.masks=true needs masks of the pictures, got {reason}. {remedy}")
    if expected is None:
        _tell_other_videos(sources)
    if expected is None or wrong:
        return
    # Files of several cameras may lie beside the folder of this one's masks.
    further = expected.parent.parent
    homes = [expected.parent, *([further] if further.name in MASK_FOLDERS else [])]
    homes = [home for home in homes if home.is_dir()]
    if masks := [path for home in homes for path in files_in(home, PHOTOGRAPH_SUFFIXES)]:
        warnings.warn(
            f"{masks[0].parent}: no picture has its name in {counted(len(masks), 'file')}, such as "
            f"{masks[0].name}, so no mask is used. That of {first} would be {expected}.",
            CaptureWarning,
            stacklevel=3,
        )


def _video_remedy(source: Source) -> str:
    """Where the masks of a video would be."""
    place = source.path.parent / MASK_FOLDER / source.name
    return (
        f"Those of {source.path} would be {place}{source.path.suffix} (as many frames) or pictures "
        f"in {place}/ (one for each frame). Put them there, or set poses.masks=false."
    )


def _tell_other_videos(sources: Sequence[Source]) -> None:
    """Warn of videos of masks that have the name of no camera."""
    homes = {source.path.parent / name: source for source in sources for name in MASK_FOLDERS}
    for home, source in homes.items():
        if home.is_dir() and (videos := files_in(home, VIDEO_SUFFIXES)):
            warnings.warn(
                f"{home}: no video has the name of {videos[0].name}, so no mask is used. That of "
                f"{source.path} would be {home / source.path.name}.",
                CaptureWarning,
                stacklevel=4,
            )
            return


def _expected_mask(picture: Path, alone: bool) -> Path:
    """A file that would be the mask of a picture, in the folder of masks that there is."""
    camera = picture.parent
    homes = [place / name for place in (camera, camera.parent) for name in MASK_FOLDERS]
    homes += [] if alone else [camera.parent.parent / name for name in MASK_FOLDERS]
    default = camera.parent / MASK_FOLDER
    home = next((home for home in homes if home.is_dir() and home != camera), default)
    if not alone and home.parent != camera:
        home = home / camera.name
    return home / f"{picture.stem}.png"


def written_mask(copy: Path) -> Path:
    """Where the mask of a picture of a capture is, if it has one: that of `images/cam01/a.jpg` is
    `masks/cam01/a.jpg.png`, that of frame 3 of `videos/cam01.mp4` is `masks/cam01/0003.png`.

    Args:
        copy: the picture (`copy_media`).
    """
    camera = copy.parent
    name = camera.stem if frame_of(copy) else camera.name
    return camera.parent.with_name(MASK_FOLDER) / name / f"{copy.name}.png"


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
        if MASK_MARK.search(stem):
            found.setdefault(MASK_MARK.sub("", stem), path)
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
    homes = [camera.parent / name / camera.name for name in MASK_FOLDERS]
    homes += [camera.parent.parent / name / camera.name for name in MASK_FOLDERS]
    homes += [camera / name for name in MASK_FOLDERS]
    homes += [camera.parent / name for name in MASK_FOLDERS if alone]
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
    return black_and_white(levels)
