"""The cameras that a reconstruction stores with its scene, in cameras.json."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from jaxtyping import DTypeLike

from gaussray.capture.capture import View
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.paired import cameras_in
from gaussray.capture.formats.transforms import read_document
from gaussray.dataset.manifest import CAMERAS_FILE, FIT_SCALE


@dataclass(frozen=True)
class FittedCameras:
    """The content of a cameras.json. Its views are made when they are asked for.

    Args:
        document: the top level of the file.
    """

    document: Keys

    @property
    def refined(self) -> bool:
        """Whether the fit refined any camera."""
        return bool(self._info.get("refined"))

    @property
    def scale(self) -> float:
        """Sides of the pictures that were fitted, over those of the capture: at most 1, and 1 where
        nothing says so."""
        scale = self._info.get(FIT_SCALE, 1.0)
        return float(scale) if isinstance(scale, float) and 0 < scale < 1 else 1.0

    @property
    def pictures(self) -> list[str]:
        """The file of each frame's picture, as the reconstruction named it."""
        return [str(frame["file_path"]) for frame in self.document.values["frames"]]

    def views(self, dtype: DTypeLike = jnp.float32) -> list[View]:
        """The view of each frame, as large as the capture's pictures.

        Args:
            dtype: type of the cameras' numbers.

        Raises:
            CaptureError: the file contradicts the format; the message names frame, key and remedy.
        """
        return cameras_in(self.document, dtype)

    @property
    def _info(self) -> Mapping[str, Any]:
        info = self.document.values.get("info")
        return info if isinstance(info, Mapping) else {}


def fitted_cameras_file(scene: Path | str) -> Path:
    """Where the cameras of a scene are stored: beside its file.

    Args:
        scene: the folder of a reconstruction, or a file in it.
    """
    path = Path(scene)
    return (path if path.is_dir() else path.parent) / CAMERAS_FILE


def read_fitted_cameras(scene: Path | str) -> FittedCameras | None:
    """The cameras that are stored with a scene; None if there are none.

    Args:
        scene: the folder of a reconstruction, or a file in it.

    Raises:
        CaptureError: the file is no JSON object with frames.
    """
    path = fitted_cameras_file(scene)
    return FittedCameras(read_document(path)) if path.is_file() else None
