"""Assigns the rays of a frame to the segments of a clip."""

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


# Least span of key states, as a share of the frame's times.
LEAST = 1e-3


class SegmentRays(eqx.Module):
    """The rays of a frame that one segment shows.

    Args:
        mask: samples and rows that it shows; rows in the order of readout.
        span: first and last time of these rays, in the capture's unit.
    """

    mask: Bool[Array, "samples rows"]
    span: Float[Array, "2"]


def segment_rays(
    camera: Camera, edges: Float[np.ndarray, " edges"], count: int, batch: int | None = None
) -> Sequence[tuple[int, SegmentRays | None]]:
    """The segments of a clip that a frame shows, with the rays of each.

    Every ray belongs to the one segment that shows its time. That is decided here, for all segments
    together: programs that computed the times again could round them to either side of an edge, and
    a ray would be traced twice or not at all.

    Args:
        camera: the camera, on the host.
        edges: times at which segments meet.
        count: number of samples.
        batch: batch of the samples (`sampling.shifted_samples`); None is `sobol_samples`.

    Returns:
        Index and rays of each segment; None is all rays.
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
    time = middle + float(shutter.exposure) * _sample_offsets(count, batch)
    owner = np.searchsorted(edges, time, side="right")
    segments = [int(i) for i in np.unique(owner)]
    if len(segments) == 1:
        return [(segments[0], None)]
    return [(i, SegmentRays(to_device(owner == i), _span(edges, i, first, last))) for i in segments]


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
def _sample_offsets(count: int, batch: int | None) -> Float[np.ndarray, "samples 1"]:
    """Time of every sample relative to the middle of the exposure, in exposures."""
    u = sobol_samples(count) if batch is None else shifted_samples(count, jnp.asarray(batch))
    return np.asarray(u, np.float64)[:, 4:] - 0.5
