"""The cameras that a reconstruction stores with its scene, in cameras.json."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import View
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.paired import cameras_in
from gaussray.capture.formats.transforms import read_document
from gaussray.dataset.manifest import CAMERAS_FILE, FIT_SCALE


# What a fit finds of the colours of a camera, and its shape.
_RESPONSE = {"gain": (3,), "color_matrix": (3, 3)}


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

    @property
    def training_pictures(self) -> dict[str, list[Path]]:
        """The files that the scene was fitted to, by the name of their camera."""
        found: dict[str, list[Path]] = {}
        for frame in self.document.values["frames"]:
            if frame.get("split") == "train":
                found.setdefault(str(frame.get("camera")), []).append(Path(frame["file_path"]))
        return found

    @property
    def color_responses(self) -> dict[str, Float[np.ndarray, "3 3"]]:
        """Matrix of linear red, green and blue of each camera whose exposure or colours were
        refined: its gains times its colour matrix, rows are output channels.

        Raises:
            CaptureError: a gain is not three numbers, or a colour matrix not 3 x 3.
        """
        gains, matrices = (self._by_camera(name, n) for name, n in _RESPONSE.items())
        return {
            name: np.diag(gains.get(name, np.ones(3))) @ matrices.get(name, np.eye(3))
            for name in gains | matrices
        }

    def _by_camera(self, key: str, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
        """The numbers of each camera under a key of `info`."""
        known = self._info.get(key) or {}
        try:
            found = {name: np.asarray(value, np.float64) for name, value in known.items()}
        except (AttributeError, TypeError, ValueError):
            found = {"": np.zeros(0)}
        if not all(x.shape == shape and np.isfinite(x).all() for x in found.values()):
            size = " x ".join(map(str, shape))
            raise CaptureError(
                f"{self.document.where}: info.{key} must hold {size} numbers for each camera. "
                f"Write the file again with `gaussray reconstruct`, or remove info.{key}."
            )
        return found

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
