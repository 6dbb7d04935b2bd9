"""Scenes on disk: one .npz file of arrays, versioned, written whole or not at all.

Layout (version 1): `header` is a JSON text {"format": "gaussray-scene", "version": 1, ...}; every
other entry is one array, named by its path in the `Scene`: static.mean, static.quat, static.scale,
static.opacity, static.harmonics, the same under moving., time_range, and, if the scene moves,
deformation.bodies.{pivot,radius,time,path,turn}, deformation.planes.space.<scale>,
deformation.planes.time.<scale>, deformation.planes.{lower,upper,begin,end},
deformation.trunk.weight and .bias, deformation.{mean,rotation,scale,tint}.{0,1}.{weight,bias},
deformation.light. No pickle: the file cannot carry code.

Version 2 is for scenes that move by a `ResidualField`: deformation.planes as above,
deformation.trunk.<layer>.{weight,bias}, deformation.<head>.{0,1}.{weight,bias} of those of the
heads mean, rotation, scale, opacity and harmonics that there are, deformation.logit_opacity with
the head opacity, and deformation.encoded (true or false).

Version 3 is for scenes of either kind that are kept compactly, or whose `Deformation` lacks a head
(and its arrays) or every scale. Its header also lists all `arrays`, and under `codes` those that
are kept as bytes, each with what `compact.Code` says of it.

Version 4 is for clips. Its header lists under `segments` what the headers of their scenes would
say; the arrays of segment i have the names that they would have there after "i.".
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from gaussray.io.atomic import settle, whole
from gaussray.io.safe.arrays import Damaged, read_npz
from gaussray.io.safe.files import parse_json
from gaussray.scene.bodies import Bodies
from gaussray.scene.compression import compressed, restored
from gaussray.scene.deformation import Deformation, Layer
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.planes import Planes
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of
from gaussray.scene.shape_check import misfit


FORMAT = "gaussray-scene"
# A scene is written in the first version that has a place for it.
VERSION, RESIDUALS, LISTED, SEGMENTS = 1, 2, 3, 4
# What is kept of the arrays: every bit, or what `compact` says.
PRECISIONS = ("full", "compact")
HEADS = ("mean", "rotation", "scale", "tint")


def save_scene(
    path: Path | str,
    scene: Scene | Clip,
    *,
    info: dict[str, Any] | None = None,
    precision: str | Sequence[str] = "full",
) -> None:
    """Write a scene; `info` (anything JSON) is kept in the header.

    A `precision` of full keeps every bit; compact what `compact` says, in about a quarter of the
    bytes, and loses nothing more of a scene that was read from such a file; of a clip, each segment
    may have its own. ValueError if it is another, or if a scene to be kept compactly is not finite.
    """
    parts = segments_of(scene)
    each = [precision] * len(parts) if isinstance(precision, str) else list(precision)
    contents = [_contents(one, info or {}, own) for one, own in zip(parts, each, strict=True)]
    header, array = contents[0]
    if isinstance(scene, Clip):
        header = {"format": FORMAT, "version": SEGMENTS, "info": info or {}}
        header["segments"] = [
            {k: own[k] for k in ("version", "arrays", "codes") if k in own} for own, _ in contents
        ]
        array = {f"{i}.{k}": x for i, (_, own) in enumerate(contents) for k, x in own.items()}
    write_arrays(path, header, array, deflated="compact" in each)


def load_scene(path: Path | str) -> Scene | Clip:
    """Read a scene; a folder means its scene.npz."""
    path = _scene_file(path)
    header, array = read_arrays(path, FORMAT, VERSION, RESIDUALS, LISTED, SEGMENTS)
    return (_clip if header["version"] == SEGMENTS else _scene)(header, array, path)


def scene_info(path: Path | str) -> dict[str, Any]:
    """What was told `save_scene` of a scene on disk."""
    versions = VERSION, RESIDUALS, LISTED, SEGMENTS
    return read_arrays(_scene_file(path), FORMAT, *versions)[0].get("info", {})


def _scene_file(path: Path | str) -> Path:
    path = Path(path)
    return path / "scene.npz" if path.is_dir() else path


def as_stored(scene: Scene, *, precision: str) -> Scene:
    """What `load_scene` returns of what `save_scene` writes."""
    return _scene(*_contents(scene, {}, precision), Path("scene.npz"))


def _contents(
    scene: Scene, info: dict[str, Any], precision: str
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a scene's file."""
    if precision not in PRECISIONS:
        raise ValueError(f"precision must be one of {', '.join(PRECISIONS)}, got {precision!r}.")
    array, codes = named(scene), {}
    if precision == "compact":
        codes, array = compressed(array)
    header: dict[str, Any] = {"format": FORMAT, "version": _version(scene), "info": info}
    if codes or header["version"] == LISTED:
        header |= {"version": LISTED, "arrays": sorted(array), "codes": codes}
    return header, array


def _version(scene: Scene) -> int:
    moved = scene.deformation
    if isinstance(moved, ResidualField):
        return RESIDUALS
    complete = moved is None or (moved.planes.space and all(getattr(moved, x) for x in HEADS))
    return VERSION if complete else LISTED


def _scene(header: dict[str, Any], array: dict[str, np.ndarray], path: Path) -> Scene:
    """The scene in a file."""
    if header["version"] != LISTED:
        return scene_from(array, path, residuals=header["version"] == RESIDUALS)
    listed, codes = header.get("arrays"), header.get("codes")
    if not isinstance(listed, list) or not isinstance(codes, dict):
        raise ValueError(f"{path}: the header does not list its arrays; the scene is damaged.")
    for name in listed:
        # It may be anything, a list among them, which no table takes for a name.
        if not isinstance(name, str) or name not in array:
            raise ValueError(f"{path}: the array '{name!s:.80}' is missing; the file is not whole.")
    array = restored(codes, array, path)
    return scene_from(array, path, residuals="deformation.encoded" in array, demanded=())


def _clip(header: dict[str, Any], array: dict[str, np.ndarray], path: Path) -> Clip:
    """The clip in a file."""
    listed = header.get("segments")
    versions = VERSION, RESIDUALS, LISTED
    if not isinstance(listed, list) or not all(
        isinstance(own, dict) and own.get("version") in versions for own in listed
    ):
        raise ValueError(f"{path}: the header does not list its segments; the scene is damaged.")

    def segment(i: int) -> Scene:
        own = {k.removeprefix(f"{i}."): x for k, x in array.items() if k.startswith(f"{i}.")}
        return _scene(listed[i], own, path / f"segment {i + 1}")

    scenes = tuple(segment(i) for i in range(len(listed)))
    try:
        return Clip(scenes)
    except ValueError as error:
        raise ValueError(f"{path}: {error} The scene is damaged.") from error


def scene_from(
    array: dict[str, np.ndarray],
    path: Path,
    *,
    residuals: bool = False,
    demanded: Sequence[str] = HEADS,
) -> Scene:
    """The scene in a table of named arrays, which moves by a `ResidualField` or not; the heads that
    a `Deformation` must have are `demanded`."""

    def take(name: str) -> Array:
        return _take(array, name, path)

    def gaussians(prefix: str) -> Gaussians:
        fields = ("mean", "quat", "scale", "opacity", "harmonics")
        values = {field: take(f"{prefix}.{field}") for field in fields}
        rows = {field: value.shape[:1] for field, value in values.items()}
        if len(set(rows.values())) != 1:
            raise ValueError(f"{path}: the arrays of '{prefix}' differ in length: {rows}.")
        wanted = {"mean": (3,), "quat": (4,), "scale": (3,), "opacity": ()}
        wanted["harmonics"] = (*values["harmonics"].shape[1:2], 3)
        for field, value in values.items():
            if value.shape[1:] != wanted[field]:
                raise ValueError(
                    f"{path}: the array '{prefix}.{field}' has the shape {value.shape} instead of "
                    f"{value.shape[:1] + wanted[field]}; the scene is damaged."
                )
        return Gaussians(**values)

    if residuals:
        deformation = _residuals(array, "deformation", path)
    else:
        deformation = deformation_from(array, "deformation", path, demanded)
    time_range = take("time_range")
    if time_range.shape != (2,) or not time_range[0] <= time_range[1]:
        raise ValueError(
            f"{path}: the array 'time_range' must hold two times, the earlier one first, got "
            f"{str(time_range)[:80]}; the scene is damaged."
        )
    scene = Scene(gaussians("static"), gaussians("moving"), deformation, time_range)
    wrong = misfit(scene)
    if wrong:
        raise ValueError(f"{path}: its arrays do not fit together ({wrong}); the scene is damaged.")
    return scene


def deformation_from(
    array: dict[str, np.ndarray], prefix: str, path: Path, demanded: Sequence[str] = HEADS
) -> Deformation | None:
    """The deformation among named arrays, None if there is none; a head that is not `demanded` may
    be missing."""
    if not any(name.startswith(f"{prefix}.") for name in array):
        return None

    def layer(name: str) -> Layer:
        return _layer(array, f"{prefix}.{name}", path)

    def head(name: str) -> tuple[Layer, Layer] | None:
        if name not in demanded and not any(x.startswith(f"{prefix}.{name}.") for x in array):
            return None
        return layer(f"{name}.0"), layer(f"{name}.1")

    names = ("pivot", "radius", "time", "path", "turn")
    bodies = Bodies(*(_take(array, f"{prefix}.bodies.{name}", path) for name in names))
    return Deformation(
        bodies,
        _planes(array, f"{prefix}.planes", path),
        layer("trunk"),
        **{name: head(name) for name in HEADS},
        light=_take(array, f"{prefix}.light", path),
    )


def _residuals(array: dict[str, np.ndarray], prefix: str, path: Path) -> ResidualField:
    depth = len({x.split(".")[2] for x in array if x.startswith(f"{prefix}.trunk.")})

    def head(name: str) -> tuple[Layer, Layer] | None:
        if not any(x.startswith(f"{prefix}.{name}.") for x in array):
            return None
        first, last = (_layer(array, f"{prefix}.{name}.{i}", path) for i in range(2))
        return first, last

    heads = [head(name) for name in ("mean", "rotation", "scale", "opacity", "harmonics")]
    planes = _planes(array, f"{prefix}.planes", path)
    trunk = tuple(_layer(array, f"{prefix}.trunk.{i}", path) for i in range(max(depth, 1)))
    logit, encoded = f"{prefix}.logit_opacity", _take(array, f"{prefix}.encoded", path)
    at_rest = _take(array, logit, path) if logit in array else None
    if encoded.ndim:
        raise ValueError(
            f"{path}: the array '{prefix}.encoded' must be one value, got the shape "
            f"{encoded.shape}; the scene is damaged."
        )
    try:
        return ResidualField(planes, trunk, *heads, logit_opacity=at_rest, encoded=bool(encoded))
    except ValueError as error:
        raise ValueError(f"{path}: {error} The scene is damaged.") from error


def _planes(array: dict[str, np.ndarray], prefix: str, path: Path) -> Planes:
    scales = sum(name.startswith(f"{prefix}.space.") for name in array)
    return Planes(
        space=tuple(_take(array, f"{prefix}.space.{i}", path) for i in range(scales)),
        time=tuple(_take(array, f"{prefix}.time.{i}", path) for i in range(scales)),
        **{k: _take(array, f"{prefix}.{k}", path) for k in ("lower", "upper", "begin", "end")},
    )


def _layer(array: dict[str, np.ndarray], prefix: str, path: Path) -> Layer:
    return Layer(*(_take(array, f"{prefix}.{name}", path) for name in ("weight", "bias")))


def _take(array: dict[str, np.ndarray], name: str, path: Path) -> Array:
    if name not in array:
        raise ValueError(f"{path}: the array '{name}' is missing; the file is not whole.")
    if array[name].dtype.kind not in "fb":
        raise ValueError(
            f"{path}: the array '{name}' must hold real numbers, got {array[name].dtype}; the "
            "scene is damaged."
        )
    if not np.isfinite(array[name]).all():
        raise ValueError(f"{path}: the array '{name}' must be finite; the scene is damaged.")
    return jnp.asarray(array[name])


def named(tree: Any, prefix: str = "") -> dict[str, np.ndarray]:
    """Every array of a tree of modules and tuples, under its path."""
    if tree is None:
        return {}
    if hasattr(tree, "shape") or isinstance(tree, bool):
        return {prefix: np.asarray(tree)}
    fields = getattr(tree, "_fields", None)
    if fields is not None:
        parts = {name: getattr(tree, name) for name in fields}
    elif isinstance(tree, tuple):
        parts = {str(i): x for i, x in enumerate(tree)}
    else:
        parts = vars(tree)
    dot = f"{prefix}." if prefix else ""
    return {k: v for name, part in parts.items() for k, v in named(part, dot + name).items()}


def write_arrays(
    path: Path | str,
    header: dict[str, Any],
    array: dict[str, np.ndarray],
    *,
    deflated: bool = False,
) -> None:
    """A versioned .npz, `deflated` or not, moved into place when complete."""
    save = np.savez_compressed if deflated else np.savez
    with whole(path) as partial:
        with open(partial, "wb") as file:
            save(file, **{"header": np.array(json.dumps(header)), **array})  # type: ignore[arg-type]
        settle(partial)


def read_arrays(
    path: Path | str, kind: str, *versions: int
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of this kind and of one of the versions; anything else is one
    clear error."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. `gaussray reconstruct` writes one.")
    try:
        array = read_npz(path)
        text = array.pop("header", None)
        if text is None or text.dtype.kind != "U" or text.ndim:
            raise Damaged(f"{path}: has no header")
        header = parse_json(f"{path}: the header", str(text))
        if not isinstance(header, dict) or not isinstance(header.get("info", {}), dict):
            raise Damaged(f"{path}: its header is no block of keys")
    except Damaged as error:
        raise ValueError(f"{path}: is not a {kind} file or is damaged ({error}).") from error
    if header.get("format") != kind:
        raise ValueError(f"{path}: is a {header.get('format')!r:.80} file, not a {kind} file.")
    if header.get("version") not in versions:
        known = " and ".join(str(version) for version in versions)
        raise ValueError(
            f"{path}: is of version {header.get('version')!s:.80}, this gaussray reads {known}. "
            "Reconstruct the scene again or read it with the gaussray that wrote it."
        )
    return header, array
