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
from gaussray.capture.videos import frame_of
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.mask_names import marked_masks, mask_of
from gaussray.prepare.mask_record import record_masks, recorded_masks
from gaussray.prepare.missing_masks import refuse_without_masks, warn_of_unused_masks
from gaussray.prepare.photographs import HEIC_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.timeline import Timeline
from gaussray.prepare.video_masks import black_and_white, write_video_masks
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
    video_masks: Mapping[str, Path | None],
    out: Path,
    *,
    needed: bool,
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
        video_masks: the masks of each camera that is a video (`find_video_masks`).
        out: the capture's folder.
        needed: whether there must be a mask (`poses.masks`).

    Raises:
        PrepareError: A mask is needed, and no picture has one; those of a video do not fit it; or
            masks of another origin lie where those of the capture would be.
    """
    home = out / MASK_FOLDER
    ours = recorded_masks(home)
    # Pictures of one folder have names of their own, also if these say several cameras.
    alone = len({path.parent for source in sources for path in source.pictures}) == 1
    alone = alone and not any(source.is_video for source in sources)
    plans = _planned(sources, timeline, files, video_masks, alone, ours)
    wrong = _write_masks(sources, plans, video_masks, home, ours)
    masks = [plan.mask for own in plans.values() for plan in own]
    count, found = len(masks), sum(mask is not None for mask in masks) - len(wrong)
    if found:
        say(f"{found} of {count} pictures have a mask, whose white pixels count in the fit.")
    if wrong:
        warnings.warn(
            f"{len(wrong)} masks, first {wrong[0].mask}, have another size than their picture, and "
            "are left out. Write them as large as the pictures.",
            CaptureWarning,
            stacklevel=2,
        )
    if not found and needed:
        refuse_without_masks(sources, alone=alone, wrong=bool(wrong))
    if not found and not wrong:
        warn_of_unused_masks(sources, alone=alone)


def _planned(
    sources: Sequence[Source],
    timeline: Timeline,
    files: Mapping[str, Sequence[Path]],
    video_masks: Mapping[str, Path | None],
    alone: bool,
    ours: Collection[Path],
) -> dict[str, list[_Planned]]:
    """The pictures of each camera in a capture and their masks; nothing is changed yet.

    Args:
        sources: the cameras.
        timeline: the frames that are used.
        files: for each camera the copied picture of each timestamp.
        video_masks: the masks of each camera that is a video.
        alone: whether all pictures are in one folder.
        ours: masks that an earlier run has written.
    """
    marked = functools.cache(marked_masks)
    plans: dict[str, list[_Planned]] = {}
    for source in sources:
        own = plans[source.name] = []
        frames = timeline.frames[source.name].tolist()
        for i, copy in zip(frames, files[source.name], strict=True):
            target = written_mask(copy)
            mask = (
                video_masks[source.name]
                if source.is_video
                else mask_of(source.pictures[i], alone=alone, marked=marked, ours=ours)
            )
            own.append(_Planned(source, i, copy, target, _kept(mask, target, ours)))
    return plans


def _write_masks(
    sources: Sequence[Source],
    plans: Mapping[str, Sequence[_Planned]],
    video_masks: Mapping[str, Path | None],
    home: Path,
    ours: frozenset[Path],
) -> list[_Planned]:
    """Write the masks, record them, and remove those of an earlier run that are none any more.

    Args:
        sources: the cameras.
        plans: the pictures of each, all of which are known before anything is changed.
        video_masks: the masks of each camera that is a video.
        home: the capture's folder of masks.
        ours: masks that an earlier run has written; no others are removed.

    Returns:
        The photographs whose mask has another size, which is left out.
    """
    written = {plan.target.resolve() for own in plans.values() for plan in own if plan.is_new}
    if written:
        record_masks(home, ours | written)
    wrong: list[_Planned] = []
    for source in sources:
        own, masks = plans[source.name], video_masks.get(source.name)
        if masks is not None:
            write_video_masks(source, masks, {plan.frame: plan.target for plan in own})
        elif not source.is_video:
            wrong += [plan for plan in own if not _copy_mask(plan)]
    written -= {plan.target.resolve() for plan in wrong}
    for path in ours - written:
        path.unlink(missing_ok=True)
    if ours | written:
        record_masks(home, written)
    return wrong


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
