"""Compiled programs on disk that later processes call without tracing them.

JAX's own cache saves the compilation, but a program must be traced and lowered to be found in it,
which takes longer than to run it. Here the name of a file follows from what a program is made for.
"""

import contextlib
import functools
import threading
import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import equinox as eqx
import jax
from jax.core import Tracer
from jax.stages import Lowered
from jax.tree_util import PyTreeDef

from gaussray.runtime.program_content import (
    ProgramContent,
    loaded_program,
    read_content,
    unflattened,
    without_numbers,
    write_program,
)
from gaussray.runtime.program_files import files_are_kept, full_text, is_own, kept_file
from gaussray.runtime.recent_programs import read_before, remember


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
        needs: called before the program is read: it makes known to XLA what the program calls;
            None: it calls nothing.
        kernels: whether the function may call kernels, which XLA cannot write to disk: a GPU's
            program is then compiled in each process.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        key: tuple[Hashable, ...],
        compiler: dict[str, bool] | None = None,
        needs: Callable[[], Any] | None = None,
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
        if self._needs is None:
            remember(path)
        with contextlib.suppress(Exception):
            # A file that is damaged or cannot be run here is no error: the program is compiled.
            program = None
            if signature in self._begun:
                program = self._begun[signature][0].result()
            elif path.is_file() and is_own(path):
                program = read_before(path) or self._loaded(read_content(path))
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
                content = read_content(path)
                future = _threads().submit(self._loaded, content)
                return future, without_numbers(content.example, content.kinds)
        lowered = self._lowered(leaves, structure, path)
        example = jax.tree.unflatten(lowered.result, range(lowered.result.num_leaves))
        return (
            _threads().submit(lowered.compiled, path),
            without_numbers(example, lowered.kinds),
        )

    def _loaded(self, content: ProgramContent) -> Callable[..., Any]:
        """The program of a file."""
        if self._needs is not None:
            self._needs()
        return loaded_program(content)

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
        return _LoweredProgram(traced.lower(), flat.__name__, results[-1], kinds, len(leaves))


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
    """A program to be compiled, its name, the structure of its results, shape, type and weakness of
    each, and the number of its arguments' leaves."""

    program: Lowered
    name: str
    result: PyTreeDef
    kinds: list[tuple[Any, ...]]
    leaves: int

    def compiled(self, path: Path) -> Callable[..., Any]:
        """The compiled program, which is written to a file."""
        program = self.program.compile()
        for useless in path.parent.glob(f"*{self.name}*"):
            useless.unlink(missing_ok=True)
        with contextlib.suppress(Exception):
            path.unlink(missing_ok=True)
            write_program(path, program, self.result, self.kinds, self.leaves)
        return unflattened(program, self.result)


def _kind(x: Any) -> tuple[Hashable, ...]:
    """What a program depends on of an argument."""
    if isinstance(x, jax.Array | jax.ShapeDtypeStruct):
        return x.shape, x.dtype, x.weak_type, x.sharding
    return x.shape, x.dtype
