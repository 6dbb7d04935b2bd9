"""How well a picture of a known scene agrees with a camera, and how each of its numbers matters."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.calibrate.parameters import Unknown, applied
from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import sobol_samples
from gaussray.color import srgb_encode
from gaussray.geometry import product
from gaussray.reconstruct.optimize.loss import developed
from gaussray.scene.scene import Scene, at, moving_at
from gaussray.tracer.bundle import tiles
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


# Rays along the side of a block of pixels whose mean is compared, and tiles of rays traced at once:
# one program serves all levels.
_SIDE, _TILES = 4, 64
# What key states reach beyond the times of the rays, in their span: no ray shall be at the edge,
# where time has no slope.
_MARGIN = 0.05


class Sight(eqx.Module):
    """Some tiles of a picture, in blocks of pixels: the index (column, row) of each ray's pixel,
    its weight (0 where there is nothing to see), and the encoded mean of each block."""

    pixel: Float[Array, "rays 2"]
    weight: Float[Array, " rays"]
    truth: Float[Array, "blocks 3"]

    @property
    def side(self) -> int:
        """Rays along the side of a block."""
        return round((self.weight.shape[0] / self.truth.shape[0]) ** 0.5)


class Agreement(eqx.Module):
    """Residuals of the blocks (0 where there is none), whether they count, and sums over them with
    Huber's loss: its gradient, the curvature that a step takes (weights) and that which errors take
    (what lies within the bend), and the scatter of gradients, block by block and tile by tile."""

    residual: Float[Array, "blocks 3"]
    counts: Float[Array, " blocks"]
    gradient: Float[Array, " unknowns"]
    curvature: Float[Array, "unknowns unknowns"]
    inner: Float[Array, "unknowns unknowns"]
    scatter: Float[Array, "2 unknowns unknowns"]


def sights(
    light: Float[np.ndarray, "h w 3"], mask: np.ndarray, factor: int, *, bundle: int
) -> list[Sight]:
    """A picture (linear light) in blocks of `factor` x `factor` pixels, where the mask is not 0.

    Blocks are compared by their means: of all pixels in the picture, of at most 4 x 4 rays, evenly
    spread, in what is rendered. Rays are those of whole pixels, so that row times and lens need no
    scaling. Tiles of bundle x bundle rays hold whole blocks.
    """
    (height, width), dtype = mask.shape, light.dtype
    side = min(factor, _SIDE, bundle & -bundle)
    across, down = -(-width // factor), -(-height // factor)
    pad = (0, down * factor - height), (0, across * factor - width)
    full = np.pad(mask.astype(np.float64), pad)
    light = np.pad(light.astype(np.float64), (*pad, (0, 0))) * full[..., None]
    shape = down, factor, across, factor
    count = full.reshape(shape).sum(axis=(1, 3))
    mean = light.reshape(*shape, 3).sum(axis=(1, 3)) / np.maximum(count, 1)[..., None]

    order = tiles(across * side, down * side, bundle, 0).reshape(-1, bundle**2)
    inside, (y, x) = order >= 0, np.divmod(np.maximum(order, 0), across * side)
    place = ((np.arange(side) + 0.5) * factor / side).astype(int)
    row, column = (v // side * factor + place[v % side] for v in (y, x))
    weight = full[row, column] * inside
    each = bundle // side
    first = (slice(None), slice(0, None, side), slice(0, None, side))
    block = tuple(v.reshape(-1, bundle, bundle)[first].reshape(-1, each**2) for v in (y, x))
    truth = srgb_encode(mean[block[0] // side, block[1] // side])

    seen = np.flatnonzero(weight.any(axis=1))
    most = min(_TILES, -(-width // bundle) * -(-height // bundle))
    result = []
    for begin in range(0, len(seen), most):
        own = seen[begin : begin + most]
        spare = most - len(own)
        pixel = np.stack([column[own], row[own]], axis=-1)
        values = pixel.reshape(-1, 2), weight[own].reshape(-1), truth[own].reshape(-1, 3)
        room = spare * bundle**2, spare * bundle**2, spare * each**2
        padded = [
            np.pad(x, [(0, n)] + [(0, 0)] * (x.ndim - 1)) for x, n in zip(values, room, strict=True)
        ]
        result.append(Sight(*(jnp.asarray(x, dtype) for x in padded)))
    return result


class Aligner:
    """Compares pictures with cameras; list sizes are measured once and grow where they must."""

    def __init__(
        self, told: tuple[Unknown, ...], *, samples: int, trace: TraceOptions, bend: float
    ):
        self.told, self.samples, self.bend = told, samples, bend
        # Tiles of a part need not be neighbours.
        self.trace = dataclasses.replace(trace, levels=0)
        self._capacity: dict[Any, Capacity] = {}

    def __call__(
        self,
        scene: Scene,
        camera: Camera,
        unit: CameraSet,
        sight: Sight,
        at: np.ndarray,
        spread: float,
        *,
        keys: int,
    ) -> Agreement:
        """How a sight agrees with a camera `at` these values of its unknowns; Huber's loss bends at
        `bend` times the spread."""
        dtype = camera.time.dtype
        value = jnp.asarray(at, dtype)
        given = scene, camera, unit, sight.pixel, sight.weight, value
        how = {"told": self.told, "samples": self.samples, "keys": keys}
        size = sight.weight.shape, keys
        if size not in self._capacity:
            self._capacity[size] = measure(
                *_looked_at(*given, **how), options=self.trace, headroom=1.5
            )
        while True:
            capacity = self._capacity[size]
            slopes, needed, dropped = _slopes(*given, **how, trace=self.trace, capacity=capacity)
            if not int(dropped):
                break
            self._capacity[size] = enlarge(capacity, [int(n) for n in needed], headroom=1.5)
        bend = jnp.asarray(self.bend * spread, dtype)
        found = _agreement(
            slopes, camera, unit, value, sight, bend, told=self.told, bundle=self.trace.bundle
        )
        return jax.device_get(found)


class Slopes(NamedTuple):
    """What rays see, in linear light, how that changes with the unknowns, and what each weighs."""

    color: Float[Array, "rays 3"]
    change: Float[Array, "rays 3 unknowns"]
    weight: Float[Array, " rays"]


def _rays(camera, unit, pixel, weight, value, told, samples) -> Rays:
    """Rays of all samples; those without weight meet nothing."""
    seen, _ = applied(value, camera, unit, told)
    u = sobol_samples(samples).astype(value.dtype)

    def sample(one: Float[Array, "5"]) -> Rays:
        return camera_rays(seen, pixel, jnp.broadcast_to(one, (pixel.shape[0], 5)))

    rays = jax.vmap(sample)(u)
    direction = jnp.where(weight[None, :, None] > 0, rays.direction, 0)
    return Rays(rays.origin, direction, rays.time)


def _motion(scene: Scene, rays: Rays, keys: int) -> Motion:
    """The scene across the times of rays, and a little beyond."""
    if scene.deformation is None:
        return still(at(scene, jnp.zeros_like(rays.time[0, 0])))
    time = jax.lax.stop_gradient(rays.time)
    first, last = jnp.min(time), jnp.max(time)
    instants = jnp.asarray(scene.deformation.instants, time.dtype)
    least = (instants[-1] - instants[0]) / max(4 * (len(instants) - 1), 1)
    room = jnp.maximum(_MARGIN * (last - first), jnp.where(last > first, 0, least))
    key_time = jnp.linspace(first - room, last + room, max(keys, 3), dtype=time.dtype)
    rest = scene.static if scene.static.count else None
    return Motion(key_time, moving_at(scene, key_time), rest)


@eqx.filter_jit
def _looked_at(
    scene, camera, unit, pixel, weight, value, *, told, samples, keys
) -> tuple[Motion, Rays]:
    rays = _rays(camera, unit, pixel, weight, value, told, samples)
    return _motion(scene, rays, keys), rays


@eqx.filter_jit
def _slopes(
    scene, camera, unit, pixel, weight, value, *, told, samples, keys, trace, capacity
) -> tuple[Slopes, Array, Array]:
    """What rays see and how it changes, list sizes and how many entries were dropped.

    A ray sees for itself alone. So three backward passes, one for each channel, give the slope of
    every ray's colour along its own origin, direction and time; how those follow from the unknowns
    is a forward derivative. The cost hardly depends on how many unknowns there are.
    """

    def rays_of(value: Array) -> Rays:
        return _rays(camera, unit, pixel, weight, value, told, samples)

    rays, turn = rays_of(value), jax.jacfwd(rays_of)(value)
    motion = _motion(scene, rays, keys)

    def color_of(rays: Rays):
        pixels, report = trace_sharded(motion, rays, options=trace, capacity=capacity, mesh=None)
        return pixels.color, report

    color, pull, report = jax.vjp(color_of, rays, has_aux=True)
    channels = jnp.broadcast_to(jnp.eye(3, dtype=color.dtype)[:, None, None], (3, *color.shape))
    slope = jax.lax.map(lambda one: pull(one)[0], channels)
    change = (
        product("csrx,srxp->rcp", slope.origin, turn.origin)
        + product("csrx,srxp->rcp", slope.direction, turn.direction)
        + product("csr,srp->rcp", slope.time, turn.time)
    ) / color.shape[0]
    formed = jnp.all(jnp.any(rays.direction != 0, axis=-1), axis=0)
    slopes = Slopes(jnp.mean(color, axis=0), change, jnp.where(formed, weight, 0))
    return slopes, report.needed, report.dropped


@eqx.filter_jit
def _agreement(slopes: Slopes, camera, unit, value, sight, bend, *, told, bundle) -> Agreement:
    """Blocks against their truth, as encoded values."""

    def gain_of(value: Array) -> Array:
        return applied(value, camera, unit, told)[1]

    color, change, counts = _blocks(slopes, sight.side, bundle)
    gain, brighten = gain_of(value), jax.jacfwd(gain_of)(value)
    change = gain[None, :, None] * change + color[..., None] * brighten[None]
    light = gain[None] * color
    encoded, bright = jax.jvp(
        lambda x: developed(srgb_encode(x), sight.truth), (light,), (jnp.ones_like(light),)
    )
    seen = counts[:, None] > 0
    residual = jnp.where(seen, encoded - sight.truth, 0)
    change = jnp.where(seen[..., None], bright[..., None] * change, 0)
    size = jnp.abs(residual)
    inner = (size < bend).astype(size.dtype)
    weigh = jnp.where(size < bend, 1, bend / jnp.where(size < bend, 1, size))
    own = product("bcp,bc->bp", change, weigh * residual)
    tile = jnp.sum(own.reshape(-1, (bundle // sight.side) ** 2, own.shape[1]), axis=1)
    return Agreement(
        residual,
        counts,
        jnp.sum(own, axis=0),
        product("bcp,bc,bcq->pq", change, weigh, change),
        product("bcp,bc,bcq->pq", change, inner, change),
        jnp.stack([product("bp,bq->pq", x, x) for x in (own, tile)]),
    )


def _blocks(slopes: Slopes, side: int, bundle: int) -> tuple[Array, Array, Array]:
    """Weighted means over the blocks of side x side rays, and which blocks hold any."""
    each, weight = bundle // side, slopes.weight
    shape = -1, each, side, each, side

    def summed(x: Array) -> Array:
        blocks = jnp.sum(x.reshape(*shape, *x.shape[1:]), axis=(2, 4))
        return blocks.reshape(-1, *x.shape[1:])

    count = summed(weight)
    total = jnp.where(count > 0, count, 1)
    color = summed(weight[:, None] * slopes.color) / total[:, None]
    change = summed(weight[:, None, None] * slopes.change) / total[:, None, None]
    return color, change, (count > 0).astype(weight.dtype)
