"""How far a rendered picture is from the photograph."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.capture.temporal_median import AVERAGED, MOTION_THRESHOLD, OUTLYING
from gaussray.reconstruct.data.tiles import tile_order, tile_places


# Pixels along a side of SSIM's window.
_WINDOW = 11


class LossOptions(eqx.Module):
    """Weights of the terms; 0 switches a term off and costs nothing.

    Args:
        l1: mean absolute difference of sRGB-encoded colours (4D-GRT: 1; 3DGS and 3DGRT: 0.8).
        dssim: 1 - SSIM of sRGB-encoded colours (4D-GRT: 0; 3DGS and 3DGRT: 0.2).
        backdrop_opacity: mean opacity of the pixels that show a plain backdrop (`data.backdrop`):
            what is there costs nothing else, and hides things from other cameras.
        outside_opacity: mean opacity of the pixels that silhouettes hide (`data.silhouettes`).
        plane_variation: plane regulariser in space (`regularizer.plane_terms`).
        time_smoothness: plane regulariser in time.
        time_planes_from_one: plane regulariser towards a field that does not change.
        rigid: cost of control points that began at rest and do not move as rigidly as possible
            (`regularizer.rigid_term`).

    Raises:
        ValueError: a weight is negative.
    """

    l1: float = eqx.field(static=True, default=1.0)
    dssim: float = eqx.field(static=True, default=0.0)
    backdrop_opacity: float = eqx.field(static=True, default=0.1)
    outside_opacity: float = eqx.field(static=True, default=0.3)
    plane_variation: float = eqx.field(static=True, default=1e-4)
    time_smoothness: float = eqx.field(static=True, default=1e-3)
    time_planes_from_one: float = eqx.field(static=True, default=1e-4)
    rigid: float = eqx.field(static=True, default=0.1)

    def __check_init__(self):
        for name, weight in self.weights.items():
            if weight < 0:
                raise ValueError(f"loss.{name} must be at least 0, got {weight}.")

    @property
    def weights(self) -> dict[str, float]:
        """All weights by their names, which terms of the loss have as well."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}


def terms(
    rendered: Float[Array, "rays 3"],
    truth: Float[Array, "rays 3"],
    *,
    options: LossOptions,
    side: int,
    bundle: int | None = None,
) -> dict[str, Float[Array, ""]]:
    """The terms that compare colours, unweighted, by the name of their weight.

    Args:
        rendered: sRGB-encoded colours of the rays, tile after tile, in `tile_order`.
        truth: those of the photograph.
        options: the weights; a term of weight 0 is left out (but not `l1`).
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: a tile is one bundle.
    """
    values = {"l1": l1(rendered, truth)}
    if options.dssim:
        values["dssim"] = dssim(rendered, truth, side=side, bundle=bundle)
    return values


def far_apart(
    rendered: Float[Array, "rays 3"],
    truth: Float[Array, "rays 3"],
    *,
    side: int,
    bundle: int | None = None,
) -> Bool[Array, " rays"]:
    """Which pixels differ because they show what moves: in the mean over the square of `AVERAGED`
    pixels around them, as far as it lies in their tile, a channel differs by more than
    `MOTION_THRESHOLD`, and `OUTLYING` times what it is at the median pixel.

    Args:
        rendered: sRGB-encoded colours of the rays, tile after tile, in `tile_order`.
        truth: those of the photograph.
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: a tile is one bundle.
    """
    place, order = tile_places(side, bundle), tile_order(side, bundle)
    difference = (rendered - truth).reshape(-1, side**2, 3)[:, place].reshape(-1, side, side, 3)
    around = jnp.asarray(_around(side), rendered.dtype)
    mean = jnp.einsum("oi,pj,tijc->topc", around, around, difference, precision="highest")
    apart = jnp.max(jnp.abs(mean), axis=-1)
    far = apart > jnp.maximum(MOTION_THRESHOLD, OUTLYING * jnp.median(apart))
    return far.reshape(-1, side**2)[:, order].reshape(-1)


def _around(side: int) -> Float[np.ndarray, "side side"]:
    """Weights of the mean over the pixels of a row around each."""
    place = np.arange(side)
    near = np.abs(place[:, None] - place[None]) <= AVERAGED // 2
    return near / near.sum(axis=1, keepdims=True)


def developed(
    encoded: Float[Array, "rays 3"], truth: Float[Array, "rays 3"]
) -> Float[Array, "rays 3"]:
    """Rendered colours as a file would hold them: none above 1.

    Where the truth is below 1 an excess stays, so that its gradient can bring it down.

    Args:
        encoded: sRGB-encoded colours, of any size.
        truth: those of the photograph, in [0, 1].
    """
    return jnp.where(truth >= 1, jnp.minimum(encoded, 1), encoded)


def l1(rendered: Float[Array, "rays 3"], truth: Float[Array, "rays 3"]) -> Float[Array, ""]:
    """Mean absolute difference.

    Args:
        rendered: sRGB-encoded colours of the rays.
        truth: those of the photograph.
    """
    return jnp.mean(jnp.abs(rendered - truth))


def dssim(
    rendered: Float[Array, "rays 3"],
    truth: Float[Array, "rays 3"],
    *,
    side: int,
    bundle: int | None = None,
) -> Float[Array, ""]:
    """1 - SSIM, the mean over all windows inside square tiles.

    Windows are Gaussian (sigma 1.5, 11 x 11 pixels, as Wang et al. 2004; a tile of fewer pixels is
    one window) and never reach beyond their tile, whose neighbours a batch does not hold. SSIM is
    (1 - a) (1 - b), a the squared difference of the means and b the variance of the difference,
    each over its own denominator: 1 - SSIM is a + b - a b, which keeps its digits where pictures
    are nearly equal.

    Args:
        rendered: sRGB-encoded colours of the rays, tile after tile, in `tile_order`.
        truth: those of the photograph.
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: a tile is one bundle.
    """
    window = jnp.asarray(_windows(side), rendered.dtype)
    place = tile_places(side, bundle)

    def averaged(image: Float[Array, "tiles side side 3"]) -> Float[Array, "tiles out out 3"]:
        rows = jnp.einsum("oi,tijc->tojc", window, image, precision="highest")
        return jnp.einsum("oj,tijc->tioc", window, rows, precision="highest")

    x, y = (
        z.reshape(-1, side**2, 3)[:, place].reshape(-1, side, side, 3) for z in (rendered, truth)
    )
    apart, center = x - y, jnp.mean(y, axis=(1, 2), keepdims=True)
    # Squares of values about their mean lose fewer digits.
    x, y = x - center, y - center
    mean_y, mean_apart = averaged(y), averaged(apart)
    mean_x = mean_y + mean_apart
    var_apart = jnp.maximum(averaged(apart * apart) - mean_apart * mean_apart, 0)
    var_both = averaged(x * x + y * y) - mean_x * mean_x - mean_y * mean_y
    mean_x, mean_y = mean_x + center, mean_y + center
    c1, c2 = 0.01**2, 0.03**2
    light = mean_apart**2 / (mean_x * mean_x + mean_y * mean_y + c1)
    shape = var_apart / (jnp.maximum(var_both, 0) + c2)
    return jnp.mean(light + shape - light * shape)


def _windows(side: int) -> Float[np.ndarray, "windows side"]:
    """Weights of the pixels of a row in every window that lies inside the row."""
    width = min(_WINDOW, side)
    place = np.arange(width) - (width - 1) / 2
    line = np.exp(-0.5 * (place / 1.5) ** 2)
    count = side - width + 1
    table = np.zeros((count, side))
    for i in range(count):
        table[i, i : i + width] = line / line.sum()
    return table
