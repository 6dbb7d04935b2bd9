"""Devices of one host or of several hosts, and how hosts exchange arrays."""

import contextlib
import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from gaussray.runtime.jit_cache import keep_programs
from gaussray.runtime.output import emit
from gaussray.runtime.program_cache import TRITON


_T = TypeVar("_T")

_importing_numba = threading.Lock()


class DevicesOptions(eqx.Module):
    """Which devices and hosts run a command.

    The result is that of one device, up to the order of sums; but `fit=auto` gives each GPU as many
    rays as a single one gets, except for rigid bodies. All hosts share the output folder.

    Args:
        count: devices of each host; 0 for all (of a CPU: `cpu_devices`).
        hosts: number of processes, each started with the same arguments but for `process`. 0: the
            cluster's environment defines hosts, process and coordinator.
        process: number of this process, from 0.
        coordinator: address HOST:PORT of process 0, at which the processes meet.
        programs: folder in which compiled programs are kept for later runs (`keep_programs`).

    Raises:
        ValueError: a value is out of range; the message names its key.
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


def start_devices(options: DevicesOptions) -> int | None:
    """Start the devices, before JAX does anything else.

    A CPU is one device, whose machine code uses all cores (`has_machine_code`). Without it each
    core becomes a device, so that rays and frames are distributed over all cores.

    Returns:
        The number of devices that each host uses; None for all.

    Raises:
        ValueError: there are fewer devices than asked for, hosts have different numbers of devices,
            or the hosts cannot meet.
    """
    # If JAX has already started (in a notebook, in tests) it keeps its devices.
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", options.count or cpu_devices())
    _leave_out_triton()
    keep_programs(options.programs)
    if options.hosts != 1 and not jax.distributed.is_initialized():
        _meet(options)
    local = jax.local_device_count()
    if options.count > local:
        raise ValueError(
            f"devices.count must be at most {local}, all that JAX sees, got {options.count}. "
            "0 takes all."
        )
    # Arrays that hosts exchange are laid out over all devices of all hosts.
    if jax.device_count() != jax.process_count() * local:
        raise ValueError(
            f"devices.hosts: every process must see equally many devices, but this one sees "
            f"{local} of {jax.device_count()}. Limit them with CUDA_VISIBLE_DEVICES, or on CPUs "
            "with devices.count."
        )
    return options.count or None


def _leave_out_triton() -> None:
    """Let XLA multiply matrices by NVIDIA's library alone (`TRITON`), before it reads its flags.

    A version that does not know a flag ends the process, so only those that were tried are told,
    and only where a GPU's library is installed: flags are part of a kept program's key.
    """
    flags, release = os.environ.get("XLA_FLAGS", ""), jax.__version_info__[:2]
    has_gpu = any(importlib.util.find_spec(f"jax_cuda{n}_plugin") for n in (12, 13))
    if has_gpu and (0, 8) <= release <= (0, 11) and TRITON not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --{TRITON}=false".strip()


def cores() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


def has_machine_code() -> bool:
    """Whether Numba is there to compile machine code for a CPU."""
    return importlib.util.find_spec("numba") is not None


def runs_machine_code() -> bool:
    """Whether programs run on a CPU and may call machine code."""
    return jax.default_backend() == "cpu" and has_machine_code()


def numba_module(name: str) -> Any:
    """A module of machine code, which takes as long to import as a small picture to render.

    Numba's modules import each other: of threads that compile programs at the same time, one alone
    imports them.
    """
    with _importing_numba:
        return importlib.import_module(name)


def cpu_devices() -> int:
    """Devices that JAX shall make of the CPU."""
    return 1 if has_machine_code() else cores()


def _meet(options: DevicesOptions) -> None:
    """Join the other processes. JAX ends this one if they do not join within five minutes."""
    arguments: dict[str, Any] = {
        "coordinator_address": options.coordinator or None,
        "num_processes": options.hosts or None,
        "process_id": None if options.process < 0 else options.process,
    }
    if options.hosts:
        # Without this JAX would use one device per process under SLURM.
        arguments["cluster_detection_method"] = "deactivate"
        process = f"process {options.process} of {options.hosts} at {options.coordinator}"
        emit(f"gaussray: {process} waits for the others\n", sys.stderr)
    try:
        jax.distributed.initialize(**arguments)
    except ValueError as error:
        raise ValueError(
            "devices.hosts must be 1 or more where no cluster says how many processes there are, "
            "got 0. Give devices.hosts, devices.process and devices.coordinator."
        ) from error
    except RuntimeError as error:
        raise ValueError(
            f"devices.hosts must be 1 where JAX has already started, got {options.hosts}. Start "
            "each process from the command line, or call jax.distributed.initialize first."
        ) from error


def is_distributed() -> bool:
    """Whether this process belongs to a group of processes, which wait for each other at exit."""
    return jax.distributed.is_initialized()


def is_primary() -> bool:
    """Whether this is process 0, which writes the files that all processes share."""
    return jax.process_index() == 0


def items_of_this_process(items: Sequence[_T]) -> Sequence[_T]:
    """The items that this process works on. Neighbouring items go to different processes, because
    they tend to cost the same."""
    return items[jax.process_index() :: jax.process_count()]


def barrier(name: str) -> None:
    """Wait until every process has called this function with the same name."""
    if jax.process_count() > 1:
        multihost_utils.sync_global_devices(name)


def from_primary(tree: _T) -> _T:
    """The arrays of process 0, copied to every host.

    Hosts must take decisions (the number of Gaussians, the length of a list) from equal values, or
    they run different programs; arithmetic on different hardware may differ in the last bit.
    """
    if jax.process_count() == 1:
        return tree
    arrays = multihost_utils.broadcast_one_to_all(jax.tree.map(np.asarray, tree))
    return jax.tree.map(jnp.asarray, arrays)


def replicate(tree: _T, mesh: Mesh) -> _T:
    """Copy arrays to every device of a mesh.

    Args:
        tree: arrays, equal on all hosts; those that are on all devices already stay.
        mesh: devices of one or several hosts.
    """
    sharding = NamedSharding(mesh, PartitionSpec())
    local = [d for d in mesh.devices.flat if d.process_index == jax.process_index()]

    def one(x):
        if getattr(x, "sharding", None) == sharding:
            return x
        copies = [jax.device_put(x, device) for device in local]
        return jax.make_array_from_single_device_arrays(x.shape, sharding, copies)

    return jax.tree.map(one, tree)


def exit_process(code: int) -> None:
    """End the process with an exit code. The other processes then fail too, instead of waiting for
    this one."""
    if is_distributed():
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    raise SystemExit(code)
