"""Six planes over space and time: a compact field of features (HexPlane, 4DGaussians)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, PRNGKeyArray

from gaussray.runtime.cuda import available as has_cuda
from gaussray.runtime.devices import numba_module, runs_machine_code
from gaussray.scene.plane_kernel import backward_on_gpu, forward_on_gpu


# The module of machine code for a CPU.
_CODE = "gaussray.scene.plane_code"
# The coordinate pairs of the planes; 3 is time.
SPACE_PAIRS = ((0, 1), (0, 2), (1, 2))


class Planes(eqx.Module):
    """Feature planes xy, xz, yz and xt, yt, zt at several resolutions.

    Beyond the box and the time interval, the border value holds.

    Args:
        space: for each scale the planes xy, xz, yz, indexed [second axis, first axis].
        time: for each scale the planes xt, yt, zt, indexed [time, axis].
        lower: lower corner of the box, in scene units.
        upper: upper corner of the box, in scene units.
        begin: first time, in the capture's unit.
        end: last time.
    """

    space: tuple[Float[Array, "3 _ _ channels"], ...]
    time: tuple[Float[Array, "3 instants _ channels"], ...]
    lower: Float[Array, "3"]
    upper: Float[Array, "3"]
    begin: Float[Array, ""]
    end: Float[Array, ""]

    @property
    def width(self) -> int:
        """Features per position: channels x scales."""
        return sum(plane.shape[-1] for plane in self.space)


def initial_planes(
    key: PRNGKeyArray,
    lower: Float[Array, "3"],
    upper: Float[Array, "3"],
    time_range: tuple[float, float],
    *,
    sides: tuple[int, ...],
    instants: int,
    channels: int,
) -> Planes:
    """Feature planes of a field that is the same at all times.

    Spatial planes are uniform in 0.7 ... 1.3, time planes are 1.

    Args:
        key: random key.
        lower: lower corner of the box, in scene units.
        upper: upper corner of the box, in scene units.
        time_range: first and last time, in the capture's unit.
        sides: resolutions of the spatial planes, one per scale.
        instants: rows of the time planes.
        channels: features per scale.
    """
    keys = jax.random.split(key, len(sides))
    dtype = lower.dtype
    return Planes(
        space=tuple(
            jax.random.uniform(k, (3, side, side, channels), dtype, 0.7, 1.3)
            for k, side in zip(keys, sides, strict=True)
        ),
        time=tuple(jnp.ones((3, instants, side, channels), dtype) for side in sides),
        lower=lower,
        upper=upper,
        begin=jnp.asarray(time_range[0], dtype),
        end=jnp.asarray(time_range[1], dtype),
    )


def features(
    planes: Planes, position: Float[Array, "gaussians 3"], time: Float[Array, ""]
) -> Float[Array, "gaussians features"]:
    """Features at positions and one time: the product of the six planes, scale by scale.

    The time is the same for all positions, so each time plane is first reduced to a line. No
    gradient reaches the box.

    Args:
        planes: the feature planes.
        position: positions in scene units.
        time: in the capture's unit.
    """
    lower, upper = jax.lax.stop_gradient((planes.lower, planes.upper))
    size = upper - lower
    # Where a box is flat (one place, so far away that a margin is lost) all of it is its border.
    unit = (position - lower[None]) / jnp.where(size > 0, size, 1)[None]
    unit = jnp.clip(unit, 0, 1)
    span = planes.end - planes.begin
    moment = jnp.clip((time - planes.begin) / jnp.where(span > 0, span, 1), 0, 1)
    parts = [jnp.zeros((len(position), 0), position.dtype)]
    for space, instants in zip(planes.space, planes.time, strict=True):
        row, fraction = _knot(moment, instants.shape[1])
        line = (1 - fraction) * instants[:, row] + fraction * instants[:, row + 1]
        parts.append(plane_product(space, line, unit))
    return jnp.concatenate(parts, axis=-1)


def plane_product(
    space: Float[Array, "3 side side channels"],
    line: Float[Array, "3 knots channels"],
    unit: Float[Array, "gaussians 3"],
) -> Float[Array, "gaussians channels"]:
    """Products of bilinear samples of three planes and linear samples of three lines.

    In single precision by Numba on a CPU (`plane_code`) and by CUDA on a GPU (`plane_kernel`), else
    by arrays: XLA compiles the 18 look-ups and their gradients for seconds.

    Args:
        space: the planes xy, xz, yz, indexed [second axis, first axis].
        line: the lines of x, y, z.
        unit: positions, in the unit cube.
    """
    side, channels = line.shape[1:]
    single = all(x.dtype == jnp.float32 for x in (space, line, unit))
    # Machine code does not look whether arrays fit, and a call for one Gaussian, which `vmap`
    # repeats for each pixel of a label, takes longer than arrays for all of them.
    fits = space.shape == (3, side, side, channels) and side > 1 and space.size < 2**31
    native = single and fits and len(line) == 3 and len(unit) > 1
    if native and (has_cuda() or runs_machine_code()):
        return _native_product(space, line, unit)
    return _array_product(space, line, unit)


def _forward(space: Array, line: Array, unit: Array) -> Array:
    if has_cuda():
        return forward_on_gpu(space, line, unit)
    return numba_module(_CODE).forward_on_cpu(space, line, unit)


def _forward_saved(space, line, unit):
    # The structure tells whether positions have a gradient, as values would be traced.
    moves = () if unit.perturbed else None
    arrays = space.value, line.value, unit.value
    return _forward(*arrays), (arrays, moves)


def _backward(saved, g):
    (space, line, unit), moves = saved
    if isinstance(g, SymbolicZero):
        return None, None, None
    back = backward_on_gpu if has_cuda() else numba_module(_CODE).backward_on_cpu
    return back(space, line, unit, g, moves=moves is not None)


_native_product = jax.custom_vjp(_forward)
_native_product.defvjp(_forward_saved, _backward, symbolic_zeros=True)


def _array_product(space: Array, line: Array, unit: Array) -> Array:
    product = jnp.ones((), unit.dtype)
    for plane, (a, b) in zip(space, SPACE_PAIRS, strict=True):
        product = product * _bilinear(plane, unit[:, b], unit[:, a])
    for axis in range(3):
        product = product * _linear(line[axis], unit[:, axis])
    return product


def _knot(unit: Array, count: int) -> tuple[Array, Array]:
    """Lower knot and fraction of a position in [0, 1] among `count` knots, ends included."""
    place = unit * (count - 1)
    low = jnp.clip(jnp.floor(jax.lax.stop_gradient(place)).astype(jnp.int32), 0, max(count - 2, 0))
    return low, place - low


def _linear(line: Array, x: Array) -> Array:
    low, fraction = _knot(x, line.shape[0])
    return (1 - fraction)[:, None] * line[low] + fraction[:, None] * line[low + 1]


def _bilinear(plane: Array, y: Array, x: Array) -> Array:
    row, down = _knot(y, plane.shape[0])
    column, right = _knot(x, plane.shape[1])
    down, right = down[:, None], right[:, None]
    top = (1 - right) * plane[row, column] + right * plane[row, column + 1]
    bottom = (1 - right) * plane[row + 1, column] + right * plane[row + 1, column + 1]
    return (1 - down) * top + down * bottom
