"""A reader of files, and how whole ones are made."""

import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np


Files = dict[str, bytes]


class Reader(NamedTuple):
    """Whole files; what reads them in a folder; which of them are damaged, by their kind; words by
    which a refusal says what is wrong where no file is."""

    samples: Callable[[], list[Files]]
    read: Callable[[Path], object]
    kinds: dict[str, str]
    said: tuple[str, ...] = ()


def text(content: object) -> bytes:
    """JSON."""
    return json.dumps(content).encode()


def saved(array: np.ndarray) -> bytes:
    """An .npy file."""
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def written(name: str, write: Callable[[Path], object]) -> bytes:
    """What is written under a name, whose suffix says how."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()
