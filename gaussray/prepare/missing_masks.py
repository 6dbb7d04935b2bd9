"""What is told where no picture has a mask: where one would be, and which files are none."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.mask_folder import MASK_FOLDER
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.input_files import files_in
from gaussray.prepare.photographs import PHOTOGRAPH_SUFFIXES
from gaussray.prepare.sources import Source
from gaussray.prepare.video_masks import MASK_FOLDERS
from gaussray.runtime.output import counted


def refuse_without_masks(sources: Sequence[Source], *, alone: bool, wrong: bool) -> NoReturn:
    """Refuse that masks are needed (`poses.masks`) where there are none.

    Args:
        sources: the cameras.
        alone: whether all pictures are in one folder.
        wrong: whether there are masks of another size than their picture.

    Raises:
        PrepareError: Always, with the place of a mask.
    """
    first = _first_photograph(sources)
    remedy = (
        _video_remedy(sources[0])
        if first is None
        else f"The mask of {first} would be {_expected_mask(first, alone)}. Put it there, or set "
        "poses.masks=false."
    )
    reason = "none of the size of its picture" if wrong else "none"
    raise PrepareError(f"poses.masks=true needs masks of the pictures, got {reason}. {remedy}")


def warn_of_unused_masks(sources: Sequence[Source], *, alone: bool) -> None:
    """Warn of a folder of masks that has none of the pictures, or videos.

    Args:
        sources: the cameras, none of which has a mask.
        alone: whether all pictures are in one folder.
    """
    first = _first_photograph(sources)
    if first is None:
        _warn_of_other_videos(sources)
        return
    expected = _expected_mask(first, alone)
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


def _first_photograph(sources: Sequence[Source]) -> Path | None:
    """The first photograph of the input; None if all cameras are videos."""
    return next((source.pictures[0] for source in sources if source.pictures), None)


def _video_remedy(source: Source) -> str:
    """Where the masks of a video would be."""
    place = source.path.parent / MASK_FOLDER / source.name
    return (
        f"Those of {source.path} would be {place}{source.path.suffix} (as many frames) or pictures "
        f"in {place}/ (one for each frame). Put them there, or set poses.masks=false."
    )


def _warn_of_other_videos(sources: Sequence[Source]) -> None:
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
