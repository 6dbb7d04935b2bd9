"""The manifest of a generated dataset: one line for each sample (sample_manifest.md).

A sample is a camera that was drawn, and its frames. Its files are in the folder `takes/000000`.
"""

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import row_moments
from gaussray.dataset.manifest import FrameRecord
from gaussray.io.atomic import atomic_path, remove_partial_files
from gaussray.io.json_numbers import json_numbers
from gaussray.io.safe.files import opened, parse_json, read_json
from gaussray.io.safe.limits import limits, within
from gaussray.runtime.output import listed_names
from gaussray.runtime.provenance import git_commit


# Of the schema: raised when a key changes its meaning or goes; keys may be added.
VERSION = 1
MANIFEST, SAMPLE_FILE = "manifest.jsonl", "take.json"
# Keys that a message names.
_NAMED = 5


def sample_folder(index: int) -> str:
    """The folder of a sample within the dataset."""
    return f"takes/{index:06d}"


def is_complete(folder: Path, facts: Mapping[str, Any]) -> bool:
    """Whether the sample of a folder is complete.

    Args:
        folder: folder of the sample.
        facts: its parameters, drawn values and seed.

    Raises:
        ValueError: The sample in the folder was rendered from other facts.
    """
    line = folder / SAMPLE_FILE
    if not line.exists():
        return False
    there = read_json(line)
    if not isinstance(there, dict):
        raise ValueError(
            f"{line}: must hold the line of a sample. Delete it to render the sample again."
        )
    other = _changes(there, _json(facts))
    if other:
        raise ValueError(
            f"{line}: the sample that is there was made with other values of "
            f"{listed_names(other, most=_NAMED)}. Choose another folder as out, or delete this one."
        )
    return True


def _changes(before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = "") -> list[str]:
    """The keys of `now` that had another value before; of blocks those inside of them."""
    keys = []
    for key, value in now.items():
        then = before.get(key)
        if isinstance(value, dict) and isinstance(then, dict):
            keys += _changes(then, value, f"{prefix}{key}.")
            keys += [f"{prefix}{key}.{name}" for name in then if name not in value]
        elif then != value:
            keys.append(f"{prefix}{key}")
    return keys


def write_sample(folder: Path, facts: Mapping[str, Any], records: Sequence[FrameRecord]) -> None:
    """Write the manifest line of a sample, which marks it as complete.

    It holds the facts, the frames of the camera files, and the time at which each row is exposed.

    Args:
        folder: folder of the sample, with its pictures and camera files.
        facts: its parameters, drawn values and seed.
        records: its frames.
    """
    made_by = {"gaussray": version("gaussray"), "git": _commit()}
    line = json.dumps({**_json(facts), **made_by, **_frame_facts(folder, records)}, allow_nan=False)
    with atomic_path(folder / SAMPLE_FILE) as partial:
        partial.write_text(line + "\n", encoding="utf-8")


def append_to_manifest(data: Path, index: int) -> None:
    """Append the line of a complete sample to the manifest.

    It is a single write, so that the processes of several shards can append.

    Args:
        data: folder of the dataset.
        index: index of the sample.
    """
    line = (data / sample_folder(index) / SAMPLE_FILE).read_bytes()
    manifest = os.open(data / MANIFEST, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        os.write(manifest, line)
    finally:
        os.close(manifest)


def write_sample_manifest(data: Path, count: int) -> int:
    """Write the manifest of the complete samples, sorted by index: also of those that an earlier
    run with a larger number of samples has left.

    Args:
        data: folder of the dataset.
        count: number of samples of the dataset.

    Returns:
        The number of samples that are missing.
    """
    there = sorted((data / sample_folder(0)).parent.glob(f"[0-9]*/{SAMPLE_FILE}"), key=_index_of)
    missing = count - sum(_index_of(line) < count for line in there)
    if not missing:
        remove_partial_files(data)
    if there:
        with atomic_path(data / MANIFEST) as partial, partial.open("w", encoding="utf-8") as file:
            for line in there:
                file.write(line.read_text(encoding="utf-8"))
    return missing


def _index_of(line: Path) -> int:
    """The index of the sample whose line this is."""
    return int(line.parent.name) if line.parent.name.isdecimal() else 0


def read_samples(data: Path | str) -> Iterator[dict[str, Any]]:
    """The lines of a dataset's manifest, one after another.

    Raises:
        OSError: the manifest cannot be read.
    """
    path = Path(data) / MANIFEST
    try:
        file = opened(path)
    except OSError as error:
        raise OSError(
            f"{path}: cannot be read: {error} Datasets of samples have one, from the first sample "
            "on: `gaussray render ... sample=cameras dataset.count=1000 out=DATA`."
        ) from error
    most, number = int(limits().text * 1e6), 0
    with file:
        while line := file.readline(most + 1):
            number += 1
            within(path, f"line {number} in MB", len(line), "text", 1e6)
            yield _parse_sample(f"{path}: line {number}", line)


def _parse_sample(where: str, line: bytes) -> dict[str, Any]:
    """A sample from its line; its index, folder and frames are checked."""
    sample = parse_json(where, line)
    if not isinstance(sample, dict) or sample.get("version") != VERSION:
        version = sample.get("version") if isinstance(sample, dict) else None
        raise ValueError(
            f"{where} is of version {version!s:.80}, this gaussray reads version {VERSION}."
        )
    frames, named = sample.get("frames"), [sample.get("folder")]
    valid = isinstance(frames, list)
    for frame in frames if isinstance(frames, list) else []:
        labels = frame.get("labels", {}) if isinstance(frame, dict) else None
        valid = valid and isinstance(labels, dict)
        named += [frame.get("file_path"), *labels.values()] if isinstance(labels, dict) else []
    if not valid or type(sample.get("index")) is not int or sample["index"] < 0:
        raise ValueError(f"{where} must hold index, folder and frames of a sample.")
    if not all(isinstance(name, str) and name for name in named):
        raise ValueError(f"{where} must name files by texts that are not empty.")
    return sample


def read_frames(data: Path | str) -> Iterator[dict[str, Any]]:
    """The frames of all samples, in order, each with the line of its sample under the key `take`.
    Paths are relative to the dataset's folder."""
    for sample in read_samples(data):
        folder = Path(sample["folder"])
        for frame in sample["frames"]:
            files = {"file_path": (folder / frame["file_path"]).as_posix()}
            if "labels" in frame:
                named = frame["labels"].items()
                files["labels"] = {name: (folder / path).as_posix() for name, path in named}
            yield {**frame, **files, "take": sample}


def _frame_facts(folder: Path, records: Sequence[FrameRecord]) -> dict[str, Any]:
    """What the camera files of a sample's folder say of its frames, and the times of their rows."""
    folders, info = {}, {}
    for path in sorted(folder.glob("*.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        if document.get("frames", [{}])[0].get("file_path") is None:
            continue
        shared = {k: v for k, v in document.items() if k not in ("frames", "info")}
        for frame in document["frames"]:
            folders[frame["file_path"]] = {**shared, **frame}
            info[frame["file_path"]] = document.get("info", {})
    frames = [
        {**folders[record.file_path], "row_times": row_exposure_times(record.camera)}
        for record in records
    ]
    return {"info": info[records[0].file_path], "frames": frames}


def row_exposure_times(camera: Camera) -> list[float]:
    """The middle of the exposure of each row (column, where the shutter reads sideways); a single
    number if all rows are exposed at once."""
    shutter, size = camera.shutter, (camera.film.width, camera.film.height)
    times = float(camera.time) + row_moments(shutter, size)
    if shutter.direction in ("bottom_to_top", "right_to_left"):
        times = times[::-1]
    times = np.asarray(times, np.asarray(camera.time).dtype)
    return json_numbers(times[:1] if np.ptp(times) == 0 else times)


def _json(value: Any) -> Any:
    """A value as JSON can hold it: infinity becomes a word."""
    if isinstance(value, Mapping):
        return {key: _json(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_json(one) for one in value]
    if isinstance(value, float) and math.isinf(value):
        return "infinity" if value > 0 else "-infinity"
    return value


def _commit() -> str | None:
    """The git commit of the checkout, with -dirty where files differ from it; None for an installed
    package."""
    commit = git_commit()
    return commit and commit.hash + ("-dirty" if commit.changed else "")
