"""The output folder of a command, with the records of how its files were made."""

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from yaml import YAMLError

from gaussray.config.compose import Configuration
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.files import read_text
from gaussray.runtime.devices import is_primary
from gaussray.runtime.lock import lock_output
from gaussray.runtime.provenance import record_start


# Keys that say how a command is run, not what it makes.
_UNCOUNTED = ("resume", "quiet", "progress", "report", "out", "tensorboard")


def changed_keys(cfg: Configuration, most: int = 5) -> list[str]:
    """Keys whose values differ from those that are recorded in the folder of a run, at most so
    many; none if nothing can be read there.

    Args:
        cfg: a resolved configuration; its `out` is the folder.
        most: how many keys are named.
    """
    try:
        before = OmegaConf.to_container(
            OmegaConf.create(read_text(Path(cfg.out) / "config.yaml").decode())
        )
    except (OSError, ValueError, YAMLError):
        return []
    now = OmegaConf.to_container(cfg)
    return [key for key in _different(before, now) if key not in _UNCOUNTED][:most]


def _different(before: Any, now: Any, key: str = "") -> list[str]:
    if isinstance(before, dict) and isinstance(now, dict):
        names = [name for name in now if name in before]
        prefix = f"{key}." if key else ""
        return sum((_different(before[n], now[n], f"{prefix}{n}") for n in names), [])
    return [] if before == now else [key]


def begin_run_folder(cfg: Configuration, without: Sequence[str] = (), part: str = "") -> Path:
    """Make the output folder, lock it until the command ends, and record the configuration in it.

    The folder gets config.yaml, the resolved configuration. With several hosts, host 0 writes.

    Args:
        cfg: a resolved configuration; its `out` is the folder.
        without: keys left out of config.yaml, because they differ between processes that share the
            folder. If none is, the folder also gets run.json, with the command and the time.
        part: what this process does of the work on a folder that several share, such as `0/4`; each
            part has a lock of its own (`runtime.lock`). Empty: all of it.

    Raises:
        OSError: the folder cannot be written, or another process is writing into it.
    """
    out, recorded = Path(cfg.out), copy.deepcopy(cfg)
    lock_output(out, part)
    OmegaConf.set_struct(recorded, False)
    for key in without:
        parent, _, name = key.rpartition(".")
        (OmegaConf.select(recorded, parent) if parent else recorded).pop(name)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if is_primary():
            with atomic_path(out / "config.yaml") as partial:
                partial.write_text(OmegaConf.to_yaml(recorded))
            # Processes that share a folder write equal files; the time and the command differ.
            if not without:
                record_start(out)
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error.strerror or error}") from error
    return out
