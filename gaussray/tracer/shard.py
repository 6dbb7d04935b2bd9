"""One trace spread over devices: CPU cores or GPUs, of one host or of several."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from gaussray.camera.rays import Rays
from gaussray.tracer.bundle import FAN
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import Motion
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.prepare import Prepared
from gaussray.tracer.trace import Report, trace
from gaussray.tracer.traverse import Capacity


def mesh(devices: int | None = None) -> Mesh:
    """A mesh of the first `devices` local devices (all of them by default)."""
    return Mesh(np.array(jax.local_devices()[:devices]), ("rays",))


def mesh_of_hosts(devices: int | None = None) -> Mesh:
    """A mesh of the first `devices` devices of every host, in the same order on all hosts."""
    hosts: dict[int, list[jax.Device]] = {}
    for device in jax.devices():
        hosts.setdefault(device.process_index, []).append(device)
    return Mesh(np.array([d for local in hosts.values() for d in local[:devices]]), ("rays",))


def trace_sharded(
    motion: Motion | Prepared,
    rays: Rays,
    *,
    options: TraceOptions,
    capacity: Capacity,
    mesh: Mesh | None,
    presharded: bool = False,
) -> tuple[Pixels, Report]:
    """`trace` with the rays divided among devices; each device has the whole scene. Same result.

    Neighbouring blocks of bundles go to different devices, so that the work is even; unless the
    rays are dealt out already: then they and their pixels stay where they are.

    Args:
        motion: as for `trace`.
        rays: as for `trace`.
        options: as for `trace`.
        capacity: list sizes of one device.
        mesh: the devices; None or a single one is `trace` itself.
        presharded: whether each device gets the run of rays that it holds, as many blocks of
            bundles as every other one.

    Returns:
        The pixels, and a report: `needed` is the largest of all devices, counts are sums.
    """
    if mesh is None or mesh.size == 1:
        return trace(motion, rays, options=options, capacity=capacity)
    devices, block = mesh.size, options.bundle**2 * FAN**options.levels
    axis = rays.time.ndim - 1
    lead, count = rays.time.shape[:axis], rays.time.shape[axis]
    padding = -count % (block * devices)

    def deal(x):
        x = jnp.pad(x, [(0, padding) if i == axis else (0, 0) for i in range(x.ndim)])
        x = x.reshape(*lead, -1, devices, block, *x.shape[axis + 1 :])
        return jnp.moveaxis(x, axis + 1, axis).reshape(*lead, -1, *x.shape[axis + 3 :])

    def collect(x):
        x = x.reshape(*lead, devices, -1, block, *x.shape[axis + 1 :])
        x = jnp.moveaxis(x, axis, axis + 1).reshape(*lead, -1, *x.shape[axis + 3 :])
        return jax.lax.slice_in_dim(x, 0, count, axis=axis)

    everywhere, split = PartitionSpec(), PartitionSpec(*(None,) * axis, "rays")

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

    spread = jax.shard_map(
        one_device,
        mesh=mesh,
        in_specs=(everywhere, split),
        out_specs=(split, everywhere),
        check_vma=False,
    )
    if presharded:
        return spread(motion, rays)
    pixels, report = spread(motion, jax.tree.map(deal, rays))
    return jax.tree.map(collect, pixels), report
