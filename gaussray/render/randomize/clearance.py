"""Whether a camera stands in free space: random poses must not lie in or behind objects."""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import row_moments
from gaussray.dataset.manifest import rotation_and_position
from gaussray.scene.gaussians import whitening_matrix
from gaussray.scene.scene import Scene, at
from gaussray.scene.segmented import Clip, segment_at
from gaussray.tracer.options import TraceOptions


# A line that lets less light through is blocked.
_CLEAR = 0.5
# Directions around a camera in which the distance to the nearest surface is looked at, and the
# number of the capture's cameras, nearest first, one of which must see the camera.
_DIRECTIONS, _WITNESSES = 64, 16
# Relative to the scene's unit; poses are single precision.
_SAME_PLACE = 1e-5


class ObstructedError(ValueError):
    """A camera stands in or behind an object."""


class _Matter(eqx.Module):
    """The Gaussians of a scene at a time, in double precision on the host."""

    mean: np.ndarray
    whiten: np.ndarray
    opacity: np.ndarray
    reach: np.ndarray


class FreeSpace:
    """Tells where cameras may stand in a scene.

    A place is free if nothing opaque is nearer than `clearance`, and a straight line from it to one
    of the nearest cameras of the capture, which stand in free space, is not blocked. Inside a
    hollow object only the latter tells. Without a capture the former alone counts.

    Args:
        scene: The scene.
        cameras: The cameras of its capture; their own places are free.
        trace: Smallest and largest alpha.
    """

    def __init__(self, scene: Scene | Clip, cameras: Sequence[Camera], trace: TraceOptions):
        self._scene, self._trace = scene, trace
        places = [rotation_and_position(camera)[1] for camera in cameras]
        self._known = np.unique(np.array(places, np.float64).reshape(-1, 3), axis=0)
        self._matter = functools.lru_cache(64)(self._matter_at)

    def check(self, camera: Camera, clearance: float) -> None:
        """Check the places of a camera at the first, the middle and the last time of a frame.

        Args:
            camera: The camera.
            clearance: Least distance to anything opaque, in scene units.

        Raises:
            ObstructedError: One of the places is not free.
        """
        moments = row_moments(camera.shutter, (camera.film.width, camera.film.height))
        time, half = float(camera.time), float(camera.shutter.exposure) / 2
        for moment in (moments.min() - half, 0.0, moments.max() + half):
            moved = eqx.tree_at(lambda c: c.time, camera, np.float32(time + moment))
            place = np.asarray(rotation_and_position(moved)[1], np.float64)
            if not self._is_free(place, time + moment, clearance):
                raise ObstructedError(
                    f"its camera at {np.round(place, 3).tolist()} stands in an object, behind one "
                    f"or nearer than factory.clearance = {clearance:g} to one."
                )

    def _is_free(self, place: np.ndarray, time: float, clearance: float) -> bool:
        distance = np.linalg.norm(self._known - place, axis=1)
        if len(distance) and distance.min() < _SAME_PLACE:
            return True
        matter = self._matter(round(time, 6))
        around = place + clearance * _even_directions(_DIRECTIONS)
        if (self._light(matter, place, around) < _CLEAR).any():
            return False
        witnesses = self._known[np.argsort(distance)[:_WITNESSES]]
        seen = (self._light(matter, place, end[None])[0] >= _CLEAR for end in witnesses)
        return not len(witnesses) or any(seen)

    def _light(
        self, matter: _Matter, start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "lines 3"]
    ) -> Float[np.ndarray, " lines"]:
        """Share of light that passes from a place to others: the product of 1 - alpha of all
        Gaussians, alpha where the line is nearest to the Gaussian."""
        length = np.linalg.norm(ends - start, axis=1).max()
        near = np.linalg.norm(matter.mean - start, axis=1) < matter.reach + length
        whiten = matter.whiten[near]
        offset = np.einsum("nij,nj->ni", whiten, start - matter.mean[near])
        along = np.einsum("nij,lj->lni", whiten, ends - start)
        square = np.maximum((along**2).sum(-1), 1e-30)
        t = np.clip(-(along * offset).sum(-1) / square, 0, 1)
        q = ((offset + t[..., None] * along) ** 2).sum(-1)
        alpha = np.minimum(matter.opacity[near] * np.exp(-q / 2), self._trace.alpha_max)
        alpha = np.where(alpha < self._trace.alpha_min, 0, alpha)
        return np.prod(1 - alpha, axis=-1)

    def _matter_at(self, time: float) -> _Matter:
        part = segment_at(self._scene, time)
        at_time = _visible_matter(part, jnp.asarray(time, part.time_range.dtype))
        mean, whiten, opacity, scale = (np.asarray(x, np.float64) for x in at_time)
        relative = np.maximum(opacity / self._trace.alpha_min, 1)
        reach = np.sqrt(2 * np.log(relative)) * scale.max(-1)
        finite = np.isfinite(whiten).all((1, 2)) & np.isfinite(mean).all(-1)
        seen = finite & (relative > 1)
        return _Matter(mean[seen], whiten[seen], opacity[seen], reach[seen])


@jax.jit
def _visible_matter(scene: Scene, time: jax.Array) -> tuple[jax.Array, ...]:
    gaussians = at(scene, time)
    whiten = whitening_matrix(gaussians.quat, gaussians.scale)
    return gaussians.mean, whiten, gaussians.opacity, gaussians.scale


def _even_directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors that cover the sphere evenly: a spiral by the golden angle."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
