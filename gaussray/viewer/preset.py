"""Presets: the viewer's camera saved as a configuration for `gaussray render`."""

import dataclasses
import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaussray.capture.formats.paired import read_cameras
from gaussray.config.yaml_files import read_yaml, to_plain, yaml_text
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest
from gaussray.io.atomic import atomic_path
from gaussray.render.job import RenderJob
from gaussray.viewer.controls import GROUPS, ControlValues, consistent_values, flat_values
from gaussray.viewer.model import ViewerModel
from gaussray.viewer.viewpoint import Viewpoint, viewpoint_of


CONFIG, CAMERA, PICTURE = "preset.yaml", "camera.json", "picture.png"
# Configuration groups that a preset contains.
SAVED_GROUPS = (*GROUPS, "film", "render", "trace")
PRESET_NAME = re.compile(r"[\w][\w .+-]*")


class Preset(NamedTuple):
    """The control values and the viewpoint of a preset."""

    values: ControlValues
    viewpoint: Viewpoint


def preset_folder(out: Path, name: str) -> Path:
    """The folder of the preset with this name.

    Args:
        out: folder of the presets.
        name: name of the preset.

    Raises:
        ValueError: The name is no plain file name.
    """
    if not PRESET_NAME.fullmatch(name):
        raise ValueError(
            "a preset's name must start with a letter, digit or _ and consist of letters, digits, "
            f"spaces and . + - _, got {name!r}."
        )
    return out / name


def save_preset(
    model: ViewerModel,
    values: ControlValues,
    viewpoint: Viewpoint,
    folder: Path,
    picture: np.ndarray | None = None,
    size: tuple[int, int] | None = None,
) -> Path:
    """Write a preset: `preset.yaml` for `gaussray render`, and `camera.json`, a manifest with the
    exact camera.

    Args:
        model: scene and views of the viewer.
        values: control values by configuration key.
        viewpoint: pose and time of the camera.
        folder: folder of the preset.
        picture: picture to store beside them, 8-bit sRGB.
        size: width and height of the picture in pixels; the model's by default.

    Returns:
        Path of preset.yaml.
    """
    job: RenderJob = model.job(values, viewpoint, size or model.size)
    record = dataclasses.replace(job.records[0], file_path=PICTURE)
    write_manifest(folder / CAMERA, [record], extra={"info": {"scene": str(model.source)}})
    config: Any = to_plain(model.configuration(values))
    blocks = {
        "scene": str(Path(model.source).resolve()),
        "cameras": str((folder / CAMERA).resolve()),
        **{group: config[group] for group in SAVED_GROUPS},
    }
    with atomic_path(folder / CONFIG) as partial:
        partial.write_text(f"# {render_command(folder)}\n{yaml_text(blocks)}")
    if picture is not None:
        write_image(folder / PICTURE, picture)
    return folder / CONFIG


def read_preset(folder: Path) -> Preset:
    """Read a preset that `save_preset` wrote; ValueError if the file is none."""
    path = folder / CONFIG
    try:
        content: Any = read_yaml(path)
        blocks = {group: content[group] for group in GROUPS}
        samples = content["render"]["samples"]
    except OSError as error:
        raise OSError(f"{path}: cannot be read: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: must be a preset of the viewer: {error}") from error
    values = dict(flat_values(blocks)) | {"render.samples": samples}
    return Preset(consistent_values(values), viewpoint_of(read_cameras(folder / CAMERA)[0].camera))


def preset_names(out: Path) -> list[str]:
    """Names of the presets in a folder, sorted."""
    return sorted(path.parent.name for path in out.glob(f"*/{CONFIG}"))


def render_command(folder: Path) -> str:
    """The command line that renders a preset."""
    word = shlex.quote(f"preset={folder / CONFIG}")
    return f"gaussray render {word} out={shlex.quote(str(folder / 'film'))}"
