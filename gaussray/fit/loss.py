"""How far what we render is from what was filmed."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class LossOptions(eqx.Module):
    """Weights of the terms; 0 switches a term off and costs nothing.

    `l1` and `dssim` compare sRGB-encoded colours (4D-GRT: 1 and 0; 3DGRT: 0.8 and 0.2). `space`,
    `time` and `one` weigh the plane regularisers (`regularizer.terms`).
    """

    l1: float = eqx.field(static=True, default=1.0)
    dssim: float = eqx.field(static=True, default=0.0)
    space: float = eqx.field(static=True, default=1e-4)
    time: float = eqx.field(static=True, default=1e-3)
    one: float = eqx.field(static=True, default=1e-4)

    def __check_init__(self):
        for name in ("l1", "dssim", "space", "time", "one"):
            if getattr(self, name) < 0:
                raise ValueError(f"loss.{name} must be at least 0, got {getattr(self, name)}.")


def terms(
    rendered: Float[Array, "rays 3"],
    truth: Float[Array, "rays 3"],
    *,
    options: LossOptions,
    side: int,
) -> dict[str, Float[Array, ""]]:
    """The terms that compare colours, unweighted, by the name of their weight."""
    values = {"l1": l1(rendered, truth)}
    if options.dssim:
        values["dssim"] = dssim(rendered, truth, side=side)
    return values


def developed(
    encoded: Float[Array, "rays 3"], truth: Float[Array, "rays 3"]
) -> Float[Array, "rays 3"]:
    """What a file would hold: nothing above 1. Where the truth is below 1 an excess stays, so that
    its gradient can bring it down."""
    return jnp.where(truth >= 1, jnp.minimum(encoded, 1), encoded)


def l1(rendered: Float[Array, "rays 3"], truth: Float[Array, "rays 3"]) -> Float[Array, ""]:
    """Mean absolute difference."""
    return jnp.mean(jnp.abs(rendered - truth))


def dssim(
    rendered: Float[Array, "rays 3"], truth: Float[Array, "rays 3"], *, side: int
) -> Float[Array, ""]:
    """(1 - SSIM) / 2 with each square tile of `side` x `side` rays as one Gaussian window.

    The window (sigma 1.5, as Wang et al. 2004) sits in the tile's middle: one SSIM value per tile,
    for batches of tiles that have no neighbours.
    """
    place = np.arange(side) - (side - 1) / 2
    line = np.exp(-0.5 * (place / 1.5) ** 2)
    window = np.outer(line, line).reshape(-1)
    weight = jnp.asarray(window / window.sum(), rendered.dtype)[None, :, None]
    x = rendered.reshape(-1, side * side, 3)
    y = truth.reshape(-1, side * side, 3)
    mean_x = jnp.sum(weight * x, axis=1, keepdims=True)
    mean_y = jnp.sum(weight * y, axis=1, keepdims=True)
    dx, dy = x - mean_x, y - mean_y
    var_x, var_y, cov = (jnp.sum(weight * p, axis=1) for p in (dx * dx, dy * dy, dx * dy))
    mean_x, mean_y = mean_x[:, 0], mean_y[:, 0]
    c1, c2 = 0.01**2, 0.03**2
    ssim = (2 * mean_x * mean_y + c1) * (2 * cov + c2)
    ssim = ssim / ((mean_x * mean_x + mean_y * mean_y + c1) * (var_x + var_y + c2))
    return jnp.mean(1 - ssim) / 2
