"""Cameras that were covered or broken: what they show would become part of the scene."""

import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.frames import read_with_mask
from gaussray.capture.spread import evenly_spread
from gaussray.reconstruct.data.backdrop import BackdropColor, surrounds
from gaussray.runtime.output import listed_names
from gaussray.runtime.progress import Progress


# A picture shows one colour if no more than this share of its pixels differs from the median colour
# by more than so much of 1, in any channel: noise and JPEG stay below.
_DETAIL, _NOISE = 1e-3, 0.03
# Pictures of a camera that are looked at, at most: the first, and only where it shows one colour,
# others, evenly spread.
_LOOKED_AT = 5
# Pixels of a picture that are compared, about, at most.
_PIXELS = 250_000
_THREADS = 4
# Seconds after which progress is shown.
_PATIENCE = 2.0
# Names of cameras that a warning lists, at most.
_NAMED = 4


def without_covered_cameras(capture: Capture, *, quiet: bool = True) -> Capture:
    """The capture without the training pictures of cameras that show a single colour, with a
    warning that names them.

    Where that colour is the backdrop of other cameras' pictures, they stay: nothing stands before
    it. So they do where all cameras show a single colour.

    Args:
        capture: the capture.
        quiet: whether no progress is shown. Large photographs take seconds to decode.
    """
    cameras: dict[str, list[View]] = {}
    for view in capture.views:
        if view.split == "train":
            cameras.setdefault(view.camera_name, []).append(view)
    with ThreadPoolExecutor(_THREADS) as pool:
        progress = Progress("cameras", len(cameras), quiet=quiet, patience=_PATIENCE)
        plain: dict[str, BackdropColor] = {}
        found = zip(cameras, pool.map(_plain_color, cameras.values()), strict=True)
        for done, (name, color) in enumerate(found, 1):
            plain |= {} if color is None else {name: color}
            progress.report(done)
    if not plain or len(plain) == len(cameras):
        return capture
    border = np.concatenate([_border(cameras[name][0]) for name in cameras if name not in plain])
    covered = sorted(name for name, color in plain.items() if not surrounds(border, color))
    if not covered:
        return capture
    warnings.warn(
        f"the pictures of {listed_names(covered, most=_NAMED)} show a single colour, as those of a "
        "camera that is covered, broken or inside of something: they are left out.",
        CaptureWarning,
        stacklevel=2,
    )
    kept = [v for v in capture.views if v.split != "train" or v.camera_name not in covered]
    return replace(capture, views=kept)


def _plain_color(views: Sequence[View]) -> BackdropColor | None:
    """The sRGB-encoded colour that a camera shows and nothing else; None if its pictures show more,
    or all their pixels are masked."""
    color = None
    for shown in _colors(evenly_spread(views, _LOOKED_AT)):
        if not len(shown):
            continue
        red, green, blue = np.median(shown, axis=0).tolist()
        color = red, green, blue
        differs = np.any(np.abs(shown - np.array(color, np.float32)) > _NOISE, axis=1)
        if differs.mean() > _DETAIL:
            return None
    return color


def _colors(views: Sequence[View]) -> Iterator[Float[np.ndarray, "pixels 3"]]:
    """The sRGB-encoded colours of pixels of each view that count. Nothing is said of transparent
    ones: the fit reads all pictures later, and tells of how many."""
    for view in views:
        picture, mask = read_with_mask(view, quiet=True)
        shown = picture.reshape(-1, 3) if mask is None else picture[mask]
        yield _in_unit(shown[:: max(len(shown) // _PIXELS, 1)])


def _in_unit(encoded: np.ndarray) -> Float[np.ndarray, "pixels 3"]:
    """sRGB-encoded colours in 0..1."""
    return encoded.astype(np.float32) / (255 if encoded.dtype == np.uint8 else 1)


def _border(view: View) -> Float[np.ndarray, "pixels 3"]:
    """The sRGB-encoded colours at the border of a picture."""
    picture, mask = read_with_mask(view, quiet=True)
    edge = np.ones(picture.shape[:2], bool) if mask is None else mask
    edge[1:-1, 1:-1] = False
    return _in_unit(picture[edge])
