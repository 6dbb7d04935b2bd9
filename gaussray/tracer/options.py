"""Options of the tracer, and the choice of its backend."""

import equinox as eqx
import jax.numpy as jnp
from jax.typing import DTypeLike

from gaussray.io.validate import check_field_types
from gaussray.runtime import cuda
from gaussray.runtime.devices import runs_machine_code


BACKENDS = ("auto", "array", "kernel")
# Coarser levels of bundles that lists in machine code on a CPU look at.
CPU_LEVELS = 2


class TraceOptions(eqx.Module):
    """Options of the tracer. All are static: changing one recompiles.

    Args:
        k: hits per round. Rounds continue until the transmittance falls to `transmittance_min` or
            no hit is left, so k affects speed only.
        alpha_min: alpha below which a Gaussian has no effect.
        alpha_max: largest alpha of a hit.
        transmittance_min: transmittance at which a ray ends.
        bundle: side of a square bundle of rays, in pixels.
        levels: number of coarser bundle levels; 0 for bundles that are not neighbours. Scenes of
            millions of Gaussians get more levels.
        group: bundles that march together; 0 is 4 on a CPU, whose caches they fill, and 16 on a
            GPU.
        chunk: list entries that are read at once.
        backend: "array" runs everywhere in any precision; "kernel" is single precision, by CUDA on
            a GPU (kernel.py) or Numba on a CPU (cpu/kernel.py); "auto" is the kernel where it runs.

    Raises:
        ValueError: A value breaks its rule; the message names the key.
    """

    k: int = eqx.field(static=True, default=16)
    alpha_min: float = eqx.field(static=True, default=1 / 255)
    alpha_max: float = eqx.field(static=True, default=0.99)
    transmittance_min: float = eqx.field(static=True, default=1e-4)
    bundle: int = eqx.field(static=True, default=8)
    levels: int = eqx.field(static=True, default=1)
    group: int = eqx.field(static=True, default=0)
    chunk: int = eqx.field(static=True, default=16)
    backend: str = eqx.field(static=True, default="auto")

    def __check_init__(self):
        check_field_types("trace", self)
        for name in ("k", "bundle", "chunk"):
            if getattr(self, name) < 1:
                raise ValueError(f"trace.{name} must be at least 1, got {getattr(self, name)}.")
        if self.backend not in BACKENDS:
            raise ValueError(
                f"trace.backend must be one of {', '.join(BACKENDS)}, got {self.backend!r}."
            )
        if self.group < 0:
            raise ValueError(f"trace.group must be at least 0, got {self.group}.")
        if not 0 <= self.levels <= 4:
            raise ValueError(f"trace.levels must be from 0 to 4, got {self.levels}.")
        if not 0 < self.alpha_min < self.alpha_max < 1:
            raise ValueError(
                "trace.alpha_min and trace.alpha_max must satisfy 0 < alpha_min < alpha_max < 1, "
                f"got {self.alpha_min} and {self.alpha_max}."
            )
        if not 0 <= self.transmittance_min < 1:
            raise ValueError(
                f"trace.transmittance_min must be in [0, 1), got {self.transmittance_min}."
            )


def on_kernel(options: TraceOptions, dtype: DTypeLike) -> bool:
    """Whether the CUDA kernel traces rays of a precision.

    Args:
        options: options of the tracer.
        dtype: precision of the rays.

    Raises:
        ValueError: the kernel is asked for and runs neither on a GPU nor on a CPU.
    """
    single = jnp.dtype(dtype) == jnp.float32
    if options.backend == "kernel" and not single:
        raise ValueError(
            f"trace.backend=kernel is for single precision, the rays are {jnp.dtype(dtype)}. "
            "Choose trace.backend=array."
        )
    if options.backend == "kernel" and not cuda.available() and not on_cpu_kernel(options, dtype):
        raise ValueError(
            "trace.backend=kernel needs a CUDA device and NVIDIA's run-time compiler (pip install "
            "-e '.[cuda]'), or on a CPU Numba (pip install numba); or choose trace.backend=array."
        )
    return options.backend != "array" and single and cuda.available()


def on_cpu_kernel(options: TraceOptions, dtype: DTypeLike) -> bool:
    """Whether bundles of rays of a precision march in machine code on a CPU (cpu/march.py).

    Machine code finds their lists as well (cpu/lists.py), without a grid.

    Args:
        options: options of the tracer.
        dtype: precision of the rays.
    """
    single = jnp.dtype(dtype) == jnp.float32
    return options.backend != "array" and single and runs_machine_code()


def grid_levels(options: TraceOptions, dtype: DTypeLike) -> int:
    """For how many levels of bundles cells of a grid are found: for none in machine code on a CPU,
    which looks at the Gaussians themselves (cpu/lists.py).

    Args:
        options: options of the tracer.
        dtype: precision of the rays.
    """
    return 0 if on_cpu_kernel(options, dtype) else options.levels + 1
