"""Masks that lie in a folder `masks/` beside the pictures, as COLMAP and nerfstudio keep them."""

import dataclasses
import warnings
from pathlib import Path

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureWarning


MASK_FOLDER = "masks"
_SUFFIXES = (".png", ".PNG", ".jpg", ".JPG", ".jpeg")


def with_mask_folder(capture: Capture) -> Capture:
    """The capture with the masks that lie in `masks/` beside the folder of its pictures.

    The mask of `images/a/b.jpg` is `masks/a/b.jpg.png` (COLMAP), `masks/a/b.png` (nerfstudio) or a
    picture of this name with another suffix. White pixels count. A warning tells how many pictures
    have one, or that none of the files is one. A capture whose files name masks is left as it is.

    Args:
        capture: the capture.
    """
    if any(view.mask is not None for view in capture.all_views):
        return capture
    masks = [_mask(capture.folder, view) for view in capture.views]
    found = sum(mask is not None for mask in masks)
    home = capture.folder / MASK_FOLDER
    if not found:
        there = sorted(path.name for path in home.glob("*.*")) if home.is_dir() else []
        if there:
            warnings.warn(
                f"{home}: its {len(there)} files, such as {there[0]}, are not used: a mask has the "
                "name of its picture, so that of images/a.jpg is masks/a.png or masks/a.jpg.png.",
                CaptureWarning,
                stacklevel=4,
            )
        return capture
    warnings.warn(
        f"{home}: {found} of {len(masks)} pictures have a mask there; its "
        "white pixels count. Rename the folder to use all pixels.",
        CaptureWarning,
        stacklevel=4,
    )
    views = [
        view if mask is None else dataclasses.replace(view, mask=mask)
        for view, mask in zip(capture.views, masks, strict=True)
    ]
    return dataclasses.replace(capture, views=views)


def _mask(folder: Path, view: View) -> Path | None:
    """The mask of a picture in the folder of masks; None if it has none there."""
    if not view.image.is_relative_to(folder):
        return None
    inner = view.image.relative_to(folder)
    if len(inner.parts) > 1 and inner.parts[0].startswith("images"):  # LLFF: images_2, images_4 ...
        inner = inner.relative_to(inner.parts[0])
    return mask_in(folder / MASK_FOLDER / inner.parent, inner.name)


def mask_in(folder: Path, name: str) -> Path | None:
    """The mask of a picture in a folder of masks; None if it has none there.

    Args:
        folder: the folder, which may not exist.
        name: name of the picture's file: the mask of `a.JPG` is `a.JPG.png` or `a` with a suffix.
    """
    names = f"{name}.png", name, *(f"{Path(name).stem}{suffix}" for suffix in _SUFFIXES)
    return next((folder / one for one in names if (folder / one).is_file()), None)
