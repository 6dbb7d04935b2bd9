"""What the file of a compiled program holds."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jax.sharding import SingleDeviceSharding
from jax.stages import Compiled
from jax.tree_util import PyTreeDef

from gaussray.runtime.program_files import write_kept


class ProgramContent(NamedTuple):
    """What a file holds.

    Args:
        code: machine code, as XLA writes it.
        example: a value with the structure of the results. (Structures cannot be written.)
        ids: numbers of the devices.
        kinds: shape, type and weakness of each result.
        leaves: number of arrays among the arguments.
    """

    code: bytes
    example: Any
    ids: list[int]
    kinds: list[tuple[Any, ...]]
    leaves: int


def read_content(path: Path) -> ProgramContent:
    """The content of a file (`write_program`). It is code: only this user's files are read."""
    return ProgramContent(*pickle.loads(path.read_bytes()))


def loaded_program(content: ProgramContent) -> Callable[..., Any]:
    """The program of a file, a function of the leaves of its arguments."""
    arguments = jax.tree.structure(((0,) * content.leaves, {}))
    results = jax.tree.structure([0] * len(content.kinds))
    by_id = {device.id: device for device in jax.local_devices()}
    devices = [by_id[i] for i in content.ids]
    program = deserialize_and_load(content.code, arguments, results, execution_devices=devices)
    return unflattened(program, jax.tree.structure(content.example))


def write_program(
    path: Path, program: Compiled, result: PyTreeDef, kinds: list[tuple[Any, ...]], leaves: int
) -> None:
    """Write a compiled program to a file.

    Args:
        path: the file.
        program: a function of arrays, which returns a list of them.
        result: the structure that its results stand for.
        kinds: shape, type and weakness of each result.
        leaves: number of its arguments.
    """
    code, _, _ = serialize(program)
    example = jax.tree.unflatten(result, range(result.num_leaves))
    devices = jax.tree.leaves(program.output_shardings)[0].device_set
    ids = sorted(device.id for device in devices)
    write_kept(path, pickle.dumps(tuple(ProgramContent(code, example, ids, kinds, leaves))))


def unflattened(program: Callable[..., Any], result: PyTreeDef) -> Callable[..., Any]:
    """A program whose results are a list, as a function that returns them in their structure.

    Args:
        program: a function of arrays.
        result: the structure.
    """
    return lambda *leaves: jax.tree.unflatten(result, program(*leaves))


def without_numbers(example: Any, kinds: list[tuple[Any, ...]]) -> Any:
    """Results on the first device, without their numbers.

    Args:
        example: a value with the structure of the results.
        kinds: shape, type and weakness of each.
    """
    place = SingleDeviceSharding(jax.local_devices()[0])
    leaves = [
        jax.ShapeDtypeStruct(shape, kind, sharding=place, weak_type=weak)
        for shape, kind, weak in kinds
    ]
    return jax.tree.unflatten(jax.tree.structure(example), leaves)
