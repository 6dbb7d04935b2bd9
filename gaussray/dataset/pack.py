"""Packs a generated dataset into tar files in the layout of WebDataset."""

import io
import json
import re
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gaussray.dataset.sample_manifest import MANIFEST, read_frames
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.files import inside, opened


def pack(data: Path | str, out: Path | str, *, frames_per_tar: int = 1000) -> list[Path]:
    """Write a dataset as `out`/000000.tar and so on, in the order of its frames.

    The files of a frame share a key, made of the numbers of sample and frame: the picture (`png` or
    `exr`), the labels by name (`layers.exr`, `moving.png`, ...), and `json` with the frame's entry
    of the manifest and, under `take`, its sample's. Equal datasets give equal files: owners and
    dates are left out.

    Args:
        data: folder of the dataset.
        out: folder of the tar files.
        frames_per_tar: largest number of frames in a file.

    Returns:
        The paths of the tar files.

    Raises:
        ValueError: a label has no valid name, or a file lies outside the dataset.
        OSError: a file cannot be read or written.
    """
    if frames_per_tar < 1:
        raise ValueError(f"frames_per_tar must be at least 1, got {frames_per_tar}.")
    data, out, written = Path(data), Path(out), list[Path]()
    frames = enumerate(_with_keys(read_frames(data)))
    following = next(frames, None)
    while following is not None:
        path = out / f"{len(written):06d}.tar"
        with (
            atomic_path(path) as partial,
            tarfile.open(partial, "w", format=tarfile.USTAR_FORMAT) as tar,
        ):
            last = following[0] + frames_per_tar
            while following is not None and following[0] < last:
                _add(tar, data, *following[1])
                following = next(frames, None)
        written.append(path)
    return written


def _with_keys(frames: Iterator[dict[str, Any]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Frames with their keys: index of the sample, and number of the frame in it."""
    index, number = None, 0
    for frame in frames:
        number = number + 1 if frame["take"]["index"] == index else 0
        index = frame["take"]["index"]
        yield f"{index:06d}_{number:04d}", frame


def _add(tar: tarfile.TarFile, data: Path, key: str, frame: Mapping[str, Any]) -> None:
    sample = {name: value for name, value in frame["take"].items() if name != "frames"}
    named = {"": frame["file_path"], **frame.get("labels", {})}
    files: dict[str, bytes] = {}
    for name, path in named.items():
        if not re.fullmatch(r"\w*", name):
            raise ValueError(f"{data / MANIFEST}: a label must be a word, got {name!r:.80}.")
        source = inside(data, path, f"{data / MANIFEST}: {name or 'file_path'}")
        with opened(source) as file:
            files[f"{name}{source.suffix}".removeprefix(".")] = file.read()
    files["json"] = json.dumps({**frame, "take": sample}).encode()
    for extension, content in files.items():
        member = tarfile.TarInfo(f"{key}.{extension}")
        if len(member.name.encode()) > tarfile.LENGTH_NAME:
            raise ValueError(
                f"{data / MANIFEST}: a label must be short enough for a tar file, whose names have "
                f"at most {tarfile.LENGTH_NAME} bytes, got {member.name[:80]!r} and more."
            )
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
