"""The files of one sample of a generated dataset, for writers of other layouts."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.dataset.layers import read_layers
from gaussray.dataset.sample_manifest import MANIFEST
from gaussray.io.atomic import atomic_path
from gaussray.io.safe.files import inside


class SampleFiles:
    """The frames of one sample, in the order of time.

    Args:
        data: folder of the dataset.
        name: name of the sample's folder, its index in six digits.
        frames: entries of the manifest.
    """

    def __init__(self, data: Path, name: str, frames: list[dict[str, Any]]):
        self.data, self.name, self.frames = data, name, frames

    def file(self, frame: dict[str, Any], label: str | None = None) -> Path:
        """The picture of a frame, or the file of a label.

        Args:
            frame: the frame's entry of the manifest.
            label: name of the label; None is the picture.

        Raises:
            ValueError: The dataset does not have the label.
        """
        name = frame["file_path"] if label is None else frame.get("labels", {}).get(label)
        if name is None:
            missing = "flow_forward" if label == "layers" else label
            raise self.missing_error(f"the label {missing}", f"labels=[{missing}]")
        return inside(self.data, name, self.data / MANIFEST)

    def copy(self, source: Path, target: Path) -> None:
        """Copy a picture of the dataset into the layout.

        Args:
            source: the picture (`file`).
            target: its new path, in a folder that is made where it is missing.

        Raises:
            ValueError: The picture is no PNG file.
        """
        if source.suffix != ".png":
            raise self.missing_error("PNG pictures", "format=png")
        with atomic_path(target) as partial:
            shutil.copyfile(source, partial)

    def flow(self, frame: dict[str, Any]) -> np.ndarray:
        """The flow to the next frame, [h, w, 2]."""
        layers = read_layers(self.file(frame, "layers"))
        if "flow_forward.x" not in layers:
            raise self.missing_error("the label flow_forward", "labels=[flow_forward]")
        return np.stack([layers["flow_forward.x"], layers["flow_forward.y"]], axis=-1)

    def layer(self, frame: dict[str, Any], label: str) -> np.ndarray | None:
        """A label [h, w] of numbers; None where the dataset does not have it.

        Args:
            frame: the frame's entry of the manifest.
            label: name of a channel of the frame's EXR file, such as `z` or `normal.x`.
        """
        if "layers" not in frame.get("labels", {}):
            return None
        return read_layers(self.file(frame, "layers")).get(label)

    def missing_error(self, what: str, remedy: str) -> ValueError:
        """The error of a layout that needs files which the dataset lacks.

        Args:
            what: what is missing.
            remedy: keys that render it.
        """
        return ValueError(
            f"{self.data / MANIFEST}: the layout needs {what}, sample {self.name} has none. Render "
            f"the dataset with {remedy}."
        )
