"""Tensors of a .pth file of PyTorch, read without PyTorch and without running what it holds.

Layout (torch.save since 1.6): an uncompressed zip archive with `<name>/data.pkl`, the numbers of
storage i as `<name>/data/i`, and `<name>/byteorder` (little if there is none). The pickle describes
a dictionary of tensors: each names its storage, the place of its first number there, its shape and
its strides. Any pickle could also call any function, which is why nothing is unpickled here but
those descriptions.
"""

import math
import pickle
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


# Kinds of numbers by the name of torch's storage.
_KINDS = {
    **{"DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2"},
    **{"LongStorage": "i8", "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1"},
    **{"ByteStorage": "u1", "BoolStorage": "?"},
}


class _Storage(NamedTuple):
    """Where numbers lie in the archive."""

    key: str
    kind: str
    count: int


class _Tensor(NamedTuple):
    """Which numbers of a storage a tensor shows, in whose order."""

    storage: _Storage
    first: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def read_tensors(path: Path | str) -> dict[str, np.ndarray]:
    """The tensors of a state dictionary by name, with the file's own kinds of numbers.

    Only dictionaries of tensors are understood: every other name in the pickle is refused before
    anything is done with it. ValueError names the file and what is wrong: another format, a name
    that is refused, tensors beyond their storage, data that are missing or damaged. Memory is taken
    only for what the file really holds.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Copy it from the trained model.")
    try:
        with zipfile.ZipFile(path) as archive:
            return _tensors(path, archive)
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(
            f"{path}: must be a file of torch.save (torch 1.6 or newer), whole and uncompressed, "
            f"got {error}. Save it again."
        ) from error


def _tensors(path: Path, archive: zipfile.ZipFile) -> dict[str, np.ndarray]:
    entries = archive.infolist()
    packed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
    if packed or sum(entry.file_size for entry in entries) > path.stat().st_size:
        raise zipfile.BadZipFile("entries that are larger than the file")
    pickles = [e.filename for e in entries if e.filename.split("/")[1:] == ["data.pkl"]]
    if len(pickles) != 1:
        raise zipfile.BadZipFile(f"{len(pickles)} pickles")
    folder, held = pickles[0].split("/")[0], set(archive.namelist())
    order = ">" if _text(archive, f"{folder}/byteorder", held) == "big" else "<"
    tensors = {}
    with archive.open(pickles[0]) as file:
        described = _Descriptions(path, file).load_all()
    for name, tensor in described.items():
        entry = f"{folder}/data/{tensor.storage.key}"
        if entry not in held:
            raise ValueError(f"{path}: the numbers of '{name}' are missing; the file is not whole.")
        tensors[name] = _numbers(path, name, tensor, order, archive.read(entry))
    return tensors


def _text(archive: zipfile.ZipFile, entry: str, held: set[str]) -> str:
    return archive.read(entry).decode("ascii", "replace").strip() if entry in held else ""


def _numbers(path: Path, name: str, tensor: _Tensor, order: str, data: bytes) -> np.ndarray:
    storage, first, shape, strides = tensor
    kind = np.dtype(order + storage.kind)
    count = min(storage.count, len(data) // kind.itemsize)
    whole = all(type(n) is int and n >= 0 for n in (first, *shape, *strides))
    if not whole or len(shape) != len(strides) or len(shape) > 32:
        raise ValueError(f"{path}: '{name}' must have a shape and strides, got {tensor[1:]}.")
    size = math.prod(shape)
    last = first + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
    # A tensor of more numbers than its storage repeats some of them: a few bytes could fill memory.
    if size and (size > count or last >= count):
        raise ValueError(
            f"{path}: '{name}' of shape {shape} must lie within its {count} numbers; the file is "
            "damaged. Copy it again."
        )
    steps = tuple(step * kind.itemsize for step in strides)
    begin = first * kind.itemsize if size else 0
    return np.ndarray(shape, kind, data, begin, steps).astype(kind.newbyteorder("="))


class _Descriptions(pickle.Unpickler):
    """The tensors of a pickle as descriptions: tuples and texts, on which no pickle can build."""

    def __init__(self, path: Path, file: Any):
        super().__init__(file)
        self.path = path

    def load_all(self) -> dict[str, _Tensor]:
        try:
            found = self.load()
        except _Refused:
            raise
        # Whatever a malformed pickle makes of the machine that reads it.
        except Exception as error:
            raise ValueError(f"{self.path}: the pickle is damaged ({error}).") from error
        if not isinstance(found, dict):
            raise self._refused(f"a {type(found).__name__}")
        table = dict(dict.items(found))
        for name, value in table.items():
            if not isinstance(name, str):
                raise self._refused(f"a {type(name).__name__} as a name")
            if not isinstance(value, _Tensor):
                raise self._refused(f"{name!r}, a {type(value).__name__}")
        return table

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        # A pickle may change what it names: functions are made anew, so that none outlives it.
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return lambda *told: _described(*told)
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return lambda tensor, *_: tensor
        if module == "torch" and name in _KINDS:
            return _KINDS[name]
        raise self._refused(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> _Storage:
        word, kind, key, _, count = pid
        known = word == "storage" and kind in _KINDS.values() and isinstance(key, str)
        if not (known and type(count) is int):
            raise self._refused(f"{pid!r}")
        return _Storage(key, kind, count)

    def _refused(self, what: str) -> "_Refused":
        return _Refused(
            f"{self.path}: must hold a dictionary of tensors and nothing else, got {what}, which "
            "is refused: it could run a program. Save the state_dict() of the model alone."
        )


class _Refused(ValueError):
    """Something that a dictionary of tensors does not hold."""


def _described(storage: Any, first: Any, shape: Any, strides: Any, *_: Any) -> _Tensor:
    if not isinstance(storage, _Storage):
        raise TypeError("a tensor without storage")
    return _Tensor(storage, first, tuple(shape), tuple(strides))
