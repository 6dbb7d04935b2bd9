"""Writes a generated dataset as an image folder, which Hugging Face's `datasets` reads."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gaussray.dataset.sample_files import SampleFiles
from gaussray.io.atomic import atomic_path


def write_image_folder(samples: Iterable[SampleFiles], out: Path) -> int:
    """Write `out`/train with the pictures, their labels, and metadata.jsonl, a line for each frame.

    `file_name` is the picture, and LABEL_file_name a label that is a PNG picture: the reader opens
    both as columns `image` and LABEL. `layers` is the path of the EXR file of labels that are
    numbers. `entry` is the manifest's entry of the frame as JSON, with the exact camera.

    Args:
        samples: samples of PNG pictures, with any labels.
        out: folder of the layout.

    Returns:
        The number of frames.
    """
    folder, lines = out / "train", list[str]()
    for source in samples:
        for i, frame in enumerate(source.frames):
            name = f"{source.name}_{i:04d}"
            source.copy(source.file(frame), folder / f"images/{name}.png")
            line = {"file_name": f"images/{name}.png"} | _labels(source, frame, name, folder)
            line |= {"sample": int(source.name), "frame": i, "time": float(frame["time"])}
            entry = {key: value for key, value in frame.items() if key != "take"}
            line |= {"width": frame["w"], "height": frame["h"], "camera": frame["camera"]}
            line |= {"transform_matrix": frame["transform_matrix"], "entry": json.dumps(entry)}
            lines.append(json.dumps(line))
    with atomic_path(folder / "metadata.jsonl") as partial:
        partial.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return len(lines)


def _labels(source: SampleFiles, frame: dict[str, Any], name: str, folder: Path) -> dict[str, str]:
    """The columns of the labels of a frame, whose files are copied."""
    columns = {}
    for label in frame.get("labels", {}):
        path = source.file(frame, label)
        target = f"{label}/{name}{path.suffix}"
        with atomic_path(folder / target) as partial:
            shutil.copyfile(path, partial)
        columns[f"{label}_file_name" if path.suffix == ".png" else label] = target
    return columns
