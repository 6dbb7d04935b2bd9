"""Versioned .npz files: a JSON header and named arrays, without pickle."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.io.atomic import atomic_path, flush_to_disk
from gaussray.io.safe.arrays import Damaged, read_npz
from gaussray.io.safe.files import parse_json


def write_arrays(
    path: Path | str,
    header: dict[str, Any],
    array: dict[str, np.ndarray],
    *,
    compress: bool = False,
) -> None:
    """Write a header and arrays to an .npz file, which appears whole or not at all.

    Args:
        path: the file.
        header: what JSON can hold, with the keys `format` and `version`.
        array: the arrays by name.
        compress: whether the arrays are compressed by deflate.
    """
    save = np.savez_compressed if compress else np.savez
    with atomic_path(path) as partial:
        with open(partial, "wb") as file:
            save(file, **{"header": np.array(json.dumps(header)), **array})  # type: ignore[arg-type]
        flush_to_disk(partial)


def read_arrays(
    path: Path | str, kind: str, *versions: int
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of an .npz file that `write_arrays` wrote.

    Args:
        path: the file.
        kind: the `format` that its header must name.
        versions: the `version`s that its header may name.

    Returns:
        The header, and the arrays by name.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, of another format or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. `gaussray reconstruct` writes one.")
    try:
        array = read_npz(path)
        text = array.pop("header", None)
        if text is None or text.dtype.kind != "U" or text.ndim:
            raise Damaged(f"{path}: has no header")
        header = parse_json(f"{path}: the header", str(text))
        if not isinstance(header, dict) or not isinstance(header.get("info", {}), dict):
            raise Damaged(f"{path}: its header is no block of keys")
    except Damaged as error:
        raise ValueError(f"{path}: is not a {kind} file or is damaged ({error}).") from error
    if header.get("format") != kind:
        raise ValueError(f"{path}: is a {header.get('format')!r:.80} file, not a {kind} file.")
    if header.get("version") not in versions:
        readable = " and ".join(str(version) for version in versions)
        raise ValueError(
            f"{path}: is of version {header.get('version')!s:.80}, this gaussray reads {readable}. "
            "Reconstruct the scene again or read it with the gaussray that wrote it."
        )
    return header, array
