"""Whether a camera stands in free space: random poses must not lie in or behind objects."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.shutter import row_moments
from gaussray.dataset.manifest import rotation_and_position
from gaussray.geometry import even_directions
from gaussray.render.rig.placed import bounding_ball
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene, at
from gaussray.scene.segmented import Clip, segment_at
from gaussray.tracer.line import light_between, line_hits
from gaussray.tracer.options import TraceOptions


# A line that lets less light through is blocked.
_CLEAR = 0.5
# Directions around a camera in which the distance to the nearest surface is looked at, and the
# number of the capture's cameras, nearest first, one of which must see the camera.
_DIRECTIONS, _WITNESSES = 64, 16
# Relative to the scene's unit; poses are single precision.
_SAME_PLACE = 1e-5
# Cameras of the capture, and rays of each along a side of its picture, whose lengths are looked at:
# enough for a median, and a tenth of a second.
_LOOKS, _SIDE = 16, 4
# Fewest Gaussians that lines around a camera are traced through; more are rounded up to powers of
# two, so that few programs are compiled.
_FEWEST = 1024


class ObstructedError(ValueError):
    """A camera stands in or behind an object."""


class _Matter(NamedTuple):
    """The Gaussians of a scene at a time; and their centres and how far they reach, on the host."""

    gaussians: Gaussians
    mean: np.ndarray
    reach: np.ndarray


class FreeSpace:
    """Tells where cameras may stand in a scene.

    A place is free if nothing opaque is nearer than the clearance, and a straight line from it to
    one of the nearest cameras of the capture, which stand in free space, is not blocked. Inside a
    hollow object only the latter tells. Without a capture the former alone counts. Opaque is what
    lets less than half of the light through, by the hits of the tracer.

    Args:
        scene: the scene.
        cameras: the cameras of its capture; their own places are free.
        trace: smallest and largest alpha.
    """

    def __init__(self, scene: Scene | Clip, cameras: Sequence[Camera], trace: TraceOptions):
        self._scene, self._trace, self._cameras = scene, trace, cameras
        places = [rotation_and_position(camera)[1] for camera in cameras]
        self._known, first = np.unique(
            np.array(places, np.float64).reshape(-1, 3), axis=0, return_index=True
        )
        self._first = first
        self._matter = functools.lru_cache(64)(self._matter_at)

    @functools.cached_property
    def length(self) -> float:
        """The length in scene units that clearances are relative to.

        It is the median distance from the capture's cameras to what they see: along rays spread
        over their pictures, to where half of the light is lost. Without a capture, or where
        nothing is opaque, it is the radius of the scene (`placed.bounding_ball`).
        """
        chosen = self._first[:: -(-len(self._first) // _LOOKS) or 1]
        lengths = [length for i in chosen for length in self._sight_lengths(self._cameras[i])]
        if lengths:
            return float(np.median(lengths))
        _, radius = bounding_ball(self._scene)
        # One Gaussian is as large as it is wide.
        return radius or float(np.max(self._matter(float(self._scene.time_range[0])).reach))

    def check(self, camera: Camera, clearance: float) -> None:
        """Check the places of a camera at the first, the middle and the last time of a frame.

        Args:
            camera: the camera.
            clearance: least distance to anything opaque, as a share of `length`.

        Raises:
            ObstructedError: One of the places is not free.
        """
        moments = row_moments(camera.shutter, (camera.film.width, camera.film.height))
        time, half = float(camera.time), float(camera.shutter.exposure) / 2
        least = clearance * self.length
        for moment in sorted({moments.min() - half, 0.0, moments.max() + half}):
            moved = eqx.tree_at(lambda c: c.time, camera, np.float32(time + moment))
            position = np.asarray(rotation_and_position(moved)[1], np.float64)
            if not self._is_free(position, time + moment, least):
                raise ObstructedError(
                    f"its camera at {np.round(position, 3).tolist()} stands in an object, behind "
                    f"one or nearer than {least:.3g} scene units to one (dataset.clearance = "
                    f"{clearance:g} of {self.length:.3g}, the usual distance of what is seen)."
                )

    def _is_free(self, position: np.ndarray, time: float, clearance: float) -> bool:
        distance = np.linalg.norm(self._known - position, axis=1)
        if len(distance) and distance.min() < _SAME_PLACE:
            return True
        matter = self._matter(round(time, 6))
        around = position + clearance * even_directions(_DIRECTIONS)
        near = np.linalg.norm(matter.mean - position, axis=1) < matter.reach + clearance
        if (self._light(_part(matter.gaussians, near), position, around) < _CLEAR).any():
            return False
        witnesses = self._known[np.argsort(distance)[:_WITNESSES]]
        seen = (
            self._light(matter.gaussians, position, end[None])[0] >= _CLEAR for end in witnesses
        )
        return not len(witnesses) or any(seen)

    def _light(
        self, gaussians: Gaussians, start: Float[np.ndarray, "3"], ends: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, " n"]:
        dtype = gaussians.mean.dtype
        lines = jnp.asarray(start, dtype), jnp.asarray(ends, dtype)
        return np.asarray(_light_between(gaussians, *lines, options=self._trace))

    def _sight_lengths(self, camera: Camera) -> list[float]:
        """Distances at which half of the light is lost, along rays of a camera that lose it."""
        size = np.array([camera.film.width, camera.film.height], np.float32)
        steps = (np.arange(_SIDE, dtype=np.float32) + 0.5) / _SIDE
        pixel = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) * size
        rays = _rays(camera, jnp.asarray(pixel), jnp.full((len(pixel), 5), 0.5, jnp.float32))
        gaussians = self._matter(round(float(camera.time), 6)).gaussians
        lengths = []
        for origin, direction in zip(rays.origin, rays.direction, strict=True):
            t, alpha = map(np.asarray, _hits(gaussians, origin, direction, options=self._trace))
            met = np.flatnonzero(alpha)
            order = met[np.argsort(t[met])]
            dark = np.cumprod(1 - alpha[order]) < _CLEAR
            lengths += t[order][dark][:1].tolist()
        return lengths

    def _matter_at(self, time: float) -> _Matter:
        part = segment_at(self._scene, time)
        gaussians = _at(part, jnp.asarray(time, part.time_range.dtype))
        mean, scale, opacity = (
            np.asarray(x, np.float64) for x in (gaussians.mean, gaussians.scale, gaussians.opacity)
        )
        relative = np.maximum(opacity / self._trace.alpha_min, 1)
        return _Matter(gaussians, mean, np.sqrt(2 * np.log(relative)) * scale.max(-1))


_at, _rays = jax.jit(at), jax.jit(camera_rays)
_light_between = eqx.filter_jit(light_between)
_hits = eqx.filter_jit(line_hits)


def _part(gaussians: Gaussians, chosen: np.ndarray) -> Gaussians:
    """The chosen Gaussians, and invisible ones up to a power of two."""
    index = np.flatnonzero(chosen)
    length = max(1 << max(len(index) - 1, 0).bit_length(), _FEWEST)
    filled = jnp.asarray(np.pad(index, (0, length - len(index))))

    def pick(x: Array) -> Array:
        return x[filled]

    part = Gaussians(
        pick(gaussians.mean), pick(gaussians.quat), pick(gaussians.scale), pick(gaussians.opacity),
        pick(gaussians.harmonics),
    )  # fmt: skip
    there = jnp.arange(length) < len(index)
    return eqx.tree_at(lambda g: g.opacity, part, jnp.where(there, part.opacity, 0))
