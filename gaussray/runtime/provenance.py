"""Records how a run was made: command, git commit, package versions, duration."""

import contextlib
import datetime
import functools
import hashlib
import importlib.metadata
import json
import platform
import shlex
import subprocess
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from gaussray.io.atomic import write_json


# The record of a run, in its output folder.
RUN_RECORD = "run.json"
PACKAGES = ("gaussray", "jax", "jaxlib", "equinox", "numpy", "OpenImageIO", "scikit-image")

_arguments: ContextVar[tuple[str, ...]] = ContextVar("arguments", default=())


class Commit(NamedTuple):
    """A git commit: its full hash, and whether tracked files have `changed` since."""

    hash: str
    changed: bool


@contextlib.contextmanager
def command_arguments(arguments: Sequence[str]) -> Iterator[None]:
    """Within the block, `command` returns the command line with these arguments."""
    token = _arguments.set(tuple(arguments))
    try:
        yield
    finally:
        _arguments.reset(token)


def command() -> str:
    """The command line that started the run; empty if it was started from Python."""
    return shlex.join(("gaussray", *_arguments.get())) if _arguments.get() else ""


def given_keys() -> tuple[str, ...]:
    """The keys that the command line sets (`fit.degree=0`), by their full names."""
    return tuple(word.lstrip("+").partition("=")[0] for word in _arguments.get() if "=" in word)


def versions() -> dict[str, str]:
    """Versions of the packages that results depend on, and the kind of device."""
    installed = {}
    for name in PACKAGES:
        # A checkout that is used without being installed has no metadata.
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            installed[name] = importlib.metadata.version(name)
    return installed | {"device": jax.local_devices()[0].device_kind}


@functools.cache
def git_commit() -> Commit | None:
    """The commit of the checkout that the code runs from; None for an installed package, even if it
    is installed inside some other repository."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    outputs = []
    for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"]):
        try:
            process = subprocess.run(
                ["git", "-C", str(root), *arguments], capture_output=True, text=True, timeout=10
            )
        except (OSError, subprocess.TimeoutExpired):
            return None
        if process.returncode:
            return None
        outputs.append(process.stdout.strip())
    return Commit(outputs[0], bool(outputs[1]))


def array_digest(tree: Any) -> Any:
    """The SHA-256 of the bytes of all arrays of a pytree, in its order: an object of hashlib."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves(jax.device_get(tree)):
        digest.update(np.asarray(leaf).tobytes())
    return digest


def record_start(out: Path) -> None:
    """Write run.json at the start of a run: command, start time, git commit, versions."""
    began = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    record: dict[str, Any] = {"command": command()} if command() else {}
    record["began"] = began
    commit = git_commit()
    if commit:
        record |= {"git": commit.hash, "changed": commit.changed}
    write_json(
        out / RUN_RECORD, record | {"python": platform.python_version(), "versions": versions()}
    )


def record_duration(out: Path, seconds: float) -> None:
    """Add the duration of a run to its run.json.

    Args:
        out: output folder of the run.
        seconds: the duration.
    """
    write_json(out / RUN_RECORD, run_record(out) | {"seconds": round(seconds, 1)})


def run_record(out: Path) -> dict[str, Any]:
    """The content of run.json; empty if the file is missing or not JSON."""
    try:
        return json.loads((out / RUN_RECORD).read_text())
    except (OSError, ValueError):
        return {}
