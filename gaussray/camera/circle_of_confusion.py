"""The circle of confusion: the size of the image of a point out of focus."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.aperture import focus_distance_at, thin_lens
from gaussray.camera.camera import Camera


def circle_of_confusion(
    camera: Camera, pixel: Float[Array, "2"], t: Float[Array, ""], time: Float[Array, ""]
) -> Float[Array, ""]:
    """Diameter of the image of a point, in pixels.

    Light of a point P that passes the aperture at o falls on the pixel of the direction
    P + o (rho / f - 1). Here rho is the depth of P (focus on a plane) or its distance (focus on a
    sphere), and f the focus distance. Under a pinhole lens of focal length F pixels that is a disc
    of diameter 2 radius F |1/f - 1/rho|; under other lenses an ellipse, of which this is the longer
    axis, to first order in radius / t. The aperture counts as a full disc: blades and the rim of
    optical vignetting make no difference.

    Args:
        camera: the camera.
        pixel: index (column, row) of the pixel, on whose chief ray the point lies.
        t: distance of the point from the camera, in scene units.
        time: time, in the capture's unit: a focus pull changes the focus distance.

    Returns:
        The diameter; NaN where the pixel has no ray.
    """
    direction = camera.lens.direction(pixel + 0.5)
    focus = focus_distance_at(camera.aperture, time)
    disc = dataclasses.replace(
        camera.aperture, focus_distance=focus, blades=0, edges=None, rim=None
    )
    point = t * direction
    distance = point[2] if disc.focus == "plane" else t
    blur = distance / focus - 1
    edge = jnp.asarray([[1, 0.5], [0.5, 1]], t.dtype)
    semiaxes = jax.vmap(lambda u: thin_lens(disc, direction, u)[0])(edge)

    def moved(offset: Float[Array, "3"]) -> Float[Array, "2"]:
        return jax.jvp(camera.lens.project, (point,), (offset,))[1]

    wide, high = jax.vmap(moved)(blur * semiaxes)
    # The longer semiaxis of the image of a circle is the larger singular value.
    square = jnp.sum(wide * wide) + jnp.sum(high * high)
    area = wide[0] * high[1] - wide[1] * high[0]
    rest = jnp.sqrt(jnp.maximum(square * square - 4 * area * area, 0))
    return jnp.where(jnp.any(direction != 0), 2 * jnp.sqrt((square + rest) / 2), jnp.nan)
