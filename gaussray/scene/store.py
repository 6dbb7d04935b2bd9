"""Scenes on disk: one .npz file of arrays, versioned, written whole or not at all.

Layout (version 1): `header` is a JSON text {"format": "gaussray-scene", "version": 1, ...}; every
other entry is one array, named by its path in the `Scene`: static.mean, static.quat, static.scale,
static.opacity, static.harmonics, the same under moving., time_range, and, if the scene moves,
deformation.bodies.{pivot,radius,time,path,turn}, deformation.planes.space.<scale>,
deformation.planes.time.<scale>, deformation.planes.{lower,upper,begin,end},
deformation.trunk.weight and .bias, deformation.{mean,rotation,scale,tint}.{0,1}.{weight,bias},
deformation.light. No pickle: the file cannot carry code.

Version 2 is for scenes that move by a `ResidualField`: deformation.planes as above,
deformation.trunk.<layer>.{weight,bias}, deformation.<head>.{0,1}.{weight,bias} for each head that
exists among mean, rotation, scale, opacity and harmonics, deformation.logit_opacity with the head
opacity, and deformation.encoded (true or false).

Version 3 is for scenes of either kind that are stored compactly, or whose `Deformation` lacks a
head (and its arrays) or every scale of planes. Its header also lists all `arrays`, and under
`codes` those that are quantised to bytes, each with the fields of its `compression.Code`.

Version 4 is for clips. Its header lists under `segments` the headers of their scenes; the arrays of
segment i have the names that they would have in a file of their own, after the prefix "i.".

Version 5 is version 3 for scenes with transient Gaussians, whose arrays are transient.mean,
transient.velocity, transient.quat, transient.scale, transient.opacity, transient.harmonics,
transient.instant, transient.lifetime and transient.plateau.

Version 6 is version 3 for scenes with control points, deformation.control.{pivot,radius,time,path,
turn}, with or without transient Gaussians.

Version 7 is version 3 for scenes in changing light, light.{time,gain}, whatever else they have.

Version 8 is version 3 for scenes over which shadows pass, shading.{lower,upper,time,log_gain},
whatever else they have.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.compression import compress_arrays, restore_arrays
from gaussray.scene.deformation import HEADS, Deformation
from gaussray.scene.named_arrays import named_arrays, scene_from
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of


FORMAT = "gaussray-scene"
# A scene is written in the lowest version that can hold it.
_VERSION, RESIDUALS, LISTED, SEGMENTS, TRANSIENT, CONTROL, LIGHT, SHADING = 1, 2, 3, 4, 5, 6, 7, 8
VERSIONS = _VERSION, RESIDUALS, LISTED, SEGMENTS, TRANSIENT, CONTROL, LIGHT, SHADING
# Versions whose header lists the arrays.
_LISTS = LISTED, TRANSIENT, CONTROL, LIGHT, SHADING
# How arrays are stored: full keeps every bit, compact quantises (`compression`).
PRECISIONS = ("full", "compact")


def save_scene(
    path: Path | str,
    scene: Scene | Clip,
    *,
    info: dict[str, Any] | None = None,
    precision: str | Sequence[str] = "full",
) -> None:
    """Write a scene to an .npz file, which appears whole or not at all.

    Args:
        path: the file.
        scene: the scene, or a clip of several.
        info: anything that JSON can hold; `scene_info` reads it back.
        precision: `full` keeps every bit; `compact` quantises to about a quarter of the bytes, and
            a scene read from a compact file loses nothing more. For a clip, one of the two for each
            segment.

    Raises:
        ValueError: the precision is unknown, or a scene stored compactly is not finite.
        OSError: the file cannot be written.
    """
    parts = segments_of(scene)
    precisions = [precision] * len(parts) if isinstance(precision, str) else list(precision)
    contents = [_contents(*pair, info or {}) for pair in zip(parts, precisions, strict=True)]
    header, array = contents[0]
    if isinstance(scene, Clip):
        header = {"format": FORMAT, "version": SEGMENTS, "info": info or {}}
        header["segments"] = [
            {k: part[k] for k in ("version", "arrays", "codes") if k in part}
            for part, _ in contents
        ]
        array = {f"{i}.{k}": x for i, (_, part) in enumerate(contents) for k, x in part.items()}
    write_arrays(path, header, array, compress="compact" in precisions)


def load_scene(path: Path | str) -> Scene | Clip:
    """Read a scene that `save_scene` or `gaussray reconstruct` wrote.

    Args:
        path: the .npz file, or a folder with a `scene.npz`.

    Returns:
        The scene, or a clip if the file holds several segments.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or of an unknown version.
    """
    path = _scene_file(path)
    header, array = read_arrays(path, FORMAT, *VERSIONS)
    return (_clip if header["version"] == SEGMENTS else _scene)(header, array, path)


def scene_info(path: Path | str) -> dict[str, Any]:
    """The `info` that `save_scene` stored with a scene on disk."""
    return read_arrays(_scene_file(path), FORMAT, *VERSIONS)[0].get("info", {})


def as_stored(scene: Scene, *, precision: str) -> Scene:
    """The scene that `load_scene` would return after `save_scene`.

    Args:
        scene: the scene.
        precision: as for `save_scene`.
    """
    return _scene(*_contents(scene, precision, {}), Path("scene.npz"))


def _scene_file(path: Path | str) -> Path:
    path = Path(path)
    return path / "scene.npz" if path.is_dir() else path


def _contents(
    scene: Scene, precision: str, info: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a scene's file."""
    if precision not in PRECISIONS:
        raise ValueError(f"precision must be one of {', '.join(PRECISIONS)}, got {precision!r}.")
    array, codes = named_arrays(scene), {}
    if precision == "compact":
        codes, array = compress_arrays(array)
    header: dict[str, Any] = {"format": FORMAT, "version": _version(scene), "info": info}
    if codes or header["version"] in _LISTS:
        version = header["version"] if header["version"] in _LISTS else LISTED
        header |= {"version": version, "arrays": sorted(array), "codes": codes}
    return header, array


def _version(scene: Scene) -> int:
    deformation = scene.deformation
    if scene.shading is not None:
        return SHADING
    if scene.light is not None:
        return LIGHT
    if isinstance(deformation, Deformation) and deformation.control is not None:
        return CONTROL
    if scene.transient is not None:
        return TRANSIENT
    if isinstance(deformation, ResidualField):
        return RESIDUALS
    complete = deformation is None or (
        deformation.planes.space and all(getattr(deformation, head) for head in HEADS)
    )
    return _VERSION if complete else LISTED


def _scene(header: dict[str, Any], array: dict[str, np.ndarray], path: Path) -> Scene:
    """The scene in a file."""
    if header["version"] not in _LISTS:
        return scene_from(array, path, residuals=header["version"] == RESIDUALS)
    entries, codes = header.get("arrays"), header.get("codes")
    if not isinstance(entries, list) or not isinstance(codes, dict):
        raise ValueError(f"{path}: the header does not list its arrays; the scene is damaged.")
    for name in entries:
        # The type first: a list among the names could not be looked up in a dict.
        if not isinstance(name, str) or name not in array:
            raise ValueError(f"{path}: the array '{name!s:.80}' is missing; the file is not whole.")
    array = restore_arrays(codes, array, path)
    residuals = "deformation.encoded" in array
    return scene_from(array, path, residuals=residuals, required_heads=())


def _clip(header: dict[str, Any], array: dict[str, np.ndarray], path: Path) -> Clip:
    """The clip in a file."""
    entries = header.get("segments")
    versions = _VERSION, RESIDUALS, *_LISTS
    if not isinstance(entries, list) or not all(
        isinstance(part, dict) and part.get("version") in versions for part in entries
    ):
        raise ValueError(f"{path}: the header does not list its segments; the scene is damaged.")

    def segment(i: int) -> Scene:
        part = {k.removeprefix(f"{i}."): x for k, x in array.items() if k.startswith(f"{i}.")}
        return _scene(entries[i], part, path / f"segment {i + 1}")

    scenes = tuple(segment(i) for i in range(len(entries)))
    try:
        return Clip(scenes)
    except ValueError as error:
        raise ValueError(f"{path}: {error} The scene is damaged.") from error
