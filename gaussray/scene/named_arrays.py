"""Scenes from named arrays, and the names of a scene's arrays.

The name of an array is its path in the `Scene`: `static.mean`, `deformation.planes.space.0`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from gaussray.scene.bodies import Bodies
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.deformation import HEADS, Deformation, Layer
from gaussray.scene.gaussians import HARMONIC_COUNTS, Gaussians
from gaussray.scene.light import Light
from gaussray.scene.planes import Planes
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.scene import Scene
from gaussray.scene.shading import Shading
from gaussray.scene.shape_check import shape_error
from gaussray.scene.transient import Transients


# Shapes of the arrays behind the axis of the Gaussians; harmonics come besides.
_Shapes = dict[str, tuple[int, ...]]
_OF_GAUSSIANS: _Shapes = {"mean": (3,), "quat": (4,), "scale": (3,), "opacity": ()}
_OF_TRANSIENTS = _OF_GAUSSIANS | {"velocity": (3,), "instant": (), "lifetime": (), "plateau": ()}
RESIDUAL_HEADS = ("mean", "rotation", "scale", "opacity", "harmonics")


def named_arrays(tree: Any, prefix: str = "") -> dict[str, np.ndarray]:
    """Every array of a tree of modules and tuples, by its path in the tree.

    Args:
        tree: a module such as `Scene`, a tuple, an array, a bool or None (which has no arrays).
        prefix: path of `tree` itself.
    """
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
    return {k: v for name, part in parts.items() for k, v in named_arrays(part, dot + name).items()}


def scene_from(
    array: dict[str, np.ndarray],
    path: Path,
    *,
    residuals: bool = False,
    required_heads: Sequence[str] = HEADS,
) -> Scene:
    """Build a scene from its named arrays and check that they fit together.

    Args:
        array: the arrays by name.
        path: the file that they come from, for messages.
        residuals: whether the scene moves by a `ResidualField` instead of a `Deformation`.
        required_heads: the heads that a `Deformation` must have; others may be missing.

    Raises:
        ValueError: an array is missing, not finite, or of a wrong shape.
    """
    if residuals:
        deformation = _residual_field(array, "deformation", path)
    else:
        deformation = deformation_from(array, "deformation", path, required_heads)
        control = None if deformation is None else deformation.control
        if control is not None and not (control.radius.size and (control.radius > 0).all()):
            raise ValueError(
                f"{path}: the array 'deformation.control.radius' must hold numbers above 0; the "
                "scene is damaged."
            )
    time_range = _array(array, "time_range", path)
    times = np.asarray(time_range)
    if times.shape != (2,) or not times[0] <= times[1]:
        raise ValueError(
            f"{path}: the array 'time_range' must hold two times, the earlier one first, got "
            f"{str(times)[:80]}; the scene is damaged."
        )
    static, moving = (_gaussians(array, prefix, path) for prefix in ("static", "moving"))
    parts = _transients(array, path), _light(array, path), _shading(array, path)
    scene = Scene(static, moving, deformation, time_range, *parts)
    wrong = shape_error(scene)
    if wrong:
        raise ValueError(f"{path}: its arrays do not fit together ({wrong}); the scene is damaged.")
    return scene


def deformation_from(
    array: dict[str, np.ndarray], prefix: str, path: Path, required_heads: Sequence[str] = HEADS
) -> Deformation | None:
    """Build a deformation from its named arrays; None if there are no such arrays.

    Args:
        array: the arrays by name.
        prefix: path of the deformation in these names.
        path: the file that they come from, for messages.
        required_heads: the heads that it must have; others may be missing.

    Raises:
        ValueError: an array is missing.
    """
    if not any(name.startswith(f"{prefix}.") for name in array):
        return None

    def head(name: str) -> tuple[Layer, Layer] | None:
        absent = not any(x.startswith(f"{prefix}.{name}.") for x in array)
        if absent and name not in required_heads:
            return None
        return _head(array, f"{prefix}.{name}", path)

    names = ("pivot", "radius", "time", "path", "turn")
    bodies = Bodies(*(_array(array, f"{prefix}.bodies.{name}", path) for name in names))
    control = None
    if any(name.startswith(f"{prefix}.control.") for name in array):
        control = ControlPoints(*(_array(array, f"{prefix}.control.{n}", path) for n in names))
    return Deformation(
        bodies,
        _planes(array, f"{prefix}.planes", path),
        _layer(array, f"{prefix}.trunk", path),
        mean=head("mean"),
        rotation=head("rotation"),
        scale=head("scale"),
        tint=head("tint"),
        light=_array(array, f"{prefix}.light", path),
        control=control,
    )


def _gaussians(array: dict[str, np.ndarray], prefix: str, path: Path) -> Gaussians:
    return Gaussians(**_rows(array, prefix, path, _OF_GAUSSIANS))


def _transients(array: dict[str, np.ndarray], path: Path) -> Transients | None:
    if not any(name.startswith("transient.") for name in array):
        return None
    values = _rows(array, "transient", path, _OF_TRANSIENTS)
    lifetime, plateau = (np.asarray(values[name]) for name in ("lifetime", "plateau"))
    if not (lifetime > 0).all() or not (plateau >= 0).all():
        raise ValueError(
            f"{path}: the array 'transient.lifetime' must be above 0 and 'transient.plateau' at "
            "least 0; the scene is damaged."
        )
    return Transients(**values)


def _light(array: dict[str, np.ndarray], path: Path) -> Light | None:
    if not any(name.startswith("light.") for name in array):
        return None
    time, gain = (_array(array, f"light.{name}", path) for name in ("time", "gain"))
    fits = time.ndim == 1 and time.size and gain.shape == (time.size, 3)
    if not fits or (np.diff(time) <= 0).any() or not (np.asarray(gain) > 0).all():
        raise ValueError(
            f"{path}: the array 'light.time' must increase and 'light.gain' hold three numbers "
            "above 0 for each time; the scene is damaged."
        )
    return Light(time, gain)


def _shading(array: dict[str, np.ndarray], path: Path) -> Shading | None:
    names = Shading.__dataclass_fields__
    if not any(name.startswith("shading.") for name in array):
        return None
    lower, upper, time, gain = (_array(array, f"shading.{name}", path) for name in names)
    box = lower.shape == upper.shape == (3,) and bool(np.all(np.asarray(upper) > lower))
    fits = time.ndim == 1 and time.size and gain.ndim == 4 and gain.shape[0] == time.size
    fits = fits and min(gain.shape[1:]) > 1
    if not (box and fits) or (np.diff(time) <= 0).any():
        raise ValueError(
            f"{path}: 'shading' must hold a box from 'lower' to 'upper', increasing times and as "
            "many grids in 'log_gain'; the scene is damaged."
        )
    return Shading(lower, upper, time, gain)


def _rows(
    array: dict[str, np.ndarray], prefix: str, path: Path, shapes: _Shapes
) -> dict[str, Array]:
    """Arrays of as many rows each, of these shapes behind the first axis, and harmonics."""
    fields = (*shapes, "harmonics")
    values = {field: _array(array, f"{prefix}.{field}", path) for field in fields}
    rows = {field: value.shape[:1] for field, value in values.items()}
    if len(set(rows.values())) != 1:
        raise ValueError(f"{path}: the arrays of '{prefix}' differ in length: {rows}.")
    coefficients = values["harmonics"].shape[1:2]
    if coefficients and coefficients[0] not in HARMONIC_COUNTS:
        raise ValueError(
            f"{path}: the array '{prefix}.harmonics' must hold 1, 4, 9 or 16 coefficients, got "
            f"{coefficients[0]}; the scene is damaged."
        )
    expected = shapes | {"harmonics": (*coefficients, 3)}
    for field, value in values.items():
        if value.shape[1:] != expected[field]:
            raise ValueError(
                f"{path}: the array '{prefix}.{field}' has the shape {value.shape} instead of "
                f"{value.shape[:1] + expected[field]}; the scene is damaged."
            )
    return values


def _residual_field(array: dict[str, np.ndarray], prefix: str, path: Path) -> ResidualField:
    depth = len({x.split(".")[2] for x in array if x.startswith(f"{prefix}.trunk.")})

    def head(name: str) -> tuple[Layer, Layer] | None:
        absent = not any(x.startswith(f"{prefix}.{name}.") for x in array)
        return None if absent else _head(array, f"{prefix}.{name}", path)

    heads = [head(name) for name in RESIDUAL_HEADS]
    planes = _planes(array, f"{prefix}.planes", path)
    trunk = tuple(_layer(array, f"{prefix}.trunk.{i}", path) for i in range(max(depth, 1)))
    logit, encoded = f"{prefix}.logit_opacity", _array(array, f"{prefix}.encoded", path)
    at_rest = _array(array, logit, path) if logit in array else None
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
    scales = range(sum(name.startswith(f"{prefix}.space.") for name in array))
    lower, upper, begin, end = (
        _array(array, f"{prefix}.{name}", path) for name in ("lower", "upper", "begin", "end")
    )
    return Planes(
        space=tuple(_array(array, f"{prefix}.space.{i}", path) for i in scales),
        time=tuple(_array(array, f"{prefix}.time.{i}", path) for i in scales),
        lower=lower,
        upper=upper,
        begin=begin,
        end=end,
    )


def _head(array: dict[str, np.ndarray], prefix: str, path: Path) -> tuple[Layer, Layer]:
    return _layer(array, f"{prefix}.0", path), _layer(array, f"{prefix}.1", path)


def _layer(array: dict[str, np.ndarray], prefix: str, path: Path) -> Layer:
    return Layer(*(_array(array, f"{prefix}.{name}", path) for name in ("weight", "bias")))


def _array(array: dict[str, np.ndarray], name: str, path: Path) -> Array:
    if name not in array:
        raise ValueError(f"{path}: the array '{name}' is missing; the file is not whole.")
    if array[name].dtype.kind not in "fb":
        raise ValueError(
            f"{path}: the array '{name}' must hold real numbers, got {array[name].dtype}; the "
            "scene is damaged."
        )
    if not np.isfinite(array[name]).all():
        raise ValueError(f"{path}: the array '{name}' must be finite; the scene is damaged.")
    # Its own memory: nothing else refers to what was read.
    return jax.device_put(array[name])
