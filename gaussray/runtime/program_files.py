"""Files of compiled programs and of other code that a process keeps for later ones: where they lie,
and their names, which follow from what they are made for."""

import contextlib
import functools
import hashlib
import os
from collections.abc import Callable, Hashable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax.extend.backend import get_backend

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


def files_are_kept() -> bool:
    """Whether `keep_machine_code` has named a folder."""
    return bool(_folders)


def kept_text(key: tuple[Hashable, ...], make: Callable[[], str]) -> str:
    """A text that is made once and read from disk after that, where programs are kept.

    Args:
        key: everything that the text depends on beside the package's source.
        make: returns the text; called where it is not on disk.
    """
    path = kept_file(full_text(key))
    if path is None:
        return make()
    with contextlib.suppress(OSError, ValueError):
        # It may be code, too.
        if is_own(path):
            return path.read_text(encoding="utf-8")
    text = make()
    with contextlib.suppress(OSError):
        write_kept(path, text.encode())
    return text


def kept_file(key: str) -> Path | None:
    """The file of what has this key; None where none are kept, and if the text of a function or an
    object in the key does not say what it is."""
    if not _folders or " at 0x" in key:
        return None
    folder, processor = _folders[0]
    name = hashlib.sha256(f"{_version()} {processor} {key}".encode()).hexdigest()
    return folder / f"{name[:40]}{_SUFFIX}"


def write_kept(path: Path, content: bytes) -> None:
    """Write a file that no other user may read; the oldest are removed if there are too many.

    Args:
        path: the file (`kept_file`).
        content: what it holds.
    """
    with atomic_path(path) as partial:
        partial.write_bytes(content)
        partial.chmod(0o600)
    files = sorted(path.parent.glob(f"*{_SUFFIX}"), key=lambda file: file.stat().st_mtime)
    for file in files[:-MOST_FILES]:
        file.unlink(missing_ok=True)


def is_own(path: Path) -> bool:
    """Whether a file is this user's, and nobody else may write to it: it is code that will run."""
    if not hasattr(os, "getuid"):
        return True
    about = path.stat()
    return about.st_uid == os.getuid() and not about.st_mode & 0o022


def full_text(value: Any) -> str:
    """What a value says of itself, all of it."""
    if isinstance(value, tuple):
        return f"({', '.join(map(full_text, value))})"
    if isinstance(value, eqx.Module):
        # Its own text is for people, and shorter.
        leaves, structure = jax.tree.flatten(value)
        return f"{structure} {full_text(tuple(leaves))}"
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
    # A GPU's compiler and driver have versions of their own.
    platform = get_backend().platform_version
    flags = os.environ.get("XLA_FLAGS", "")
    return f"{digest.hexdigest()} {versions} {platform} {settings} {devices} {flags}"
