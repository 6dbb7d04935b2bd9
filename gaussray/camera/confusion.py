"""How wide a point out of focus becomes on the picture."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.camera.aperture import thin_lens
from gaussray.camera.camera import Camera


def circle_of_confusion(
    camera: Camera, pixel: Float[Array, "2"], t: Float[Array, ""]
) -> Float[Array, ""]:
    """Diameter, in pixels, of the image of the point at the distance `t` along the chief ray of the
    pixel with index (column, row).

    Light of a point P through the place o of the opening falls on the pixel of the direction
    P + o (rho / f - 1), where rho is the depth of P (focus on a plane) or its distance (on a
    sphere) and f that of focus. Under a pinhole lens of focal length F pixels that is a disc of
    diameter 2 radius F |1/f - 1/rho|; elsewhere an ellipse, of which this is the longer axis, to
    first order in radius / t. Blades count as the disc around them. NaN where there is no ray.
    """
    direction = camera.lens.direction(pixel + 0.5)
    point = t * direction
    distance = point[2] if camera.aperture.focus == "plane" else t
    blur = distance / camera.aperture.focus_distance - 1
    disc = dataclasses.replace(camera.aperture, blades=0)
    rim = jnp.asarray([[1, 0.5], [0.5, 1]], t.dtype)
    semiaxes = jax.vmap(lambda u: thin_lens(disc, direction, u)[0])(rim)

    def moved(offset: Float[Array, "3"]) -> Float[Array, "2"]:
        return jax.jvp(camera.lens.project, (point,), (offset,))[1]

    wide, high = jax.vmap(moved)(blur * semiaxes)
    # The longer semiaxis of the image of a circle is the larger singular value.
    square = jnp.sum(wide * wide) + jnp.sum(high * high)
    area = wide[0] * high[1] - wide[1] * high[0]
    rest = jnp.sqrt(jnp.maximum(square * square - 4 * area * area, 0))
    return jnp.where(jnp.any(direction != 0), 2 * jnp.sqrt((square + rest) / 2), jnp.nan)
