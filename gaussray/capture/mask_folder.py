"""Masks that lie in a folder `masks/` beside the pictures, as COLMAP and nerfstudio keep them."""

import dataclasses
import warnings
from pathlib import Path

import numpy as np

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.frames import mask_values
from gaussray.capture.picture_file import picture_size
from gaussray.capture.spread import evenly_spread


MASK_FOLDER = "masks"
# How far from black and white the levels of a mask may be (JPEG), and the share of its pixels that
# must not be farther: edges are grey.
_EDGE, _PLAIN = 0.1, 0.8
# Masks of which one must look like one, as some hide all of their pictures; and about how many of
# their columns or rows are looked at.
_LOOKED_AT, _SIDE = 8, 1000
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
    views, home = capture.all_views, capture.folder / MASK_FOLDER
    masks = {view.image: mask for view in views if (mask := _mask(capture.folder, view))}
    other = _other_than_masks(list(masks.values()))
    if other is not None:
        warnings.warn(
            f"{home}: its files, such as {other.name}, are not used: masks are black and white, "
            "and white where a pixel counts.",
            CaptureWarning,
            stacklevel=4,
        )
        return capture
    if not masks:
        there = sorted(path.name for path in home.glob("*.*")) if home.is_dir() else []
        if there:
            warnings.warn(
                f"{home}: its {len(there)} files, such as {there[0]}, are not used: a mask has the "
                "name of its picture, so that of images/a.jpg is masks/a.png or masks/a.jpg.png, "
                "and that of rgb/a.jpg masks/rgb/a.png.",
                CaptureWarning,
                stacklevel=4,
            )
        return capture
    warnings.warn(
        f"{home}: {sum(view.image in masks for view in views)} of {len(views)} pictures have a "
        "mask there; its "
        "white pixels count. Rename the folder to use all pixels.",
        CaptureWarning,
        stacklevel=4,
    )

    def masked(views: list[View]) -> list[View]:
        return [
            dataclasses.replace(view, mask=masks[view.image]) if view.image in masks else view
            for view in views
        ]

    return capture.with_views(masked)


def _other_than_masks(files: list[Path]) -> Path | None:
    """A file that is no mask, if none of some files is one; what is all black tells nothing."""
    other = None
    for path in evenly_spread(files, _LOOKED_AT):
        is_mask = _is_mask(path)
        if is_mask:
            return None
        if is_mask is False:
            other = other or path
    return other


def _is_mask(path: Path) -> bool | None:
    """Whether nearly all pixels of a picture, or of the alpha that cuts it out, are black or white:
    label maps and colours of instances are not masks. None if all are black."""
    try:
        values = mask_values(path, *picture_size(path))
    except (OSError, CaptureError):
        # Its reader tells what is wrong with it.
        return True
    step = -(-max(values.shape[:2]) // _SIDE)
    values = values[::step, ::step]
    if not values.any():
        return None
    share = values / np.float32(np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1)
    white = (np.abs(share - 1) < _EDGE).all(axis=2)
    return bool(white.any() and np.mean(white | (share < _EDGE).all(axis=2)) > _PLAIN)


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
