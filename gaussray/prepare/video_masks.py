"""Masks of a video's frames: a video of masks, or a numbered picture for each frame."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.mask_folder import MASK_FOLDER
from gaussray.capture.picture_file import picture_size, read_levels
from gaussray.capture.video_file import decoded_frames, upright
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.dataset.images import write_image
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.input_files import files_in
from gaussray.prepare.mask_record import recorded_masks
from gaussray.prepare.photographs import PHOTOGRAPH_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.unused_inputs import MASK_MARK, camera_videos
from gaussray.runtime.output import first_of


MASK_FOLDERS = (MASK_FOLDER, "mask")


def find_video_masks(sources: Sequence[Source], out: Path) -> dict[str, Path | None]:
    """The masks of each camera that is a video (`masks_of_video`) by its name; None if it has none.

    Args:
        sources: the cameras.
        out: the capture's folder, of which nothing has been changed yet.

    Raises:
        PrepareError: A video has several, or they lie where those of the capture are written.
    """
    home = out / MASK_FOLDER
    ours = recorded_masks(home)
    found: dict[str, Path | None] = {}
    for source in sources:
        if source.is_video:
            masks, target = masks_of_video(source, ours), home / source.name
            if masks is not None and target.is_dir() and masks.samefile(target):
                raise PrepareError(
                    f"{masks}: the masks of {source.path} must not lie in the folder that is "
                    f"written, got out={out}. Choose another folder as out."
                )
            found[source.name] = masks
    return found


def masks_of_video(source: Source, ours: Collection[Path] = ()) -> Path | None:
    """The video or the folder of a video's masks; None if there is none.

    Those of `cam0.mp4` are `masks/cam0.mp4`, `cam0_mask.mp4` or the pictures in `masks/cam0/`; of a
    video that is alone in its folder also the pictures in `masks/`. The folder `masks/` (or
    `mask/`) is beside the video or one further up; there, masks have the name of the camera, which
    is that of the video's folder if it has one of its own.

    Args:
        source: a camera that is a video.
        ours: masks that an earlier run has written (`recorded_masks`), which are none of the input.

    Raises:
        PrepareError: There are several.
    """
    home, camera = source.path.parent, {source.name.lower()}
    names = {source.path.stem.lower(), *camera}
    beside = [path for path in files_in(home, VIDEO_SUFFIXES) if path not in camera_videos(home)]
    found = [path for path in beside if MASK_MARK.sub("", path.stem.lower()) in names]
    places = [up / name for up in (home, home.parent) for name in MASK_FOLDERS]
    for place in (place for place in places if place.is_dir()):
        called = names if place.parent == home else camera
        videos = files_in(place, VIDEO_SUFFIXES)
        found += [path for path in videos if MASK_MARK.sub("", path.stem.lower()) in called]
        found += _with_pictures(place / source.name, ours)
    if len(camera_videos(home)) == 1:
        found += [one for name in MASK_FOLDERS for one in _with_pictures(home / name, ours)]
    if len(found) > 1:
        raise PrepareError(
            f"{source.path}: must have one video or folder of masks, got "
            f"{first_of([str(path) for path in found])}. Take away all but one."
        )
    return found[0] if found else None


def write_video_masks(source: Source, masks: Path, targets: Mapping[int, Path]) -> None:
    """Write the masks of some frames of a video as PNG, black and white; white pixels count.

    Args:
        source: the video.
        masks: a video or a folder of pictures (`masks_of_video`).
        targets: the file of the mask of each frame that is used.

    Raises:
        PrepareError: There are not as many masks as frames, or they have another size.
    """
    count = 0
    for place, levels in enumerate(_masks(masks, source)):
        if levels.shape[1::-1] != source.size(0):
            _refuse(source, masks, f"of {source.width} x {source.height}", levels.shape[1::-1])
        if place in targets:
            write_image(targets[place], black_and_white(levels))
        count = place + 1
    if count != source.count:
        _refuse(source, masks, f"for each of its {source.count} frames", (count,))


def black_and_white(levels: UInt8[np.ndarray, "h w channels"]) -> UInt8[np.ndarray, "h w 3"]:
    """A mask of white pixels where one of the colours has at least half of its range, else black.

    Args:
        levels: the mask as its file has it.
    """
    white = levels.max(axis=-1, keepdims=True) >= 128
    return np.broadcast_to(np.where(white, 255, 0).astype(np.uint8), (*levels.shape[:2], 3))


def _masks(masks: Path, source: Source) -> Iterator[UInt8[np.ndarray, "h w channels"]]:
    """All masks in their order."""
    if masks.is_dir():
        pictures = files_in(masks, PHOTOGRAPH_SUFFIXES)
        # Known before anything is read.
        if len(pictures) != source.count:
            _refuse(source, masks, f"for each of its {source.count} frames", (len(pictures),))
        for picture in pictures:
            yield read_levels(picture, *picture_size(picture))
    else:
        for frame in decoded_frames(masks):
            yield upright(masks, frame)


def _refuse(source: Source, masks: Path, rule: str, got: tuple[int, ...]) -> None:
    raise PrepareError(
        f"{masks}: the masks of {source.path} must be one {rule}, got "
        f"{' x '.join(map(str, got))}. Write them anew, or take them away to use all pixels."
    )


def _with_pictures(folder: Path, ours: Collection[Path]) -> list[Path]:
    """The folder, if it holds pictures that no earlier run has written."""
    pictures = files_in(folder, PHOTOGRAPH_SUFFIXES) if folder.is_dir() else []
    return [folder] if any(path.resolve() not in ours for path in pictures) else []
