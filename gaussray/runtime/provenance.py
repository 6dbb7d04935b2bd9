"""What a run was: its command, the code and the packages it ran with, how long it took."""

import contextlib
import datetime
import importlib.metadata
import json
import platform
import shlex
import subprocess
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import jax

from gaussray.io.atomic import whole


FILE = "run.json"
PACKAGES = ("gaussray", "jax", "jaxlib", "equinox", "numpy", "OpenImageIO", "scikit-image")

_words: ContextVar[tuple[str, ...]] = ContextVar("words", default=())


@contextlib.contextmanager
def asked_by(words: Sequence[str]) -> Iterator[None]:
    """Within the block, runs were asked for by these words of a command line."""
    token = _words.set(tuple(words))
    try:
        yield
    finally:
        _words.reset(token)


def command() -> str:
    """The command line that asked; empty if none did."""
    return shlex.join(("gaussray", *_words.get())) if _words.get() else ""


def versions() -> dict[str, str]:
    """What the figures were made with."""
    found = {}
    for name in PACKAGES:
        # A checkout that is used without being installed has no metadata.
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found | {"device": jax.local_devices()[0].device_kind}


def commit() -> dict[str, Any]:
    """Of the checkout that the code is run from: its `git` hash, and whether it has been `changed`
    since. Nothing where the code is installed, whatever repository that lies in."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return {}
    told = []
    for words in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"]):
        try:
            done = subprocess.run(
                ["git", "-C", str(root), *words], capture_output=True, text=True, timeout=10
            )
        except (OSError, subprocess.TimeoutExpired):
            return {}
        if done.returncode:
            return {}
        told.append(done.stdout.strip())
    return {"git": told[0], "changed": bool(told[1])}


def note_begin(out: Path) -> None:
    """Write run.json of a run that begins."""
    began = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    told: dict[str, Any] = {"command": command()} if command() else {}
    told |= {"began": began, **commit(), "python": platform.python_version()}
    _write(out, told | {"versions": versions()})


def note_end(out: Path, seconds: float) -> None:
    """Add to run.json how long the run took."""
    _write(out, noted(out) | {"seconds": round(seconds, 1)})


def noted(out: Path) -> dict[str, Any]:
    """What is noted of the run of a folder; nothing if that cannot be read."""
    try:
        return json.loads((out / FILE).read_text())
    except (OSError, ValueError):
        return {}


def _write(out: Path, told: dict[str, Any]) -> None:
    with whole(out / FILE) as partial:
        partial.write_text(json.dumps(told, indent=2) + "\n")
