"""Measures what a camera is to focus on, and how large its blur is."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.circle_of_confusion import circle_of_confusion
from gaussray.camera.film import pixel_grid
from gaussray.camera.shutter import Shutter
from gaussray.render.aov.programs import SURFACE_ALPHA
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.render.rig.film import FilmOptions, apply_film
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.options import TraceOptions


# Longest side in pixels of the picture that is measured.
_SIDE = 128
# The middle of a picture is this share of its width and of its height.
_MIDDLE = 0.1


def without_aperture(camera: Camera) -> Camera:
    """The camera with a pinhole aperture and without chromatic aberration: its chief rays only."""
    none = jax.tree.map(lambda x: x.astype(camera.time.dtype), no_aperture())
    return dataclasses.replace(camera, aperture=none, chromatic=None)


def focus_distances(
    camera: Camera,
    focus: str,
    pixel: Float[np.ndarray, "*n 2"],
    alpha: Float[np.ndarray, "*n"],
    distance: Float[np.ndarray, "*n"],
) -> Float[np.ndarray, "*n"]:
    """The focus distances that make the surfaces in pixels sharp, in scene units.

    It is the surface's `depth` label, or its `z` label for focus on a plane.

    Args:
        camera: the camera, whose lens gives the direction of each pixel.
        focus: "plane" or "sphere".
        pixel: column and row.
        alpha: coverage.
        distance: distance along the chief ray.

    Returns:
        The distances; NaN where there is no surface, or one that cannot be in focus.
    """
    if focus == "plane":
        point = jnp.asarray(pixel, camera.time.dtype).reshape(-1, 2) + 0.5
        axis = np.asarray(jax.vmap(camera.lens.direction)(point))[:, 2]
        distance = distance * axis.reshape(distance.shape)
    return np.where((alpha >= SURFACE_ALPHA) & (distance > 0), distance, np.nan)


class FocusMeter:
    """Measures cameras of one scene in small pictures, by chief rays at each picture's own time.

    Args:
        scene: the scene.
        trace: how rays are traced.
    """

    def __init__(self, scene: Scene | Clip, trace: TraceOptions):
        self._scene, self._trace = scene, trace

    def subject_distance(self, camera: Camera, focus: str) -> float:
        """Focus distance of what the middle of a picture shows: the median over a tenth of its
        width and height, or over the whole picture if the middle shows no surface.

        Args:
            camera: the camera; its aperture does not count.
            focus: "plane" or "sphere".

        Raises:
            ValueError: The picture shows no surface.
        """
        small, alpha, depth = self._picture(camera)
        distance = focus_distances(small, focus, np.asarray(pixel_grid(small.film)), alpha, depth)
        height, width = distance.shape
        top, left = (int((1 - _MIDDLE) / 2 * side) for side in (height, width))
        middle = distance[top : height - top, left : width - left]
        for part in (middle, distance):
            seen = part[np.isfinite(part)]
            if len(seen):
                # Never between a surface and what lies behind it.
                return float(np.percentile(seen, 50, method="lower"))
        raise ValueError(
            "aperture.focus_distance=auto needs a surface in the first picture, which shows none. "
            "Give aperture.focus_distance and aperture.radius as numbers in scene units."
        )

    def blur(self, camera: Camera, share: float) -> float:
        """Diameter in pixels that the circles of confusion of a share of the surfaces exceed.

        Args:
            camera: the camera.
            share: the share of the picture's surfaces, 0 to 1; 0.5 gives the median.

        Returns:
            The diameter; 0 without surfaces.
        """
        small, alpha, depth = self._picture(camera)
        seen = (alpha >= SURFACE_ALPHA) & (depth > 0)
        if not seen.any():
            return 0.0
        small = dataclasses.replace(small, aperture=camera.aperture)
        # All pixels: their number is that of every picture of this shape, for one program.
        dtype = camera.time.dtype
        pixel, depth = pixel_grid(small.film).astype(dtype), jnp.asarray(depth, dtype)
        diameter = np.asarray(_confusion(small, pixel, depth))
        scale = camera.film.width / small.film.width
        return scale * float(np.nanpercentile(diameter[seen], 100 * (1 - share)))

    @functools.cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self._scene, options=RenderOptions(samples=1), trace=self._trace)

    def _picture(
        self, camera: Camera
    ) -> tuple[Camera, Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
        """A small camera without aperture and exposure; coverage and distance of its pixels."""
        small = _small(camera)
        frame = self._renderer(small)
        return small, frame.alpha, frame.depth


def _small(camera: Camera) -> Camera:
    """The camera at its own time, with pictures of at most 128 pixels a side."""
    film, zero = camera.film, jnp.zeros_like(camera.time)
    shrink = min(1.0, _SIDE / max(film.width, film.height))
    size = tuple(max(round(shrink * side), 1) for side in (film.width, film.height))
    instant = dataclasses.replace(camera, shutter=Shutter(zero, zero, zero))
    return apply_film(without_aperture(instant), FilmOptions(size=size))


@eqx.filter_jit
def _confusion(
    camera: Camera, pixel: Float[Array, "h w 2"], distance: Float[Array, "h w"]
) -> Float[Array, "h w"]:
    def of_pixel(at: Float[Array, "2"], t: Float[Array, ""]) -> Float[Array, ""]:
        return circle_of_confusion(camera, at, t, camera.time)

    return jax.vmap(jax.vmap(of_pixel))(pixel, distance)
