"""Compiled programs on disk that later processes call without tracing them.

JAX's own cache saves the compilation, but a program must be traced and lowered to be found in it,
which takes longer than to run it. Here the name of a file follows from what a program is made for.
"""

import contextlib
import functools
import pickle
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jax.sharding import SingleDeviceSharding
from jax.stages import Compiled, Lowered
from jax.tree_util import PyTreeDef

from gaussray.runtime.program_files import (
    files_are_kept,
    full_text,
    is_own,
    kept_file,
    write_kept,
)


_P = ParamSpec("_P")
_R = TypeVar("_R")


class KeptProgram:
    """A compiled function whose machine code is on disk, where `program_files` are kept.

    A file holds the code for arguments of one structure, shapes, types and devices. Its name
    follows from these, the key, this package's source, and the versions and settings of JAX.

    Args:
        function: a pure function of arrays in any structure.
        key: everything that the function depends on beside its arguments and the package's source.
        compiler: options of the compiler.
        needs: called before the program is read: it makes known to XLA what the program calls.
        kernels: whether the function may call kernels, which XLA cannot write to disk: a GPU's
            program is then compiled in each process.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        key: tuple[Hashable, ...],
        compiler: dict[str, bool] | None = None,
        needs: Callable[[], Any] = lambda: None,
        kernels: bool = True,
    ):
        self._function, self._compiler, self._needs = function, compiler, needs
        self._kernels = kernels
        self._jitted: Any = jax.jit(function, compiler_options=compiler)
        self._key = full_text((getattr(function, "__qualname__", ""), key, compiler))
        self._known: dict[Hashable, Callable[..., Any]] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        self._begun: dict[Hashable, tuple[Future[Callable[..., Any]], Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        if not files_are_kept():
            return self._jitted(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._jitted(*arguments)
        signature = structure, tuple(map(_kind, leaves))
        if signature not in self._known:
            path = self._file(signature)
            if path is None:
                return self._jitted(*arguments)
            # Of several threads one compiles.
            with self._locks.setdefault(signature, threading.Lock()):
                if signature not in self._known:
                    return self._first(leaves, signature, path)
        return self._known[signature](*leaves)

    def expect(self, *arguments: Any) -> Any:
        """Begin to read or to compile the program for such arguments: the first call waits for it.

        Args:
            arguments: arrays of one device, or what `expect` of other programs returned for theirs.

        Returns:
            The results without their numbers; None if the program is not kept.
        """
        leaves, structure = jax.tree.flatten(arguments)
        signature = structure, tuple(map(_kind, leaves))
        if signature not in self._begun:
            path = self._file(signature)
            if path is None:
                return None
            self._begun[signature] = self._beginning(leaves, structure, path)
        return self._begun[signature][1]

    def clear_cache(self) -> None:
        """Release the compiled code."""
        self._jitted.clear_cache()
        self._known.clear()
        self._begun.clear()

    def _first(self, leaves: list[Any], signature: tuple[Any, ...], path: Path) -> Any:
        """The results of the first call: of a program from disk, or compiled and written there."""
        with contextlib.suppress(Exception):
            # A file that is damaged or cannot be run here is no error: the program is compiled.
            program = None
            if signature in self._begun:
                program = self._begun[signature][0].result()
            elif path.is_file() and is_own(path):
                self._needs()
                program = _loaded(len(leaves), *_read(path))
            if program is not None:
                results = jax.block_until_ready(program(*leaves))
                self._known[signature] = program
                return results
        lowered = self._lowered(leaves, signature[0], path)
        self._known[signature] = program = lowered.compiled(path)
        return program(*leaves)

    def _file(self, signature: tuple[Any, ...]) -> Path | None:
        """The file of the program for such arguments; None where it cannot be kept."""
        known = not self._kernels or jax.default_backend() == "cpu"
        return kept_file(self._key + full_text(signature)) if known else None

    def _beginning(
        self, leaves: list[Any], structure: PyTreeDef, path: Path
    ) -> tuple[Future[Callable[..., Any]], Any]:
        """A program that a thread reads or compiles, and its results without their numbers."""
        with contextlib.suppress(Exception):
            if path.is_file() and is_own(path):
                code, example, ids, kinds = _read(path)

                def load() -> Callable[..., Any]:
                    self._needs()
                    return _loaded(len(leaves), code, example, ids, kinds)

                return _threads().submit(load), _without_numbers(example, kinds)
        lowered = self._lowered(leaves, structure, path)
        example = jax.tree.unflatten(lowered.result, range(lowered.result.num_leaves))
        return (
            _threads().submit(lowered.compiled, path),
            _without_numbers(example, lowered.kinds),
        )

    def _lowered(self, leaves: list[Any], structure: PyTreeDef, path: Path) -> "_LoweredProgram":
        """A program of the leaves of the arguments, whose results are leaves of this structure."""
        results: list[PyTreeDef] = []

        def flat(*leaves: Any) -> list[Any]:
            made, result = jax.tree.flatten(self._function(*jax.tree.unflatten(structure, leaves)))
            results.append(result)
            return made

        # With a name of its own it is not found in JAX's cache: a program that has been read from
        # there lacks some of its code when it is written again.
        flat.__name__ = f"{path.stem}_{time.time_ns()}"
        traced = jax.jit(flat, compiler_options=self._compiler).trace(*leaves)
        kinds = [(x.shape, x.dtype, x.weak_type) for x in traced.jaxpr.out_avals]
        return _LoweredProgram(traced.lower(), flat.__name__, results[-1], kinds)


def kept_jit(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """`eqx.filter_jit` of a function whose programs are kept (`KeptProgram`).

    Args:
        function: a pure function without kernels. Arrays in its arguments are traced; the program
            depends on all else in them.
    """
    programs: dict[Hashable, KeptProgram] = {}
    call: Any = function  # With its parameters unknown, for the type checker.
    name = f"{function.__module__}.{function.__qualname__}"

    @functools.wraps(function)
    def called(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        arrays, others = eqx.partition((args, kwargs), eqx.is_array)
        leaves, structure = jax.tree.flatten(others)
        key = name, structure, *leaves
        if key not in programs:

            def run(arrays: Any) -> _R:
                args, kwargs = eqx.combine(arrays, others)
                return call(*args, **kwargs)

            programs[key] = KeptProgram(run, key, kernels=False)
        return programs[key](arrays)

    return called


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Threads that read and compile: XLA uses as many cores as there are anyway."""
    return ThreadPoolExecutor(4, "program")


class _LoweredProgram(NamedTuple):
    """A program to be compiled, its name, the structure of its results, and shape, type and
    weakness of each."""

    program: Lowered
    name: str
    result: PyTreeDef
    kinds: list[tuple[Any, ...]]

    def compiled(self, path: Path) -> Callable[..., Any]:
        """The compiled program, which is written to a file."""
        program = self.program.compile()
        for useless in path.parent.glob(f"*{self.name}*"):
            useless.unlink(missing_ok=True)
        with contextlib.suppress(Exception):
            path.unlink(missing_ok=True)
            _write(path, program, self.result, self.kinds)
        return _unflattened(program, self.result)


def _unflattened(program: Compiled, result: PyTreeDef) -> Callable[..., Any]:
    return lambda *leaves: jax.tree.unflatten(result, program(*leaves))


# What a file holds: code, a value with the structure of the results, the numbers of the devices,
# and shape, type and weakness of each result.
_Content = tuple[bytes, Any, list[int], list[tuple[Any, ...]]]


def _read(path: Path) -> _Content:
    return pickle.loads(path.read_bytes())


def _loaded(
    leaves: int, code: bytes, example: Any, ids: list[int], kinds: list[tuple[Any, ...]]
) -> Callable[..., Any]:
    """The program in a file, a function of so many leaves."""
    arguments, results = (
        jax.tree.structure(((0,) * leaves, {})),
        jax.tree.structure([0] * len(kinds)),
    )
    by_id = {device.id: device for device in jax.local_devices()}
    devices = [by_id[i] for i in ids]
    program = deserialize_and_load(code, arguments, results, execution_devices=devices)
    return _unflattened(program, jax.tree.structure(example))


def _write(path: Path, program: Compiled, result: PyTreeDef, kinds: list[tuple[Any, ...]]) -> None:
    code, _, _ = serialize(program)
    # Structures cannot be written, values that have them can.
    example = jax.tree.unflatten(result, range(result.num_leaves))
    devices = jax.tree.leaves(program.output_shardings)[0].device_set
    ids = sorted(device.id for device in devices)
    content: _Content = code, example, ids, kinds
    write_kept(path, pickle.dumps(content))


def _without_numbers(example: Any, kinds: list[tuple[Any, ...]]) -> Any:
    """Results on the first device, without their numbers."""
    place = SingleDeviceSharding(jax.local_devices()[0])
    leaves = [
        jax.ShapeDtypeStruct(shape, kind, sharding=place, weak_type=weak)
        for shape, kind, weak in kinds
    ]
    return jax.tree.unflatten(jax.tree.structure(example), leaves)


def _kind(x: Any) -> tuple[Hashable, ...]:
    """What a program depends on of an argument."""
    if isinstance(x, jax.Array | jax.ShapeDtypeStruct):
        return x.shape, x.dtype, x.weak_type, x.sharding
    return x.shape, x.dtype
