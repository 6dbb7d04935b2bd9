"""The camera on the page as files: a configuration for `gaussray render`, and its exact numbers."""

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
from gaussray.io.atomic import whole
from gaussray.render.randomize.generate import Shot
from gaussray.viewer.controls import GROUPS, Values, flat, settled
from gaussray.viewer.model import Studio
from gaussray.viewer.viewpoint import Stance, stance_of


CONFIG, CAMERA, PICTURE = "preset.yaml", "camera.json", "picture.png"
# Groups of the configuration that a preset holds.
HELD = (*GROUPS, "film", "render", "trace")
NAMES = re.compile(r"[\w][\w .+-]*")


class Preset(NamedTuple):
    """What a preset sets on the page."""

    values: Values
    stance: Stance


def folder_of(out: Path, name: str) -> Path:
    """The folder of the preset of a name."""
    if not NAMES.fullmatch(name):
        raise ValueError(
            "a preset's name must be of letters, digits, spaces and . + - _, and begin with one of "
            f"the first two or _, got {name!r}."
        )
    return out / name


def save_preset(
    studio: Studio, values: Values, stance: Stance, folder: Path, picture: np.ndarray | None = None
) -> Path:
    """Write a preset into a folder: `preset.yaml`, which `gaussray render` accepts, `camera.json`,
    a manifest with the exact camera, and the `picture` (codes) if there is one."""
    shot: Shot = studio.shot(values, stance, studio.size)
    record = dataclasses.replace(shot.records[0], file_path=PICTURE)
    write_manifest(folder / CAMERA, [record], extra={"info": {"scene": str(studio.source)}})
    made: Any = to_plain(studio.configured(values))
    told = {
        "scene": str(Path(studio.source).resolve()),
        "cameras": str((folder / CAMERA).resolve()),
        **{group: made[group] for group in HELD},
    }
    with whole(folder / CONFIG) as partial:
        partial.write_text(f"# {command(folder)}\n{yaml_text(told)}")
    if picture is not None:
        write_image(folder / PICTURE, picture)
    return folder / CONFIG


def read_preset(folder: Path) -> Preset:
    """A preset as `save_preset` wrote it."""
    path = folder / CONFIG
    try:
        told: Any = read_yaml(path)
        blocks = {group: told[group] for group in GROUPS}
        samples = told["render"]["samples"]
    except OSError as error:
        raise OSError(f"{path}: cannot be read: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: is no preset of the viewer: {error}") from error
    values = dict(flat(blocks)) | {"render.samples": samples}
    return Preset(settled(values), stance_of(read_cameras(folder / CAMERA)[0].camera))


def presets(out: Path) -> list[str]:
    """Names of the presets in a folder."""
    return sorted(path.parent.name for path in out.glob(f"*/{CONFIG}"))


def command(folder: Path) -> str:
    """The line that makes the picture of a preset."""
    word = shlex.quote(f"preset={folder / CONFIG}")
    return f"gaussray render {word} out={shlex.quote(str(folder / 'film'))}"
