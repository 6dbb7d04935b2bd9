"""All hits of single lines, found without lists: for questions about a few lines, not pictures."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.geometry import product
from gaussray.scene.gaussians import Gaussians, whitening_matrix
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.response import opacity_on_ray, reach_radius, response


def line_hits(
    gaussians: Gaussians,
    origin: Float[Array, "3"],
    direction: Float[Array, "3"],
    *,
    options: TraceOptions,
) -> tuple[Float[Array, " gaussians"], Float[Array, " gaussians"]]:
    """Distance and alpha of every Gaussian on one line; alpha is 0 where there is no hit.

    These are the hits that the tracer composites (`hit_list`), evaluated for each Gaussian: no
    search is compiled or measured, and the cost grows with the scene.

    Args:
        gaussians: the Gaussians at the time of the line.
        origin: start of the line.
        direction: unit direction; zero hits nothing.
        options: smallest and largest alpha.
    """
    t, q, _ = _responses(gaussians, origin, direction)
    return t, jnp.where(t > 0, _alphas(gaussians, q, options), 0)


def light_between(
    gaussians: Gaussians,
    start: Float[Array, "3"],
    ends: Float[Array, "lines 3"],
    *,
    options: TraceOptions,
) -> Float[Array, " lines"]:
    """Share of light that passes along straight lines from one place to others.

    Between places in free space it is the tracer's transmittance. A Gaussian in which a line starts
    or ends counts with its largest alpha on the line, also if its peak lies beyond the end.

    Args:
        gaussians: the Gaussians at the time of the lines.
        start: the place where all lines start.
        ends: the places where they end.
        options: smallest and largest alpha.
    """

    def light(end: Array) -> Array:
        length = jnp.linalg.norm(end - start)
        direction = (end - start) / jnp.where(length > 0, length, 1)
        t, q, slope = _responses(gaussians, start, direction)
        beyond = slope * (t - jnp.clip(t, 0, length))
        return jnp.prod(1 - _alphas(gaussians, q + beyond**2, options))

    # One line after another: memory is that of one.
    return jax.lax.map(light, ends)


def _responses(gaussians: Gaussians, origin: Array, direction: Array) -> tuple[Array, ...]:
    """Distance of every Gaussian's peak, squared distance from it there, both as `response`; and
    standard deviations per unit of length along the line."""
    whiten = whitening_matrix(gaussians.quat, gaussians.scale)
    entries = [whiten[:, i, j] for i in range(3) for j in range(3)]
    mean = [gaussians.mean[:, i] for i in range(3)]
    t, q = response(entries, mean, origin, direction)
    return t, q, jnp.linalg.norm(product("nij,j->ni", whiten, direction), axis=-1)


def _alphas(gaussians: Gaussians, q: Array, options: TraceOptions) -> Array:
    """Alphas at squared distances; 0 beyond a Gaussian's reach."""
    met = q < reach_radius(gaussians.opacity, options.alpha_min) ** 2
    return jnp.where(met, opacity_on_ray(gaussians.opacity, q, alpha_max=options.alpha_max), 0)
