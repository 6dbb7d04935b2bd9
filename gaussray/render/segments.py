"""Which rays of a frame belong to which segment of a clip."""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.camera.camera import Camera
from gaussray.camera.sampling import shifted_samples, sobol_samples
from gaussray.camera.shutter import row_moments, time_window
from gaussray.io.plain_values import to_device


# The least part of a frame's times that key states span: a row alone has no time to move in.
LEAST = 1e-3


class Share(eqx.Module):
    """What a segment shows of a frame: the rays of the samples and rows that are `seen` (rows as
    the shutter counts them), whose times are in `span`."""

    seen: Bool[Array, "samples rows"]
    span: Float[Array, "2"]


def shares(
    camera: Camera, edges: Float[np.ndarray, " edges"], count: int, batch: int | None = None
) -> Sequence[tuple[int, Share | None]]:
    """The segments that a frame of `count` samples looks into, each with its share; None is all of
    it. `camera` is on the host; segments meet at the `edges`. The samples are those of this `batch`
    (`sampling.shifted_samples`), None is the plain ones.

    Every ray belongs to the one segment that shows its time. That is decided here, for all segments
    together: programs that each computed the times again might round them to either side of an
    edge, and a ray would be seen twice or not at all.
    """
    if not len(edges):
        return [(0, None)]
    shutter, film = camera.shutter, camera.film
    window = time_window(shutter, (film.width, film.height))
    first, last = (float(camera.time) + x for x in window)
    touched = np.searchsorted(edges, [first, last], side="right")
    if touched[0] == touched[1]:
        return [(int(touched[0]), None)]
    middle = float(camera.time) + row_moments(shutter, (film.width, film.height))
    time = middle + float(shutter.exposure) * _moments(count, batch)
    owner = np.searchsorted(edges, time, side="right")
    found = [int(i) for i in np.unique(owner)]
    if len(found) == 1:
        return [(found[0], None)]
    return [(i, Share(to_device(owner == i), _span(edges, i, first, last))) for i in found]


def _span(edges: np.ndarray, segment: int, first: float, last: float) -> Float[Array, "2"]:
    """The times of a frame that a segment shows, of some length."""
    limits = np.concatenate([[-np.inf], edges, [np.inf]])
    begin, end = max(first, limits[segment]), min(last, limits[segment + 1])
    least = LEAST * (last - first)
    if end - begin < least:
        # Away from the edge, beyond which the segment rests.
        begin, end = (end - least, end) if end == limits[segment + 1] else (begin, begin + least)
    return to_device([begin, end], jnp.float32)


@functools.lru_cache
def _moments(count: int, batch: int | None) -> Float[np.ndarray, "samples 1"]:
    """When in the exposure every sample looks, from its middle."""
    u = sobol_samples(count) if batch is None else shifted_samples(count, jnp.asarray(batch))
    return np.asarray(u, np.float64)[:, 4:] - 0.5
