"""Real spherical harmonics up to degree 3: colour that changes with the viewing direction."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


# The value of the constant harmonic, 1 / (2 sqrt(pi)).
C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)


def harmonic_basis(
    direction: Float[Array, " 3 *rays"], coefficients: int
) -> list[Float[Array, "*rays"]]:
    """The first real spherical harmonics Y(direction), in the order and sign of 3DGS.

    Args:
        direction: unit vectors, components first.
        coefficients: number of harmonics: 1, 4, 9 or 16.

    Returns:
        One array per harmonic, elementwise over the rays.
    """
    x, y, z = direction[0], direction[1], direction[2]
    values = [jnp.full_like(x, C0)]
    if coefficients > 1:
        values += [-C1 * y, C1 * z, -C1 * x]
    if coefficients > 4:
        a, b, c = C2
        values += [
            a * x * y,
            -a * y * z,
            b * (2 * z * z - x * x - y * y),
            -a * x * z,
            c * (x * x - y * y),
        ]
    if coefficients > 9:
        a, b, c, d, e = C3
        values += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (4 * z * z - x * x - y * y),
            d * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -c * x * (4 * z * z - x * x - y * y),
            e * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return values


def radiance(
    harmonics: Float[Array, "coefficients 3 *hits"], direction: Float[Array, " 3 *rays"]
) -> Float[Array, " 3 *hits"]:
    """Linear colour along a direction: max(0, 1/2 + sum_i c_i Y_i(direction)).

    As in 3DGRT the direction is the ray's own, not the one from the camera to the Gaussian's mean.

    Args:
        harmonics: coefficients c_i of red, green and blue.
        direction: unit vectors, components first.
    """
    terms = harmonic_basis(direction, harmonics.shape[0])
    total = terms[0][None] * harmonics[0]
    for i in range(1, len(terms)):
        total = total + terms[i][None] * harmonics[i]
    return jnp.maximum(total + 0.5, 0)


@functools.partial(jax.jit, static_argnames="degree", inline=True)
def constant_harmonics(
    color: Float[Array, "*batch 3"], degree: int
) -> Float[Array, "*batch coefficients 3"]:
    """Coefficients of a colour that does not depend on the direction.

    Args:
        color: linear red, green and blue.
        degree: degree of the harmonics.
    """
    first = (color - 0.5) / C0
    rest = jnp.zeros((*color.shape[:-1], (degree + 1) ** 2 - 1, 3), color.dtype)
    return jnp.concatenate([first[..., None, :], rest], axis=-2)
