"""The keys of a capture's JSON, each fetched with its rule and its place in the message."""

import dataclasses
import math
import numbers
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.io.safe.files import inside


_ABSENT = object()
# What can be counted: fits into 32 bits.
_MOST = 2**31


@dataclasses.dataclass(frozen=True)
class Keys:
    """Values under one heading of a file: the top level, one frame, or a block of either.

    `kind` is what messages call it if it has a number: a frame, a camera. `null` counts as absent,
    so that a frame can switch off a block of the top level.
    """

    file: Path
    values: Mapping[str, Any]
    frame: int | None = None
    prefix: str = ""
    kind: str = "frame"

    @property
    def where(self) -> str:
        return f"{self.file}" + ("" if self.frame is None else f", {self.kind} {self.frame}")

    def name_of(self, key: str) -> str:
        """What messages call a value: its file, its frame and its key."""
        return f"{self.where}: {self.prefix}{key}"

    def error(self, key: str, rule: str, remedy: str = "") -> CaptureError:
        """The error of a key that breaks its rule, with file, frame, the value and the remedy.

        Args:
            key: the key; its value is shown, cut to 200 letters.
            rule: what the value must be, to stand after "must be".
            remedy: a sentence that says what to do; empty if the rule says enough.
        """
        value = repr(self.values[key]) if key in self.values else "nothing"
        value = value if len(value) <= 200 else value[:200] + "..."
        return CaptureError(f"{self.name_of(key)} must be {rule}, got {value}. {remedy}".rstrip())

    def warn(self, message: str) -> None:
        warnings.warn(f"{self.where}: {message}", CaptureWarning, stacklevel=3)

    def has(self, key: str) -> bool:
        return self.values.get(key) is not None

    def _get(self, key, default, rule, remedy=""):
        value = self.values.get(key)
        if value is not None:
            return value
        if default is _ABSENT:
            raise self.error(
                key, rule, remedy or "It is required: add it here or at the top level."
            )
        return default

    def number(self, key: str, default: Any = _ABSENT, remedy: str = "") -> float:
        """A finite number.

        Args:
            key: name of the key, under this heading.
            default: value if the key is absent; without one, the key is required.
            remedy: what to do about a wrong or absent value, for the message.

        Raises:
            CaptureError: the key is absent without a default, or its value is no finite number.
        """
        value = self._get(key, default, "a number", remedy)
        if not _is_finite(value):
            raise self.error(key, "a finite number", remedy)
        return float(value)

    def count(self, key: str, default: Any = _ABSENT, least: int = 1) -> int:
        """A whole number.

        Args:
            key: name of the key, under this heading.
            default: value if the key is absent; without one, the key is required.
            least: the smallest number allowed; the largest is 2^31 - 1.

        Raises:
            CaptureError: the key is absent without a default, or its value is no such number.
        """
        rule = f"a whole number of at least {least}"
        value = self._get(key, default, rule)
        if not _is_number(value) or value != value // 1 or not least <= value < _MOST:
            raise self.error(key, rule)
        return int(value)

    def text(self, key: str, default: Any = _ABSENT, remedy: str = "") -> str:
        value = self._get(key, default, "a text", remedy)
        if not isinstance(value, str) or not value:
            raise self.error(key, "a text that is not empty", remedy)
        return value

    def choice(self, key: str, choices: Sequence[str], default: Any = _ABSENT) -> str:
        rule = f"one of {', '.join(choices)}"
        value = self._get(key, default, rule)
        if value not in choices:
            raise self.error(key, rule)
        return value

    def vector(self, key: str, length: int, default: Any = _ABSENT) -> list[float]:
        """A list of finite numbers.

        Args:
            key: name of the key, under this heading.
            length: how many numbers the list must have.
            default: value if the key is absent; without one, the key is required.

        Raises:
            CaptureError: the key is absent without a default, or its value is no such list.
        """
        rule = f"a list of {length} finite numbers"
        value = self._get(key, default, rule)
        good = isinstance(value, list) and len(value) == length
        if not good or not all(map(_is_finite, value)):
            raise self.error(key, rule)
        return [float(v) for v in value]

    def numbers(self, key: str) -> list[float]:
        """A list of at least one finite number."""
        value = self._get(key, _ABSENT, "a list of finite numbers")
        return self.vector(key, len(value) or 1) if isinstance(value, list) else self.vector(key, 1)

    def inside(self, key: str) -> Path:
        """The path of a file in the folder of this one (`io.safe.files.inside`).

        Raises:
            CaptureError: it names no file in the folder of the JSON file.
        """
        try:
            return inside(self.file.parent, self.text(key), self.name_of(key))
        except CaptureError:
            raise
        except ValueError as error:
            raise CaptureError(str(error)) from None

    def path(self, key: str) -> Path | None:
        """The path of a file in the folder of this one; None if the key is absent."""
        return self.inside(key) if self.has(key) else None

    def block(self, key: str, known: Sequence[str]) -> "Keys | None":
        """The block of that name; None if it is absent.

        Args:
            key: name of the block.
            known: keys that the block may hold; a warning names each other one.

        Raises:
            CaptureError: the value is no block of keys.
        """
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(key, f"a block with the keys {', '.join(known)}")
        block = Keys(self.file, value, self.frame, f"{self.prefix}{key}.", self.kind)
        for name in value:
            if name not in known:
                block.warn(
                    f"the key {block.prefix}{name} is unknown and ignored. "
                    f"Known here: {', '.join(known)}."
                )
        return block

    def pose(self, key: str = "transform_matrix") -> np.ndarray:
        """A rigid camera-to-world matrix, OpenGL axes, as [3, 4]; its rotation is orthogonal.

        Sixteen numbers are four rows. A transposed matrix, and one times a number, are made right,
        with a warning for the first frame.

        Raises:
            CaptureError: it is no rigid matrix; the message says how to mend it.
        """
        rule = "a rigid 4x4 camera-to-world matrix"
        value = self._get(key, _ABSENT, rule)
        try:
            matrix = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            matrix = np.empty(0)
        if matrix.shape == (16,):
            matrix = matrix.reshape(4, 4)
        if matrix.shape not in ((4, 4), (3, 4)):
            raise self.error(key, rule, "Write four rows of four numbers.")
        if not (np.abs(matrix) < np.finfo(np.float32).max).all():
            raise self.error(key, "finite", "Remove the frame, or estimate its pose again.")
        if len(matrix) == 4:
            matrix = self._homogeneous(key, matrix, rule)
        linear = matrix[:3, :3]
        gram = linear.T @ linear
        scale = math.sqrt(np.trace(gram) / 3)
        if np.abs(gram - scale**2 * np.eye(3)).max() > 1e-3 * max(scale**2, 1e-12):
            remedy = "Its first three columns must be unit vectors at right angles."
            raise self.error(key, f"{rule} without shear or unequal scale", remedy)
        if abs(scale - 1) > 1e-3:
            remedy = f"Divide its first three columns by {scale:.6g} (the translation stays)."
            raise self.error(key, f"{rule} without scale", remedy)
        if np.linalg.det(linear) < 0:
            remedy = (
                "Its determinant is -1, so it mirrors: one axis, or all three, points the wrong "
                "way. Negate the column of that axis of the camera (x right, y up, z backwards), "
                "all three columns, or the row of that axis of the world."
            )
            raise self.error(key, f"{rule} without reflection", remedy)
        u, _, vt = np.linalg.svd(linear)
        return np.concatenate([u @ vt, matrix[:3, 3:]], axis=1)

    def _homogeneous(self, key: str, matrix: np.ndarray, rule: str) -> np.ndarray:
        """The matrix with the last row 0 0 0 1, if it has one but for a transposition or a
        factor."""
        change = ""
        if np.abs(matrix[:, 3] - (0, 0, 0, 1)).max() < 1e-6 < np.abs(matrix[3, :3]).max():
            matrix, change = (
                matrix.T,
                "transposed: its last column is 0 0 0 1, as a last row must be",
            )
        last = matrix[3]
        if np.abs(last[:3]).max() < 1e-6 * abs(last[3]) and abs(last[3] - 1) > 1e-6:
            matrix, change = matrix / last[3], f"divided by {last[3]:.6g}, to end with 0 0 0 1"
        if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-6:
            raise self.error(key, f"{rule}, last row 0 0 0 1")
        if change and not self.frame:
            self.warn(f"{self.prefix}{key} is {change}. So is that of each frame like it.")
        return matrix


def _is_finite(value):
    """Whether a value is a number that a float can hold."""
    try:
        return _is_number(value) and math.isfinite(value)
    except OverflowError:
        return False


def _is_number(value):
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def listed_blocks(top: Keys, key: str, kind: str) -> list[Keys]:
    """The blocks of keys in a list; none if the key is absent or an empty text, which AliceVision
    writes for an empty list.

    Args:
        top: the block that has the list.
        key: name of the list.
        kind: what messages call one of its blocks.

    Raises:
        CaptureError: it is no list of blocks.
    """
    listed = top.values.get(key) or []
    if not isinstance(listed, list):
        raise top.error(key, "a list")
    wrong = next((k for k, block in enumerate(listed) if not isinstance(block, dict)), None)
    if wrong is not None:
        raise Keys(top.file, {key: listed[wrong]}, wrong, top.prefix, kind).error(
            key, "a list of blocks"
        )
    return [Keys(top.file, block, k, kind=kind) for k, block in enumerate(listed)]


def block_in(keys: Keys, *names: str) -> Keys:
    """A block of keys inside another.

    Args:
        keys: the outer block.
        names: the keys that lead to it, from the outside.

    Raises:
        CaptureError: one of them is absent or names no block.
    """
    for name in names:
        value = keys.values.get(name)
        if not isinstance(value, dict):
            raise keys.error(name, "a block of keys")
        keys = dataclasses.replace(keys, values=value, prefix=f"{keys.prefix}{name}.")
    return keys
