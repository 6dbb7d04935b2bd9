"""The frames of a written dataset as a PyTorch dataset."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from gaussray.capture.frames import read_image
from gaussray.dataset.layers import read_integers, read_layers
from gaussray.dataset.sample_manifest import MANIFEST, read_frames
from gaussray.io.safe.files import inside
from gaussray.render.aov.files import LAYERS, SHARP
from gaussray.render.aov.labeller import INTEGER_LABELS, PICTURE_LABELS, check_labels
from gaussray.torch.tensors import (
    Item,
    as_tensor,
    camera_tensors,
    channels_first,
    drawn_tensors,
    pixel_times,
)


class SavedFrames(Dataset[Item]):
    """The frames of a dataset that `gaussray render dataset.count=N` has written.

    An item is a dictionary of tensors: `light` [3, h, w] (linear light), `pose` [4, 4] (camera to
    world, OpenGL axes), `time` [], `pixel_times` [h, w] (the middle of every pixel's exposure),
    `sample` [] (index of the sample), `drawn` (the drawn
    values that are numbers, by key), and every label that is asked for: [h, w], or [c, h, w] of
    vectors and of pictures such as `sharp`. A `DataLoader` batches pictures of one size, also with
    several workers.

    Args:
        data: folder of the dataset.
        labels: labels to read, of those that were rendered (docs/labels.md).

    Attributes:
        frames: The manifest's entry of each frame, with the exact camera.

    Raises:
        OSError: The manifest cannot be read.
        ValueError: The manifest is damaged, or a label was not rendered.
    """

    def __init__(self, data: Path | str, *, labels: Sequence[str] = ()):
        check_labels(labels)
        self.data, self.labels = Path(data), tuple(labels)
        self.frames: list[dict[str, Any]] = list(read_frames(data))
        for frame in self.frames:
            missing = [name for name in labels if _file_key(name) not in frame.get("labels", {})]
            if missing:
                raise ValueError(
                    f"{self.data / MANIFEST}: labels must be among those that were rendered, got "
                    f"{missing[0]}. Render the dataset with labels=[{','.join(labels)}]."
                )

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, i: int) -> Item:
        frame = self.frames[i]
        return {
            "light": self._picture(frame["file_path"], frame, frame.get("color_space", "srgb")),
            **camera_tensors(frame["transform_matrix"], frame["time"], _pixel_times(frame)),
            "sample": torch.tensor(frame["take"]["index"]),
            "drawn": drawn_tensors(frame["take"].get("drawn", {})),
            **self._labels(frame),
        }

    def _path(self, name: str) -> Path:
        return inside(self.data, name, str(self.data / MANIFEST))

    def _picture(self, name: str, frame: dict[str, Any], color_space: str) -> torch.Tensor:
        light = read_image(self._path(name), frame["w"], frame["h"], color_space)
        return channels_first(as_tensor(light)).contiguous()

    def _labels(self, frame: dict[str, Any]) -> Item:
        """The label tensors of a frame."""
        files, item = frame.get("labels", {}), Item()
        floats = [name for name in self.labels if _file_key(name) == LAYERS]
        layers = read_layers(self._path(files[LAYERS])) if floats else {}
        for name in self.labels:
            if name in PICTURE_LABELS:
                space = "srgb" if name == SHARP else frame.get("color_space", "srgb")
                item[name] = self._picture(files[name], frame, space)
            elif name in INTEGER_LABELS:
                item[name] = as_tensor(read_integers(self._path(files[name])))
            else:
                item[name] = _float_label(layers, name, self._path(files[LAYERS]))
        return item


def _pixel_times(frame: dict[str, Any]) -> torch.Tensor:
    direction = frame.get("shutter", {}).get("direction", "top_to_bottom")
    return pixel_times(frame["row_times"], direction, (frame["w"], frame["h"]))


def _float_label(layers: dict[str, np.ndarray], name: str, path: Path) -> torch.Tensor:
    """The channel of a label, or those of a vector together."""
    planes = [layers[key] for key in layers if key == name or key.startswith(f"{name}.")]
    if not planes:
        raise ValueError(f"{path}: must hold the label {name}, got {', '.join(layers)}.")
    return as_tensor(np.stack(planes) if len(planes) > 1 else planes[0].copy())


def _file_key(label: str) -> str:
    """The key of a label's file in the manifest."""
    return label if label in (*INTEGER_LABELS, *PICTURE_LABELS) else LAYERS
