"""The response of one Gaussian on one ray."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def response(
    whiten: list[Float[Array, "*hits"]],
    mean: list[Float[Array, "*places"]],
    origin: Float[Array, " 3 *rays"],
    direction: Float[Array, " 3 *rays"],
) -> tuple[Float[Array, "*both"], Float[Array, "*both"]]:
    """Distance t of the Gaussian's peak along the ray, and its squared distance q there.

    With A = S^-1 R^T (`whiten`, nine entries row by row): o = A (origin - mean), d = A direction,
    t = -(o.d)/(d.d), q = |o x d|^2/(d.d); the kernel is exp(-q/2) (3DGRT, degree 2). The cross
    product does not cancel far away as |o|^2 - (o.d)^2/(d.d) does, and the origin is first moved
    along the ray to where it passes the mean, so that o is small whenever the hit matters.
    Components come first and everything is elementwise over the trailing axes: plain SIMD. A zero
    direction gives q = infinity, which is no hit; so does a Gaussian collapsed to nothing.

    In float32 the ray passes the mean with an error of about 1e-7 x (its distance), and a thin
    Gaussian is turned by as much. Up to a distance or a width of 300 to 1000 times the smallest
    scale, gradients keep 1e-3 and colours 1e-6; at 1e6 times they are those of inputs rounded half
    a unit away (measured: mean colour error 6e-4, a tenth of what that rounding does). Sizes
    are from 1e-17 to 1e17 units, and from 1e-12 to 1e12 where t is differentiated: squares and
    cubes of them and of their inverses must be numbers.

    Args:
        whiten: entries of A, row by row.
        mean: centre of the Gaussian, by component.
        origin: origin of the ray.
        direction: unit direction of the ray.

    Returns:
        t and q.
    """
    x, y, z = (origin[i] - mean[i] for i in range(3))
    dx, dy, dz = direction[0], direction[1], direction[2]
    shift = -(x * dx + y * dy + z * dz)
    px, py, pz = x + shift * dx, y + shift * dy, z + shift * dz
    a = whiten
    ox, oy, oz = (a[i] * px + a[i + 1] * py + a[i + 2] * pz for i in (0, 3, 6))
    vx, vy, vz = (a[i] * dx + a[i + 1] * dy + a[i + 2] * dz for i in (0, 3, 6))
    square = vx * vx + vy * vy + vz * vz
    inverse = reciprocal(jnp.where(square > 0, square, 1))
    cx, cy, cz = oy * vz - oz * vy, oz * vx - ox * vz, ox * vy - oy * vx
    t = shift - (ox * vx + oy * vy + oz * vz) * inverse
    q = jnp.where(square > 0, (cx * cx + cy * cy + cz * cz) * inverse, jnp.inf)
    return t, q


@jax.custom_jvp
def reciprocal(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """1 / x, with the derivative -(dx / x) / x: JAX's own, -dx x^-2, overflows where x is the
    square of a size of 1e-10 or 1e10."""
    return 1 / x


@reciprocal.defjvp
def _reciprocal_jvp(primals, tangents):
    inverse = reciprocal(*primals)
    return inverse, -(tangents[0] * inverse) * inverse


def reach_radius(opacity: Float[Array, "*batch"], alpha_min: float) -> Float[Array, "*batch"]:
    """Radius, in standard deviations, at which alpha falls to `alpha_min`.

    It is sqrt(2 ln(opacity / alpha_min)), computed from the difference of both, which is exact
    where they are nearly equal.

    Args:
        opacity: peak alphas.
        alpha_min: alpha at the radius.

    Returns:
        The radius; 0 if the opacity is below `alpha_min`.
    """
    visible = opacity > alpha_min
    above = jnp.where(visible, opacity - alpha_min, 0) / alpha_min
    squared = 2 * jnp.log1p(above)
    return jnp.where(visible, jnp.sqrt(jnp.where(visible, squared, 1)), 0)


def opacity_on_ray(
    opacity: Float[Array, "*gaussians"], q: Float[Array, "*both"], *, alpha_max: float
) -> Float[Array, "*both"]:
    """alpha = min(alpha_max, opacity exp(-q/2)).

    Args:
        opacity: peak alphas.
        q: squared distances from the Gaussian on the ray, in standard deviations (`response`).
        alpha_max: largest alpha.
    """
    return jnp.minimum(opacity * jnp.exp(-0.5 * q), alpha_max)
