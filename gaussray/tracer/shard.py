"""One trace spread over the devices of a host: CPU cores or GPUs."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from gaussray.camera.rays import Rays
from gaussray.tracer.bundle import FAN
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion
from gaussray.tracer.trace import Report, TraceOptions, trace
from gaussray.tracer.traverse import Capacity


def mesh(devices: int | None = None) -> Mesh:
    """The first `devices` local devices (all of them by default)."""
    return Mesh(np.array(jax.local_devices()[:devices]), ("rays",))


def trace_sharded(
    motion: Motion, rays: Rays, *, options: TraceOptions, capacity: Capacity, mesh: Mesh
) -> tuple[Pixels, Report]:
    """`trace` with the rays dealt out to the devices and the scene on each; same result.

    Neighbouring blocks of bundles go to different devices, so that the work is even. `capacity` is
    that of one device; `needed` in the report is the largest of all, the counts are sums.
    """
    devices = mesh.size
    if devices == 1:
        return trace(motion, rays, options=options, capacity=capacity)
    block = options.bundle**2 * FAN**options.levels
    count = rays.time.shape[0]
    padding = -count % (block * devices)

    def deal(x):
        x = jnp.pad(x, ((0, padding),) + ((0, 0),) * (x.ndim - 1))
        x = x.reshape(-1, devices, block, *x.shape[1:])
        return jnp.moveaxis(x, 1, 0).reshape(-1, *x.shape[3:])

    def collect(x):
        x = x.reshape(devices, -1, block, *x.shape[1:])
        return jnp.moveaxis(x, 0, 1).reshape(-1, *x.shape[3:])[:count]

    everywhere, split = PartitionSpec(), PartitionSpec("rays")

    @partial(
        jax.shard_map,
        mesh=mesh,
        in_specs=(everywhere, split),
        out_specs=(split, everywhere),
        check_vma=False,
    )
    def one_device(motion, rays):
        pixels, report = trace(motion, rays, options=options, capacity=capacity)
        total = partial(jax.lax.psum, axis_name="rays")
        largest = partial(jax.lax.pmax, axis_name="rays")
        report = Report(
            needed=largest(report.needed),
            dropped=total(report.dropped),
            skipped=largest(report.skipped),
            hits=total(report.hits),
        )
        return pixels, report

    pixels, report = one_device(motion, jax.tree.map(deal, rays))
    return jax.tree.map(collect, pixels), report
