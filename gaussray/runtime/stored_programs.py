"""Compiled programs on disk that later processes call without tracing them.

JAX's own cache saves the compilation, but a program must be traced and lowered to be found in it,
which takes longer than to run it. Here the name of a file follows from what a program is made for.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import time
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jax.sharding import SingleDeviceSharding
from jax.stages import Compiled, Lowered
from jax.tree_util import PyTreeDef

from gaussray.io.atomic import atomic_path


# Files beyond so many are removed, those written first of all.
MOST_FILES = 600
_SUFFIX = ".program"
# Settings of JAX that change what is compiled.
_SETTINGS = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_disable_most_optimizations",
    "jax_debug_nans",
    "jax_default_prng_impl",
)
_folders: list[tuple[Path, str]] = []


def keep_machine_code(folder: Path, processor: str) -> None:
    """Keep programs in a folder from now on.

    Args:
        folder: the folder. Who writes to it can run code in this process.
        processor: the kind of processor, whose programs another kind does not load.
    """
    _folders[:] = [(folder, processor)]


class KeptProgram:
    """A compiled function whose machine code is on disk, where `keep_machine_code` says so.

    A file holds the code for arguments of one structure, shapes, types and devices. Its name
    follows from these, the key, this package's source, and the versions and settings of JAX.

    Args:
        function: a pure function of arrays in any structure.
        key: everything that the function depends on beside its arguments and the package's source.
        compiler: options of the compiler.
        needs: called before the program is read: it makes known to XLA what the program calls.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        key: tuple[Hashable, ...],
        compiler: dict[str, bool] | None = None,
        needs: Callable[[], Any] = lambda: None,
    ):
        self._function, self._compiler, self._needs = function, compiler, needs
        self._jitted: Any = jax.jit(function, compiler_options=compiler)
        self._key = _text((getattr(function, "__qualname__", ""), key, compiler))
        self._known: dict[Hashable, Callable[..., Any]] = {}
        self._begun: dict[Hashable, tuple[Future[Callable[..., Any]], Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        if not _folders:
            return self._jitted(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        signature = structure, tuple(map(_kind, leaves))
        program = self._known.get(signature)
        return program(*leaves) if program else self._first(leaves, signature)

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
            path = _program_file(self._key + _text(signature)) if _folders else None
            if path is None:
                return None
            self._begun[signature] = self._beginning(leaves, structure, path)
        return self._begun[signature][1]

    def clear_cache(self) -> None:
        """Release the compiled code."""
        self._jitted.clear_cache()
        self._known.clear()
        self._begun.clear()

    def _first(self, leaves: list[Any], signature: tuple[Any, ...]) -> Any:
        """The results of the first call: of a program from disk, or compiled and written there."""
        path = _program_file(self._key + _text(signature))
        if path is None:
            return self._jitted(*jax.tree.unflatten(signature[0], leaves))
        with contextlib.suppress(Exception):
            # A file that is damaged or cannot be run here is no error: the program is compiled.
            program = None
            if signature in self._begun:
                program = self._begun[signature][0].result()
            elif path.is_file() and _own(path):
                self._needs()
                program = _loaded(len(leaves), *_read(path))
            if program is not None:
                results = jax.block_until_ready(program(*leaves))
                self._known[signature] = program
                return results
        lowered = self._lowered(leaves, signature[0], path)
        self._known[signature] = program = lowered.compiled(path)
        return program(*leaves)

    def _beginning(
        self, leaves: list[Any], structure: PyTreeDef, path: Path
    ) -> tuple[Future[Callable[..., Any]], Any]:
        """A program that a thread reads or compiles, and its results without their numbers."""
        if path.is_file() and _own(path):
            with contextlib.suppress(Exception):
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


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Threads that read and compile: XLA uses as many cores as there are anyway."""
    return ThreadPoolExecutor(4, "program")


def _own(path: Path) -> bool:
    """Whether a file is this user's, and nobody else may write to it: it is code that will run."""
    if not hasattr(os, "getuid"):
        return True
    about = path.stat()
    return about.st_uid == os.getuid() and not about.st_mode & 0o022


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
    _keep(path, pickle.dumps(content))


def _without_numbers(example: Any, kinds: list[tuple[Any, ...]]) -> Any:
    """Results on the first device, without their numbers."""
    place = SingleDeviceSharding(jax.local_devices()[0])
    leaves = [
        jax.ShapeDtypeStruct(shape, kind, sharding=place, weak_type=weak)
        for shape, kind, weak in kinds
    ]
    return jax.tree.unflatten(jax.tree.structure(example), leaves)


def kept_text(key: tuple[Hashable, ...], make: Callable[[], str]) -> str:
    """A text that is made once and read from disk after that, where programs are kept.

    Args:
        key: everything that the text depends on beside the package's source.
        make: returns the text; called where it is not on disk.
    """
    path = _file(_text(key)) if _folders else None
    if path is None:
        return make()
    with contextlib.suppress(OSError, ValueError):
        # It may be code, too.
        if _own(path):
            return path.read_text(encoding="utf-8")
    text = make()
    with contextlib.suppress(OSError):
        _keep(path, text.encode())
    return text


def _program_file(key: str) -> Path | None:
    """The file of a program; None on a GPU, whose programs call kernels that this process must load
    itself."""
    return _file(key) if jax.default_backend() == "cpu" else None


def _file(key: str) -> Path | None:
    """The file of what has this key; None if the text of a function or an object in it does not say
    what it is."""
    if " at 0x" in key:
        return None
    folder, processor = _folders[0]
    name = hashlib.sha256(f"{_version()} {processor} {key}".encode()).hexdigest()
    return folder / f"{name[:40]}{_SUFFIX}"


def _keep(path: Path, content: bytes) -> None:
    """Write a file; the oldest ones are removed if there are too many."""
    with atomic_path(path) as partial:
        partial.write_bytes(content)
        partial.chmod(0o600)
    files = sorted(path.parent.glob(f"*{_SUFFIX}"), key=lambda file: file.stat().st_mtime)
    for file in files[:-MOST_FILES]:
        file.unlink(missing_ok=True)


def _kind(x: Any) -> tuple[Hashable, ...]:
    """What a program depends on of an argument."""
    if isinstance(x, jax.Array | jax.ShapeDtypeStruct):
        return x.shape, x.dtype, x.weak_type, x.sharding
    return x.shape, x.dtype


def _text(value: Any) -> str:
    """What a value says of itself, all of it."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, eqx.Module):
        # Its own text is for people, and shorter.
        leaves, structure = jax.tree.flatten(value)
        return f"{structure} {_text(tuple(leaves))}"
    return repr(value)


@functools.cache
def _version() -> str:
    """A hash of this package's source, with the versions and settings of JAX."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        digest.update(f"{file.relative_to(root)} {len(file.read_bytes())} ".encode())
        digest.update(file.read_bytes())
    versions = [version(name) for name in ("jax", "jaxlib", "equinox")]
    settings = [str(jax.config.values.get(name)) for name in _SETTINGS]
    devices = [f"{device.device_kind} {device.id}" for device in jax.devices()]
    flags = os.environ.get("XLA_FLAGS", "")
    return f"{digest.hexdigest()} {versions} {settings} {devices} {flags}"
