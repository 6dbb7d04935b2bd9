"""Products of plane samples on a CUDA device: `planes.plane_product` and its gradients, in two
kernels (planes.cu).

A thread computes four channels of a Gaussian. The gradients of the planes are added up in no fixed
order, so that they differ by rounding from run to run; those of the lines, whose few knots all
Gaussians share, first within a block.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.runtime.cuda import launch, ptx


_SOURCE = Path(__file__).with_name("planes.cu")
_THREADS, _BACKWARD_THREADS, _MOST_BLOCKS = 256, 512, 264
# Numbers of the lines for which a block has room of its own.
_SHARED = 11 * 1024


def forward_on_gpu(
    space: Float[Array, "3 side side channels"],
    line: Float[Array, "3 side channels"],
    unit: Float[Array, "gaussians 3"],
) -> Float[Array, "gaussians channels"]:
    """`planes.plane_product`.

    Args:
        space: the planes xy, xz, yz.
        line: the lines of x, y, z.
        unit: positions, in the unit cube.
    """
    count, channels = unit.shape[0], line.shape[-1]
    (out,) = launch(
        "forward",
        _code(line, unit),
        (space, line, unit),
        [jax.ShapeDtypeStruct((count, channels), jnp.float32)],
        blocks=-(-_work(line, unit) // _THREADS),
        threads=_THREADS,
    )
    return out


def backward_on_gpu(
    space: Float[Array, "3 side side channels"],
    line: Float[Array, "3 side channels"],
    unit: Float[Array, "gaussians 3"],
    g: Float[Array, "gaussians channels"],
    *,
    moves: bool,
) -> tuple[Array, Array, Array | None]:
    """Gradients of `space`, `line` and, if it is wanted, `unit`.

    Args:
        space: as for `forward_on_gpu`.
        line: as for `forward_on_gpu`.
        unit: as for `forward_on_gpu`.
        g: the gradient of the products.
        moves: whether the gradient of `unit` is wanted.
    """
    sums = [jnp.zeros_like(x) for x in (space, line, unit if moves else unit[:1])]
    d_space, d_line, d_unit = launch(
        "backward",
        _code(line, unit, moves),
        (space, line, unit, g),
        [],
        blocks=min(-(-_work(line, unit) // _BACKWARD_THREADS), _MOST_BLOCKS),
        threads=_BACKWARD_THREADS,
        sums=sums,
    )
    return d_space, d_line, d_unit if moves else None


def _code(line: Array, unit: Array, moves: bool = False) -> str:
    side, channels = line.shape[1:]
    macros = {"SIDE": side, "CHANNELS": channels, "MOVES": int(moves)}
    macros["SHARED"] = int(line.size <= _SHARED)
    return ptx(_SOURCE, macros).replace("NUMBER_OF_GAUSSIANS", str(unit.shape[0]))


def _work(line: Array, unit: Array) -> int:
    """Number of threads that have something to do: four channels each, or one."""
    channels = line.shape[-1]
    return unit.shape[0] * (channels if channels % 4 else channels // 4)
