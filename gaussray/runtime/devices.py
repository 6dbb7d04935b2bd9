"""The devices that work together: those of one host, or of several that share a folder."""

import contextlib
import os
import sys
from collections.abc import Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from gaussray.runtime.jit_cache import keep_programs


_T = TypeVar("_T")


class DevicesOptions(eqx.Module):
    """Who works together; the result is that of one device up to the order of sums.

    `count` devices of each host (0 = all). `hosts` processes, started with the same words but for
    `process`, their number from 0, meet at `coordinator`, an address HOST:PORT of process 0; with
    `hosts` = 0 the cluster's environment says all that is not given. They share the output folder.
    What is compiled is kept in the folder `programs` for later runs (`keep_programs`).
    """

    count: int = eqx.field(static=True, default=0)
    hosts: int = eqx.field(static=True, default=1)
    process: int = eqx.field(static=True, default=-1)
    coordinator: str = eqx.field(static=True, default="")
    programs: str = eqx.field(static=True, default="auto")

    def __check_init__(self):
        for name in ("count", "hosts"):
            if getattr(self, name) < 0:
                raise ValueError(f"devices.{name} must be at least 0, got {getattr(self, name)}.")
        if self.hosts > 1 and not 0 <= self.process < self.hosts:
            raise ValueError(
                f"devices.process must be in 0 ... {self.hosts - 1} with devices.hosts="
                f"{self.hosts}, got {self.process}. Start every process with its own number."
            )
        host, _, port = self.coordinator.rpartition(":")
        if (self.hosts > 1 or self.coordinator) and not (host and port.isdigit()):
            raise ValueError(
                "devices.coordinator must be HOST:PORT, an address of process 0 and a free port "
                f"there, got {self.coordinator!r}. Give the same to all processes."
            )


def begin(options: DevicesOptions) -> int | None:
    """Bring the devices up, before JAX does anything else; how many of them each host uses (None
    is all).

    On a CPU each core is a device of its own, among which rays and frames are dealt out.
    """
    # Where JAX is already at work (in a notebook, in tests) it keeps the devices that it has.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", options.count or _cores())
    keep_programs(options.programs)
    if options.hosts != 1 and not jax.distributed.is_initialized():
        _meet(options)
    found = jax.local_device_count()
    if options.count > found:
        raise ValueError(
            f"devices.count must be at most {found}, what JAX finds here, got {options.count}. "
            "0 takes all."
        )
    # What hosts tell each other is laid out over all their devices.
    if jax.device_count() != jax.process_count() * found:
        raise ValueError(
            f"devices.hosts: every process must see equally many devices, but this one sees "
            f"{found} of {jax.device_count()}. Limit them with CUDA_VISIBLE_DEVICES, or on CPUs "
            "with devices.count."
        )
    return options.count or None


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def _meet(options: DevicesOptions) -> None:
    """Join the other processes; JAX ends this one if they do not come within five minutes."""
    given: dict[str, Any] = {
        "coordinator_address": options.coordinator or None,
        "num_processes": options.hosts or None,
        "process_id": None if options.process < 0 else options.process,
    }
    if options.hosts:
        # Nothing is left to a cluster: under SLURM, JAX would take one device per process.
        given["cluster_detection_method"] = "deactivate"
        where = f"process {options.process} of {options.hosts} at {options.coordinator}"
        print(f"gaussray: {where} waits for the others", file=sys.stderr, flush=True)
    try:
        jax.distributed.initialize(**given)
    except ValueError as error:
        raise ValueError(
            "devices.hosts must be 1 or more where no cluster says how many processes there are, "
            "got 0. Give devices.hosts, devices.process and devices.coordinator."
        ) from error
    except RuntimeError as error:
        raise ValueError(
            f"devices.hosts must be 1 where JAX is already at work, got {options.hosts}. Start "
            "each process from the command line, or call jax.distributed.initialize first."
        ) from error


def together() -> bool:
    """Whether this process has met others, or will wait for them at its end."""
    return jax.distributed.is_initialized()


def leads() -> bool:
    """Whether this is process 0, which alone writes what all have found."""
    return jax.process_index() == 0


def share(items: Sequence[_T]) -> Sequence[_T]:
    """The items that fall to this process; neighbours go to different ones, as they cost alike."""
    return items[jax.process_index() :: jax.process_count()]


def wait(name: str) -> None:
    """Go on when every process has come here."""
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices(name)


def agreed(tree: _T) -> _T:
    """The arrays of process 0, on this host alone.

    What hosts decide on by themselves (how many Gaussians, how long a list) must follow from equal
    values, or their programs part; arithmetic on other hardware may differ in the last bit.
    """
    if jax.process_count() == 1:
        return tree
    told = multihost_utils.broadcast_one_to_all(jax.tree.map(np.asarray, tree))
    return jax.tree.map(jnp.asarray, told)


def everywhere(tree: _T, mesh: Mesh) -> _T:
    """The arrays, equal on all hosts, on every device of the mesh."""
    sharding = NamedSharding(mesh, PartitionSpec())
    own = [d for d in mesh.devices.flat if d.process_index == jax.process_index()]

    def one(x):
        if getattr(x, "sharding", None) == sharding:
            return x
        copies = [jax.device_put(x, device) for device in own]
        return jax.make_array_from_single_device_arrays(x.shape, sharding, copies)

    return jax.tree.map(one, tree)


def leave(code: int) -> None:
    """End the process; the others then fail too, rather than wait for it at the exit."""
    if together():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    raise SystemExit(code)
