"""The visual hull (Laurentini 1994): what masks leave of space that cut a thing out of pictures."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from gaussray.reconstruct.initialize.stereo.view_sets import StereoViewSet, small_views
from gaussray.reconstruct.initialize.stereo.views import places_in_view, unpacked


# By so many pixels of a reduced picture masks are wider than drawn: rims are uncertain.
_RIM = 2
# A place is outside if masks hide it in more than this share of the pictures that contain it. A
# hull in the strict sense is empty where a single mask is wrong.
_SHARE = 0.3


def outside_hull(
    seen: StereoViewSet, position: Float[np.ndarray, "places 3"]
) -> Bool[np.ndarray, " places"]:
    """Which places masks hide in too many of the pictures within whose frame they lie.

    Args:
        seen: pictures whose masks cut a thing out (`data.silhouettes`).
        position: the places, in the world.
    """
    views = small_views(seen)
    _, masks = unpacked(views.pixel, np.float32)
    hidden, within = np.zeros(len(position), int), np.zeros(len(position), int)
    places = jnp.asarray(position)
    for i, mask in enumerate(np.asarray(masks)):
        column, row, _, inside = jax.device_get(places_in_view(views, jnp.asarray(i), places))
        visible = np.asarray(binary_dilation(mask, iterations=_RIM), bool)
        y, x = (
            np.clip(np.where(inside, place, 0).astype(int), 0, size - 1)
            for place, size in zip((row, column), visible.shape, strict=True)
        )
        within += inside
        hidden += inside & ~visible[y, x]
    return hidden > _SHARE * within
