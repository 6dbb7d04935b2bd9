"""Reads the tensors of an untrusted .pth file without PyTorch and without executing its pickle.

Format (torch.save since 1.6): an uncompressed zip archive with `<name>/data.pkl`, the numbers of
storage i as `<name>/data/i`, and `<name>/byteorder` (little-endian if missing). The pickle
describes a dictionary of tensors: each has a storage, the offset of its first number, a shape and
strides. A pickle can call any function, so only these descriptions are read from it.
"""

import math
import pickletools
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within


# Data type of each storage class of PyTorch.
_KINDS = {
    **{"DoubleStorage": "f8", "FloatStorage": "f4", "HalfStorage": "f2"},
    **{"LongStorage": "i8", "IntStorage": "i4", "ShortStorage": "i2", "CharStorage": "i1"},
    **{"ByteStorage": "u1", "BoolStorage": "?"},
}
# Errors of zipfile for files that are no archive, entries outside the file, and names that are not
# text.
_BROKEN = (
    *(zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, OSError),
    UnicodeDecodeError,
)


class _Storage(NamedTuple):
    """The numbers of a storage: entry of the archive, data type and count."""

    key: str
    kind: str
    count: int


class _Tensor(NamedTuple):
    """A view of a storage: offset, shape and strides, in numbers."""

    storage: _Storage
    first: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


def read_tensors(path: Path | str) -> dict[str, np.ndarray]:
    """The tensors of a state dictionary by name, in the data types of the file.

    Memory is allocated only for data that the file holds.

    Raises:
        ValueError: the file has another format, holds anything but a dictionary of tensors, or is
            damaged; the message names the file.
        FileNotFoundError: the file does not exist.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Copy it from the trained model.")
    try:
        with opened(path) as file, zipfile.ZipFile(file) as archive:
            return _tensors(path, archive)
    except _BROKEN as error:
        raise ValueError(
            f"{path}: must be a file of torch.save (torch 1.6 or newer), whole and uncompressed, "
            f"got {str(error)[:200]}. Save it again."
        ) from error


def _tensors(path: Path, archive: zipfile.ZipFile) -> dict[str, np.ndarray]:
    entries = archive.infolist()
    within(path, "the arrays in GB", path.stat().st_size, "arrays", 1e9)
    packed = any(entry.compress_type != zipfile.ZIP_STORED for entry in entries)
    if packed or sum(entry.file_size for entry in entries) > path.stat().st_size:
        raise zipfile.BadZipFile("entries that are larger than the file")
    pickles = [e.filename for e in entries if e.filename.split("/")[1:] == ["data.pkl"]]
    if len(pickles) != 1:
        raise zipfile.BadZipFile(f"{len(pickles)} pickles")
    folder, names = pickles[0].split("/")[0], set(archive.namelist())
    order = ">" if _text(archive, f"{folder}/byteorder", names) == "big" else "<"
    tensors = {}
    described = _Reader(path).read(archive.read(pickles[0]))
    for name, tensor in described.items():
        entry = f"{folder}/data/{tensor.storage.key}"
        if entry not in names:
            raise ValueError(
                f"{path}: the numbers of '{name:.200}' are missing; the file is not whole."
            )
        tensors[name] = _numbers(path, name, tensor, order, archive.read(entry))
    return tensors


def _text(archive: zipfile.ZipFile, entry: str, names: set[str]) -> str:
    return archive.read(entry).decode("ascii", "replace").strip() if entry in names else ""


def _numbers(path: Path, name: str, tensor: _Tensor, order: str, data: bytes) -> np.ndarray:
    storage, first, shape, strides = tensor
    kind = np.dtype(order + storage.kind)
    count = min(storage.count, len(data) // kind.itemsize)
    whole = all(type(n) is int and n >= 0 for n in (first, *shape, *strides))
    if not whole or len(shape) != len(strides) or len(shape) > 32:
        raise ValueError(f"{path}: '{name:.200}' must have a shape and strides, got {tensor[1:]}.")
    size = math.prod(shape)
    last = first + sum((n - 1) * step for n, step in zip(shape, strides, strict=True))
    # A tensor of more numbers than its storage repeats some of them: a few bytes could fill memory.
    if size and (size > count or last >= count):
        raise ValueError(
            f"{path}: '{name:.200}' of shape {shape} must lie within its {count} numbers; the file "
            "is damaged. Copy it again."
        )
    steps = tuple(step * kind.itemsize for step in strides)
    begin = first * kind.itemsize if size else 0
    return np.ndarray(shape, kind, data, begin, steps).astype(kind.newbyteorder("="))


class _Reader:
    """An interpreter for the subset of pickle that dictionaries of tensors need.

    It calls no function and creates no object but descriptions of tensors; everything else is
    refused.
    """

    def __init__(self, path: Path):
        self.path = path
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}

    def read(self, data: bytes) -> dict[str, _Tensor]:
        """The dictionary that the pickle describes."""
        try:
            for code, argument, _ in pickletools.genops(data):
                if code.name not in _STEPS:
                    raise self._refusal(f"the step {code.name}")
                _STEPS[code.name](self, argument)
            result = self.stack.pop()
        except _Refused:
            raise
        # A malformed pickle can cause any error in the interpreter.
        except Exception as error:
            raise ValueError(f"{self.path}: the pickle is damaged ({str(error)[:200]}).") from error
        if not isinstance(result, dict):
            raise self._refusal(f"a {_kind(result)}")
        for name, value in result.items():
            if not isinstance(value, _Tensor):
                raise self._refusal(f"{name!r}, a {_kind(value)}")
        return result

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def marked(self) -> tuple[Any, ...]:
        """Take the values on the stack above the last mark."""
        begin = self.marks.pop()
        values = tuple(self.stack[begin:])
        del self.stack[begin:]
        return values

    def tuple_of(self, count: int) -> None:
        values = tuple(self.stack[len(self.stack) - count :])
        del self.stack[-count:]
        self.push(values)

    def name(self, module: Any, name: Any) -> None:
        """Push a global name; names that dictionaries of tensors do not use are refused."""
        if (module, name) not in _NAMES and not (module == "torch" and name in _KINDS):
            raise self._refusal(f"{module}.{name}")
        self.push(_Name(name))

    def global_name(self) -> None:
        name, module = self.stack.pop(), self.stack.pop()
        if not (isinstance(name, str) and isinstance(module, str)):
            raise TypeError("a name that is no text")
        self.name(module, name)

    def call(self) -> None:
        """Describe the result of one of three known functions, without calling it."""
        arguments, name = self.stack.pop(), self.stack.pop()
        if not isinstance(name, _Name) or not isinstance(arguments, tuple):
            raise TypeError("a call of something else")
        match name.word:
            case "OrderedDict" if arguments == ():
                self.push({})
            case "_rebuild_tensor_v2":
                self.push(_describe_tensor(*arguments))
            case "_rebuild_parameter" if arguments and isinstance(arguments[0], _Tensor):
                self.push(arguments[0])
            case _:
                raise TypeError(f"a call of {name.word}")

    def storage(self) -> None:
        reference = self.stack.pop()
        if not (isinstance(reference, tuple) and len(reference) == 5 and reference[0] == "storage"):
            raise self._refusal("another reference than to a storage")
        _, kind, key, _, count = reference
        is_storage = isinstance(kind, _Name) and kind.word in _KINDS and isinstance(key, str)
        if not (is_storage and type(count) is int):
            raise self._refusal("a reference to an unknown storage")
        self.push(_Storage(key, _KINDS[kind.word], count))

    def fill(self, pairs: tuple[Any, ...]) -> None:
        table = self.stack[-1]
        if not isinstance(table, dict) or len(pairs) % 2:
            raise TypeError("values for what is no dictionary")
        for name, value in zip(pairs[::2], pairs[1::2], strict=True):
            # Checked before it is hashed: hashing nested tuples can take forever.
            if not isinstance(name, str):
                raise self._refusal(f"a {_kind(name)} as a name")
            table[name] = value

    def annotate(self) -> None:
        """Discard the attributes of a dictionary (its version numbers)."""
        note = self.stack.pop()
        if not isinstance(self.stack[-1], dict) or not isinstance(note, dict):
            raise TypeError("a note for what is no dictionary")

    def _refusal(self, what: str) -> "_Refused":
        return _Refused(
            f"{self.path}: must hold a dictionary of tensors and nothing else, got {what:.200}, "
            "which is refused: it could run a program. Save the state_dict() of the model alone."
        )


class _Name(NamedTuple):
    """A global name in a pickle."""

    word: str


_NAMES = (
    ("collections", "OrderedDict"),
    ("torch._utils", "_rebuild_tensor_v2"),
    ("torch._utils", "_rebuild_parameter"),
)
# The action of each pickle opcode (see `pickletools`).
_STEPS: dict[str, Callable[[_Reader, Any], object]] = {
    **dict.fromkeys(("PROTO", "FRAME", "STOP"), lambda r, x: None),
    **dict.fromkeys(("BININT", "BININT1", "BININT2", "LONG1", "LONG4"), _Reader.push),
    **dict.fromkeys(("BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"), _Reader.push),
    "NONE": lambda r, x: r.push(None),
    "NEWTRUE": lambda r, x: r.push(True),
    "NEWFALSE": lambda r, x: r.push(False),
    "MARK": lambda r, x: r.marks.append(len(r.stack)),
    "TUPLE": lambda r, x: r.push(r.marked()),
    "EMPTY_TUPLE": lambda r, x: r.push(()),
    "TUPLE1": lambda r, x: r.tuple_of(1),
    "TUPLE2": lambda r, x: r.tuple_of(2),
    "TUPLE3": lambda r, x: r.tuple_of(3),
    "EMPTY_DICT": lambda r, x: r.push({}),
    "SETITEMS": lambda r, x: r.fill(r.marked()),
    "SETITEM": lambda r, x: (r.tuple_of(2), r.fill(r.stack.pop())),
    **dict.fromkeys(("BINPUT", "LONG_BINPUT"), lambda r, x: r.memo.update({x: r.stack[-1]})),
    **dict.fromkeys(("BINGET", "LONG_BINGET"), lambda r, x: r.push(r.memo[x])),
    "MEMOIZE": lambda r, x: r.memo.update({len(r.memo): r.stack[-1]}),
    "GLOBAL": lambda r, x: r.name(*x.split(" ", 1)),
    "STACK_GLOBAL": lambda r, x: r.global_name(),
    "BINPERSID": lambda r, x: r.storage(),
    "REDUCE": lambda r, x: r.call(),
    "BUILD": lambda r, x: r.annotate(),
}


def _kind(value: Any) -> str:
    return value.word if isinstance(value, _Name) else type(value).__name__


class _Refused(ValueError):
    """The pickle holds something else than a dictionary of tensors."""


def _describe_tensor(storage: Any, first: Any, shape: Any, strides: Any, *_: Any) -> _Tensor:
    numbers = (*shape, *strides, first) if type(shape) is type(strides) is tuple else (None,)
    if not isinstance(storage, _Storage) or any(type(n) is not int for n in numbers):
        raise TypeError("a tensor without storage, shape or strides")
    return _Tensor(storage, first, shape, strides)
