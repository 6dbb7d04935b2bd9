"""Points where stereo finds none: in every large pixel's colour, where other views show that too
(`agreement`). What nearly matches is a better start than random points, which hide everything
behind them.
"""

import numpy as np

from gaussray.capture.points import Points
from gaussray.color import srgb_decode
from gaussray.reconstruct.data.backdrop import BackdropColor, like_backdrop
from gaussray.reconstruct.initialize.stereo.agreement import WINDOW, agreeing_distance
from gaussray.reconstruct.initialize.stereo.neighbours import typical_spread
from gaussray.reconstruct.initialize.stereo.uncovered import VIEWS
from gaussray.reconstruct.initialize.stereo.view_sets import StereoViewSet, some_views
from gaussray.reconstruct.initialize.stereo.views import rays, stereo_views, unpacked


def guessed_points(
    seen: StereoViewSet, *, count: int, seed: int, plain: BackdropColor | None = None
) -> Points:
    """About `count` points at the distances where colours agree best, none on a plain backdrop.

    Args:
        seen: pictures that show what stands still.
        count: about how many pixels all reduced pictures have together.
        seed: of what distances differ by from the steps that are looked at.
        plain: the colour of a backdrop; None if there is none.
    """
    seen = some_views(seen, VIEWS)
    h, w = seen.pictures.shape[1:3]
    factor = int(np.ceil(np.sqrt(len(seen.frames) * h * w / max(count, 1))))
    factor = int(np.clip(factor, 1, min(h, w) // (2 * WINDOW) or 1))
    views = stereo_views(seen.pictures, seen.cameras, seen.masks, factor=factor)
    spread, dice = np.asarray(typical_spread(views)), np.random.default_rng([seed, 5])
    places, colors = [], []
    for i in range(len(seen.frames)):
        own = views[i]
        ray = np.asarray(rays(own.lens, own.world_from_camera, own.size, own.factor))
        channels, counts = unpacked(own.pixel, ray.dtype)
        color, shown = np.stack(channels), np.asarray(counts) & np.any(ray != 0, axis=0)
        away = agreeing_distance(views, i, spread, dice)
        if plain is not None:
            shown &= ~like_backdrop(np.moveaxis(color, 0, -1), plain)
        places.append((np.asarray(own.origin)[:, None] + ray[:, shown] * away[shown]).T)
        colors.append(color[:, shown].T)
    color = np.concatenate([np.zeros((0, 3)), *colors]).astype(np.float64)
    place = np.concatenate([np.zeros((0, 3)), *places])
    return Points(place.astype(np.float32), srgb_decode(color).astype(np.float32))
