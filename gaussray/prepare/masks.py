"""Masks of pictures: which file beside the pictures it is, and where it goes in a capture."""

import functools
import shutil
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.mask_folder import MASK_FOLDER
from gaussray.capture.orientation import stored_orientation, upright_pixels
from gaussray.capture.picture_file import open_image, picture_size, read_levels
from gaussray.capture.videos import VIDEO_SUFFIXES, frame_of
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.input_files import files_in
from gaussray.prepare.mask_names import marked_masks, mask_of
from gaussray.prepare.mask_record import record_masks, recorded_masks
from gaussray.prepare.photographs import HEIC_SUFFIXES, PHOTOGRAPH_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline
from gaussray.prepare.video_masks import (
    MASK_FOLDERS,
    black_and_white,
    masks_of_video,
    write_video_masks,
)
from gaussray.runtime.output import counted
from gaussray.runtime.progress import say


class _Planned(NamedTuple):
    """A picture and its mask.

    Args:
        source: the camera.
        frame: index of its frame.
        copy: the picture in the capture.
        target: where its mask is in the capture.
        mask: the mask, or the masks of the video; None if there is none.
    """

    source: Source
    frame: int
    copy: Path
    target: Path
    mask: Path | None

    @property
    def is_new(self) -> bool:
        """Whether the mask is one that is to be written."""
        return self.mask is not None and self.mask.resolve() != self.target.resolve()


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
        PrepareError: A mask is needed, and no picture has one; those of a video do not fit it; or
            masks of another origin lie where those of the capture would be.
    """
    home = _home(files)
    ours = recorded_masks(home)
    # Pictures of one folder have names of their own, also if these say several cameras.
    alone = len({path.parent for source in sources for path in source.pictures}) == 1
    alone = alone and not any(source.is_video for source in sources)
    marked = functools.cache(marked_masks)
    videos = {one.name: _video_masks(one, home, ours) for one in sources if one.is_video}
    plans: list[_Planned] = []
    for source in sources:
        own = list(zip(timeline.frames[source.name].tolist(), files[source.name], strict=True))
        for i, copy in own:
            target = written_mask(copy)
            mask = (
                videos[source.name]
                if source.is_video
                else mask_of(source.pictures[i], alone=alone, marked=marked, ours=ours)
            )
            plans.append(_Planned(source, i, copy, target, _kept(mask, target, ours)))
    # Nothing is changed before everything is known, and nothing removed that is not ours.
    written = {plan.target.resolve() for plan in plans if plan.is_new}
    if written:
        record_masks(home, ours | written)
    wrong = []
    for source in sources:
        own_plans = [plan for plan in plans if plan.source is source]
        masks = videos.get(source.name)
        if masks is not None:
            write_video_masks(source, masks, {plan.frame: plan.target for plan in own_plans})
        elif not source.is_video:
            wrong += [plan for plan in own_plans if not _copy_mask(plan)]
    written -= {plan.target.resolve() for plan in wrong}
    for path in ours - written:
        path.unlink(missing_ok=True)
    if ours | written:
        record_masks(home, written)
    count, found = len(plans), sum(plan.mask is not None for plan in plans) - len(wrong)
    if found:
        say(f"{found} of {count} pictures have a mask, whose white pixels count in the fit.")
    if wrong:
        warnings.warn(
            f"{len(wrong)} masks, first {wrong[0].mask}, have another size than their picture, and "
            "are left out. Write them as large as the pictures.",
            CaptureWarning,
            stacklevel=2,
        )
    if not found:
        _tell_none(sources, alone, needed, bool(wrong))


def check_masks(sources: Sequence[Source], out: Path) -> None:
    """Refuse masks of videos that lie where those of the capture are written.

    Args:
        sources: the cameras.
        out: the capture's folder, of which nothing has been changed yet.

    Raises:
        PrepareError: There are such masks.
    """
    home = out / MASK_FOLDER
    ours = recorded_masks(home)
    for source in sources:
        if source.is_video:
            _video_masks(source, home, ours)


def _video_masks(source: Source, home: Path, ours: Collection[Path]) -> Path | None:
    """The masks of a video, which must not lie where those of the capture are written."""
    masks, target = masks_of_video(source, ours), home / source.name
    if masks is not None and target.is_dir() and masks.samefile(target):
        raise PrepareError(
            f"{masks}: the masks of {source.path} must not lie in the folder that is written, got "
            f"out={home.parent}. Choose another folder as out."
        )
    return masks


def _kept(mask: Path | None, target: Path, ours: Collection[Path]) -> Path | None:
    """The mask of a picture: one of the input, else one that somebody has put into the capture.

    Args:
        mask: a mask, or masks, of the input.
        target: where the mask is in the capture.
        ours: masks that an earlier run has written.
    """
    if not target.is_file() or target.resolve() in ours:
        return mask
    if mask is not None and not mask.samefile(target):
        raise PrepareError(
            f"{target}: is a mask that no earlier run is known to have written, and would be "
            f"replaced by that of {mask}. Take one of them away, or choose another folder as out."
        )
    return target


def _copy_mask(plan: _Planned) -> bool:
    """Put the mask of a photograph, if it has one, into the capture; False if it has another size
    than the photograph."""
    if plan.mask is None:
        return True
    levels = _levels(plan.mask, plan.source.pictures[plan.frame], plan.copy)
    if levels is not None and plan.is_new:
        write_image(plan.target, levels)
    if levels is None and not plan.is_new:
        raise PrepareError(
            f"{plan.mask}: the mask must be as large as {plan.copy}, whose mask in the capture it "
            "is. Write it anew, or take it away."
        )
    return levels is not None


def _home(files: Mapping[str, Sequence[Path]]) -> Path:
    """The folder of masks of a capture with these files."""
    return written_mask(next(own[0] for own in files.values() if own)).parent.parent


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
