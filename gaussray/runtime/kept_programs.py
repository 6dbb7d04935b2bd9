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
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax.experimental.serialize_executable import deserialize_and_load, serialize
from jax.stages import Compiled
from jax.tree_util import PyTreeDef

from gaussray.io.atomic import whole


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
        folder: The folder. Who writes to it can run code in this process.
        processor: The kind of processor, whose programs another kind does not load.
    """
    _folders[:] = [(folder, processor)]


class KeptProgram:
    """A compiled function whose machine code is on disk, where `keep_machine_code` says so.

    A file holds the code for arguments of one structure, shapes, types and devices. Its name
    follows from these, the key, this package's source, and the versions and settings of JAX.

    Args:
        function: A pure function of arrays in any structure.
        key: Everything that the function depends on beside its arguments and the package's source.
        compiler: Options of the compiler.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        key: tuple[Hashable, ...],
        compiler: dict[str, bool] | None = None,
    ):
        self._function, self._compiler = function, compiler
        self._jitted: Any = jax.jit(function, compiler_options=compiler)
        self._key = _text((getattr(function, "__qualname__", ""), key, compiler))
        self._known: dict[Hashable, Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        if not _folders:
            return self._jitted(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        signature = structure, tuple(map(_kind, leaves))
        program = self._known.get(signature)
        return program(*leaves) if program else self._first(leaves, signature)

    def clear_cache(self) -> None:
        """Release the compiled code."""
        self._jitted.clear_cache()
        self._known.clear()

    def _first(self, leaves: list[Any], signature: tuple[Any, ...]) -> Any:
        """The results of the first call: of a program from disk, or compiled and written there."""
        path = _file(self._key + _text(signature))
        if path is None:
            return self._jitted(*jax.tree.unflatten(signature[0], leaves))
        if path.is_file() and _own(path):
            # A file that is damaged or cannot be run here is no error: the program is compiled.
            with contextlib.suppress(Exception):
                program = _read(path, len(leaves))
                results = jax.block_until_ready(program(*leaves))
                self._known[signature] = program
                return results
        compiled, result = self._compiled(leaves, signature[0], path)
        with contextlib.suppress(Exception):
            path.unlink(missing_ok=True)
            _write(path, compiled, result)
        self._known[signature] = program = _unflattened(compiled, result)
        return program(*leaves)

    def _compiled(
        self, leaves: list[Any], structure: PyTreeDef, path: Path
    ) -> tuple[Compiled, PyTreeDef]:
        """A program of the leaves of the arguments, whose results are leaves of this structure."""
        results: list[PyTreeDef] = []

        def flat(*leaves: Any) -> list[Any]:
            made, result = jax.tree.flatten(self._function(*jax.tree.unflatten(structure, leaves)))
            results.append(result)
            return made

        # With a name of its own it is not found in JAX's cache: a program that has been read from
        # there lacks some of its code when it is written again.
        flat.__name__ = f"{path.stem}_{time.time_ns()}"
        compiled = jax.jit(flat, compiler_options=self._compiler).lower(*leaves).compile()
        for useless in path.parent.glob(f"*{flat.__name__}*"):
            useless.unlink(missing_ok=True)
        return compiled, results[-1]


def _own(path: Path) -> bool:
    """Whether a file is this user's, and nobody else may write to it: it is code that will run."""
    if not hasattr(os, "getuid"):
        return True
    about = path.stat()
    return about.st_uid == os.getuid() and not about.st_mode & 0o022


def _unflattened(program: Compiled, result: PyTreeDef) -> Callable[..., Any]:
    return lambda *leaves: jax.tree.unflatten(result, program(*leaves))


def _read(path: Path, leaves: int) -> Callable[..., Any]:
    """The program in a file, a function of so many leaves."""
    code, example, ids = pickle.loads(path.read_bytes())
    made, result = jax.tree.flatten(example)
    arguments = jax.tree.structure(((0,) * leaves, {}))
    by_id = {device.id: device for device in jax.local_devices()}
    program = deserialize_and_load(
        code,
        arguments,
        jax.tree.structure([0] * len(made)),
        execution_devices=[by_id[i] for i in ids],
    )
    return _unflattened(program, result)


def _write(path: Path, program: Compiled, result: PyTreeDef) -> None:
    code, _, _ = serialize(program)
    # Structures cannot be written, values that have them can.
    example = jax.tree.unflatten(result, range(result.num_leaves))
    devices = jax.tree.leaves(program.output_shardings)[0].device_set
    ids = sorted(device.id for device in devices)
    _keep(path, pickle.dumps((code, example, ids)))


def kept_text(key: tuple[Hashable, ...], make: Callable[[], str]) -> str:
    """The text that `make` returns, which follows from the key and the package's source alone; it
    is read from disk where it has been made before."""
    path = _file(_text(key)) if _folders else None
    if path is None:
        return make()
    with contextlib.suppress(OSError, ValueError):
        return path.read_text(encoding="utf-8")
    text = make()
    with contextlib.suppress(OSError):
        _keep(path, text.encode())
    return text


def _file(key: str) -> Path | None:
    """The file of what has this key; None if the text of a function or an object in it does not say
    what it is, and on a GPU, whose programs call kernels that this process must load itself."""
    if " at 0x" in key or jax.default_backend() != "cpu":
        return None
    folder, processor = _folders[0]
    name = hashlib.sha256(f"{_version()} {processor} {key}".encode()).hexdigest()
    return folder / f"{name[:40]}{_SUFFIX}"


def _keep(path: Path, content: bytes) -> None:
    """Write a file; the oldest ones are removed if there are too many."""
    with whole(path) as partial:
        partial.write_bytes(content)
        partial.chmod(0o600)
    files = sorted(path.parent.glob(f"*{_SUFFIX}"), key=lambda file: file.stat().st_mtime)
    for file in files[:-MOST_FILES]:
        file.unlink(missing_ok=True)


def _kind(x: Any) -> tuple[Hashable, ...]:
    """What a program depends on of an argument."""
    if isinstance(x, jax.Array):
        return x.shape, x.dtype, x.weak_type, x.sharding, x.committed
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
