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
    for batches of tiles that have no neighbours. SSIM is (1 - a) (1 - b), a the squared difference
    of the means and b the variance of the difference, each over its own denominator: 1 - SSIM is
    a + b - a b, which keeps its digits where pictures are nearly equal.
    """
    place = np.arange(side) - (side - 1) / 2
    line = np.exp(-0.5 * (place / 1.5) ** 2)
    window = np.outer(line, line).reshape(-1)
    weight = jnp.asarray(window / window.sum(), rendered.dtype)[None, :, None]
    x = rendered.reshape(-1, side * side, 3)
    y = truth.reshape(-1, side * side, 3)
    mean_x, mean_y, apart = (jnp.sum(weight * z, axis=1, keepdims=True) for z in (x, y, x - y))
    squares = ((x - mean_x) ** 2, (y - mean_y) ** 2, (x - y - apart) ** 2)
    var_x, var_y, var_apart = (jnp.sum(weight * square, axis=1) for square in squares)
    mean_x, mean_y, apart = mean_x[:, 0], mean_y[:, 0], apart[:, 0]
    c1, c2 = 0.01**2, 0.03**2
    light = apart * apart / (mean_x * mean_x + mean_y * mean_y + c1)
    shape = var_apart / (var_x + var_y + c2)
    return jnp.mean(light + shape - light * shape) / 2
