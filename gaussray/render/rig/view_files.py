"""Reads the views to render: those of a capture, or those stored with a reconstructed scene."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp

from gaussray.capture.capture import View
from gaussray.capture.formats.paired import effect_files, read_cameras
from gaussray.capture.formats.transforms import PINHOLE_FILE
from gaussray.capture.open import FORMATS, format_of
from gaussray.capture.selection import Selection, cropped_and_scaled
from gaussray.render.aov.labeller import PICTURE_LABELS
from gaussray.render.rig.fitted_cameras import fitted_cameras_file, read_fitted_cameras


def load_views(scene: Path | str, cameras: Path | str | None) -> list[View]:
    """Read the views of a capture, or those stored with a reconstructed scene, as large as the
    pictures that it was fitted to.

    Args:
        scene: the folder of a reconstruction, or a scene file in it; read if `cameras` is None.
        cameras: a folder with a capture in any format, or a manifest (JSON).

    Returns:
        One view per frame: camera, name, split, time and, for a capture, the picture.

    Raises:
        OSError: A file cannot be read, or the scene has no cameras.json.
        ValueError: A file is malformed.
    """
    if cameras is not None:
        folder = Path(cameras)
        if not folder.exists():
            raise FileNotFoundError(
                f"cameras={cameras}: no such file or folder. Name a capture's folder, or a "
                "manifest (JSON)."
            )
        if not folder.is_dir():
            return read_cameras(folder)
        name = format_of(folder)
        if name != "paired":
            return FORMATS[name](folder, jnp.float32).views
        return read_cameras(_only_manifest(folder))
    fitted = read_fitted_cameras(scene)
    if fitted is None:
        raise FileNotFoundError(
            f"{fitted_cameras_file(scene)}: no such file. Name a capture's folder, cameras=DIR, or "
            "place a camera: camera=orbit or camera=look_at."
        )
    scaled, made = Selection(scale=fitted.scale), dict[Any, Any]()
    return [cropped_and_scaled(view, scaled, made) for view in fitted.views()]


def _only_manifest(folder: Path) -> Path:
    """The manifest of a folder: transforms.json, or the only one of another effect. Those of ground
    truth, which a render with labels writes beside it, do not count.

    Raises:
        ValueError: There are several.
    """
    if (folder / PINHOLE_FILE).is_file():
        return folder / PINHOLE_FILE
    files = effect_files(folder)
    others = [path for name, path in files.items() if name not in PICTURE_LABELS]
    found = others or list(files.values())
    if len(found) > 1:
        raise ValueError(
            f"cameras={folder}: has no {PINHOLE_FILE} but several manifests: "
            f"{', '.join(path.name for path in found)}. Name one of them: cameras={found[0]}."
        )
    return found[0]
