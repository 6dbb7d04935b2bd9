"""A produced data set as tar files that stream: WebDataset's layout."""

import io
import json
import re
import tarfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from gaussray.dataset.takes import MANIFEST, read_frames
from gaussray.io.atomic import whole
from gaussray.io.safe.files import inside, opened


def pack(data: Path | str, out: Path | str, *, frames_per_tar: int = 1000) -> list[Path]:
    """Write `out`/000000.tar and so on, each of at most so many frames, in their order.

    A frame is the files of one key, TAKE_FRAME: its picture (`png` or `exr`), its labels by their
    names (`layers.exr`, `moving.png`, ...), and `json`: the frame's entry of the manifest with its
    take's under `take`. The same data set is the same bytes: owners and dates are left out.
    """
    if frames_per_tar < 1:
        raise ValueError(f"frames_per_tar must be at least 1, got {frames_per_tar}.")
    data, out, written = Path(data), Path(out), list[Path]()
    frames = enumerate(_keyed(read_frames(data)))
    following = next(frames, None)
    while following is not None:
        path = out / f"{len(written):06d}.tar"
        with whole(path) as partial, tarfile.open(partial, "w", format=tarfile.USTAR_FORMAT) as tar:
            last = following[0] + frames_per_tar
            while following is not None and following[0] < last:
                _add(tar, data, *following[1])
                following = next(frames, None)
        written.append(path)
    return written


def _keyed(frames: Iterator[dict[str, Any]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Frames with their key: index of the take, and number in it."""
    take, number = None, 0
    for frame in frames:
        number = number + 1 if frame["take"]["index"] == take else 0
        take = frame["take"]["index"]
        yield f"{take:06d}_{number:04d}", frame


def _add(tar: tarfile.TarFile, data: Path, key: str, frame: Mapping[str, Any]) -> None:
    take = {name: value for name, value in frame["take"].items() if name != "frames"}
    named = {"": frame["file_path"], **frame.get("labels", {})}
    files: dict[str, bytes] = {}
    for name, path in named.items():
        if not re.fullmatch(r"\w*", name):
            raise ValueError(f"{data / MANIFEST}: a label must be a word, got {name!r:.80}.")
        source = inside(data, path, f"{data / MANIFEST}: {name or 'file_path'}")
        with opened(source) as file:
            files[f"{name}{source.suffix}".removeprefix(".")] = file.read()
    files["json"] = json.dumps({**frame, "take": take}).encode()
    for extension, content in files.items():
        member = tarfile.TarInfo(f"{key}.{extension}")
        if len(member.name.encode()) > tarfile.LENGTH_NAME:
            raise ValueError(
                f"{data / MANIFEST}: a label must be short enough for a tar file, whose names have "
                f"at most {tarfile.LENGTH_NAME} bytes, got {member.name[:80]!r} and more."
            )
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
