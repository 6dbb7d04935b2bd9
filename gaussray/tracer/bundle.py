"""Bundles of coherent rays and conservative bounds around them."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from gaussray.camera.rays import Rays
from gaussray.geometry import normalize, product
from gaussray.tracer.motion import active_controls
from gaussray.tracer.options import TraceOptions


# Bundles of one level share a bundle of the next coarser level, FAN neighbours at a time.
FAN = 16
# Below this cosine to the axis a bundle is too wide for half-spaces: it is then unbounded.
_WIDEST = 0.05


class Bundles(eqx.Module):
    """Conservative bounds of ray bundles: five half-spaces n.x >= offset and a time interval.

    The half-spaces, four sides and a near plane, follow from the rays themselves, so any lens,
    aperture and camera motion is bounded. A bundle without rays contains nothing; rays that are not
    finite do not count.

    Args:
        normal: unit normals n of the half-spaces.
        offset: their offsets, in scene units.
        active: the control points of the motion that the bundle's times touch.
        earliest: earliest time of the rays, in the capture's unit.
        latest: latest time of the rays.
    """

    normal: Float[Array, "*bundles 5 3"]
    offset: Float[Array, "*bundles 5"]
    active: Bool[Array, "*bundles keys"]
    earliest: Float[Array, "*bundles"]
    latest: Float[Array, "*bundles"]


def bound_bundles(
    rays: Rays, key_time: Float[Array, " keys"], *, row: int | None = None
) -> Bundles:
    """Bound bundles of rays. No gradient.

    Args:
        rays: rays of the shape (bundles, rays of one bundle).
        key_time: key times of the motion.
        row: number of rays in the first row of a bundle; None for a square bundle.
    """
    row_end = _row_end(rays.direction.shape[1]) if row is None else row - 1
    bound = partial(_bound_bundle, key_time=key_time, row_end=row_end)
    return jax.vmap(bound)(jax.lax.stop_gradient(rays))


def _bound_bundle(rays: Rays, key_time: Array, row_end: int) -> Bundles:
    d, o = rays.direction, rays.origin
    real = jnp.any(d != 0, axis=-1) & jnp.isfinite(rays.time)
    real = real & jnp.all(jnp.isfinite(d) & jnp.isfinite(o), axis=-1)
    d, o = (jnp.where(real[:, None], x, 0) for x in (d, o))
    any_real = jnp.any(real)
    axis = normalize(jnp.sum(d, axis=0))
    # The side from the first to the middle ray of the bundle's first run follows the pixel rows.
    along = d[row_end] - d[0]
    along = along - jnp.sum(along * axis) * axis
    x_axis, y_axis = jnp.eye(3, dtype=d.dtype)[:2]
    helper = jnp.where(jnp.abs(axis[0]) < 0.6, x_axis, y_axis)
    helper = helper - jnp.sum(helper * axis) * axis
    u = normalize(jnp.where(jnp.sum(along * along) > 1e-12, along, helper))
    v = jnp.cross(axis, u)
    # Unit rays differ from their float values by rounding: a slack keeps the bound conservative.
    slack = 16 * jnp.finfo(d.dtype).eps
    depth = product("ri,i->r", d, axis)
    narrow = jnp.all((depth > _WIDEST) | ~real)
    depth = jnp.where(depth > _WIDEST, depth, 1)
    normals = [axis]
    for side in (u, v):
        slope = product("ri,i->r", d, side) / depth
        low = jnp.min(jnp.where(real, slope, jnp.inf)) - slack
        high = jnp.max(jnp.where(real, slope, -jnp.inf)) + slack
        normals += [side - low * axis, high * axis - side]
    normal = normalize(jnp.stack(normals))
    normal = jnp.where(narrow & any_real, normal, 0)
    reach = jnp.where(real, product("si,ri->sr", normal, o), jnp.inf)
    magnitude = jnp.max(jnp.where(real[:, None], jnp.abs(o), 0))
    offset = jnp.min(reach, axis=1) - slack * magnitude
    earliest = jnp.min(jnp.where(real, rays.time, jnp.inf))
    latest = jnp.max(jnp.where(real, rays.time, -jnp.inf))
    active = active_controls(key_time, earliest, latest)
    return Bundles(normal, jnp.where(any_real, offset, jnp.inf), active, earliest, latest)


def _row_end(count: int) -> int:
    """Last ray of the first row of a square bundle."""
    return max(int(np.sqrt(count)) - 1, 0) if count > 1 else 0


def bounds_of_levels(
    rays: Rays, key_time: Float[Array, " keys"], options: TraceOptions
) -> list[Bundles]:
    """Bounds of all bundles, from the coarsest level to the finest.

    Args:
        rays: samples of the same rays, with a leading axis: a bundle holds all of them.
        key_time: key times of the motion.
        options: size and levels of the bundles.
    """
    each = jax.vmap(lambda one: split_into_bundles(one, options))(rays)
    bundled = jax.tree.map(
        lambda x: jnp.moveaxis(x, 0, 1).reshape(x.shape[1], -1, *x.shape[3:]), each
    )
    levels = [bound_bundles(bundled, key_time)]
    for _ in range(options.levels):
        bundled = jax.tree.map(
            lambda x: x.reshape(x.shape[0] // FAN, FAN * x.shape[1], *x.shape[2:]), bundled
        )
        levels.insert(0, bound_bundles(bundled, key_time))
    return levels


def split_into_bundles(rays: Rays, options: TraceOptions) -> Rays:
    """Split rays into (bundles, rays of a bundle); rays of direction zero, which hit nothing, pad.

    Args:
        rays: rays in a coherent order, without an axis of samples.
        options: how to trace: size and levels of the bundles.
    """
    each = options.bundle**2
    block = each * FAN**options.levels
    count = rays.time.shape[0]
    padding = max(-(-count // block), 1) * block - count

    def split(x: Array) -> Array:
        x = jnp.pad(x, ((0, padding),) + ((0, 0),) * (x.ndim - 1))
        return x.reshape(-1, each, *x.shape[1:])

    return jax.tree.map(split, rays)


def morton_tiles(width: int, height: int, side: int, levels: int) -> Int[np.ndarray, " slots"]:
    """Order of pixels by square tiles along the Morton curve.

    FAN consecutive tiles are a 4 x 4 block, and so on for coarser levels.

    Args:
        width: width of the picture in pixels.
        height: height of the picture in pixels.
        side: side of a tile in pixels.
        levels: number of coarser levels.

    Returns:
        Row-major index of the pixel of every slot; -1 beyond the picture.
    """
    span = 4**levels
    columns = -(-width // side)
    rows = -(-height // side)
    across, down = -(-columns // span) * span, -(-rows // span) * span
    y, x = np.mgrid[:down, :across]
    block = (y // span) * (across // span) + x // span
    inner = _interleave(x % span, y % span)
    order = np.lexsort((inner.ravel(), block.ravel()))
    tile_x, tile_y = x.ravel()[order], y.ravel()[order]
    dy, dx = np.mgrid[:side, :side]
    px = tile_x[:, None] * side + dx.ravel()
    py = tile_y[:, None] * side + dy.ravel()
    inside = (px < width) & (py < height)
    return np.where(inside, py * width + px, -1).ravel().astype(np.int32)


def fill_padding(order: Int[np.ndarray, " slots"]) -> Int[np.ndarray, " slots"]:
    """The slots of `morton_tiles` with each -1 replaced by the pixel before it.

    That pixel is in the same bundle, and in the same coarser bundle, if these have any pixel. A
    distant pixel would widen the bounds of a bundle: bundles at the border of the picture would
    list nearly all Gaussians.
    """
    last = np.maximum.accumulate(np.where(order >= 0, np.arange(len(order)), 0))
    return np.maximum(order[last], 0)


def _interleave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    code = np.zeros_like(x)
    for bit in range(16):
        code |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return code


def coherent_order(rays: Rays) -> Int[Array, " rays"]:
    """Permutation that brings rays of similar direction and origin together.

    Sorted by the cell of the direction (an 8^3 grid), then of the origin, then finely by
    direction: enough for bundles of rays that came in any order.
    """
    d = jnp.clip((rays.direction + 1) * 0.5, 0, 1)
    low = jnp.min(rays.origin, axis=0, keepdims=True)
    span = jnp.max(rays.origin, axis=0, keepdims=True) - low
    o = jnp.where(span > 0, (rays.origin - low) / jnp.where(span > 0, span, 1), 0)
    coarse = morton((d * 7.999).astype(jnp.int32))
    place = morton((o * 7.999).astype(jnp.int32))
    fine = morton((d * 1023).astype(jnp.int32))
    return jnp.lexsort((fine, place, coarse)).astype(jnp.int32)


def morton(cell: Int[Array, "*batch 3"]) -> Int[Array, "*batch"]:
    """Morton code of three 10-bit coordinates."""
    x = cell
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | (x << shift)) & mask
    return x[..., 0] | (x[..., 1] << 1) | (x[..., 2] << 2)
