"""Reads and writes Gaussians in the PLY format of 3D Gaussian Splatting (Kerbl et al. 2023).

Element `vertex`, binary little-endian, all float32, in the order x y z nx ny nz f_dc_0..2
f_rest_0..(3 C - 1) opacity scale_0..2 rot_0..3. With L the degree of the harmonics, C = (L+1)^2 - 1
and f_rest is channel-major: C coefficients of red, then of green, then of blue. The file holds
unconstrained values: opacity = sigmoid(stored), scale = exp(stored), and rot is a quaternion
(w, x, y, z) of any length. The colour is max(0, 1/2 + sum c_i Y_i), with the harmonics of
`scene.harmonics` in their order and sign; the file does not say whether that is linear light.
Normals are dummies.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from gaussray.io.atomic import atomic_path
from gaussray.io.ply import read_vertices
from gaussray.scene.gaussians import Gaussians, Unconstrained


MEAN, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
CONSTANT = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALE, QUAT = ("scale_0", "scale_1", "scale_2"), ("rot_0", "rot_1", "rot_2", "rot_3")
# Numbers of f_rest for the harmonics of degree 0 to 3.
RESTS = (0, 9, 24, 45)

_FLOAT = np.finfo(np.float32)
# A rounding step above what JAX takes for 0, and below 1.
_ABOVE_ZERO, _BELOW_ONE = 2 * _FLOAT.tiny, 1 - _FLOAT.epsneg


def read_gaussians(path: Path | str) -> Gaussians:
    """Read the Gaussians of a PLY file, in physical values and single precision.

    The file may be ASCII or binary, with properties in any order; normals and unknown properties
    are ignored. Quaternions are normalised; a zero one becomes the identity. Gaussians with a value
    that is not finite, or with a scale out of the range of single precision, are dropped with a
    warning.

    Raises:
        ValueError: a property is missing, f_rest is not of degree 0 to 3, the file is truncated, or
            no Gaussian is left; the message names file and property.
        FileNotFoundError: the file does not exist.
    """
    mean, quat, scale, logit, harmonics = model_columns(path)[:5]
    with np.errstate(over="ignore"):
        opacity = 1 / (1 + np.exp(-logit))
    parts = mean, unit_quaternions(quat), np.exp(scale), opacity, harmonics
    return Gaussians(*(jnp.asarray(part, jnp.float32) for part in parts))


def read_unconstrained(path: Path | str) -> Unconstrained:
    """Read the Gaussians of a PLY file in unconstrained values: log scale, logit of opacity,
    quaternions of any length, also zero."""
    return Unconstrained(*(jnp.asarray(part, jnp.float32) for part in model_columns(path)[:5]))


def model_columns(path: Path | str, more: tuple[str, ...] = ()) -> tuple[np.ndarray, ...]:
    """Columns of the valid Gaussians of a PLY file.

    Args:
        path: the file.
        more: names of further properties.

    Returns:
        Mean, quaternion, log scale, logit of opacity, harmonics, and the further properties
        [gaussians, properties].

    Raises:
        ValueError: As `read_gaussians`.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file. Name the PLY file of a model.")
    table = read_vertices(path)
    rest = _rest_names(path, table.dtype.names or (), more)
    first = _columns(table, CONSTANT, np.float32)[:, None, :]
    others = _columns(table, rest, np.float32).reshape(len(table), 3, len(rest) // 3).swapaxes(1, 2)
    scale = _columns(table, SCALE)
    parts = (
        _columns(table, MEAN, np.float32),
        _columns(table, QUAT),
        scale,
        _columns(table, ("opacity",))[:, 0],
        np.concatenate([first, others], axis=1),
        _columns(table, more),
    )
    # Scales beyond the range of single precision become infinite, and are counted as invalid.
    with np.errstate(over="ignore", under="ignore"):
        size = np.exp(scale).astype(np.float32)
    valid = (size.min(axis=1) >= _FLOAT.tiny) & np.isfinite(size).all(axis=1)
    for part in parts:
        valid &= np.isfinite(part).all(axis=tuple(range(1, part.ndim)))
    demand_valid(path, valid)
    return tuple(part[valid] for part in parts)


def write_gaussians(
    path: Path | str,
    gaussians: Gaussians,
    *,
    more: Mapping[str, Float[np.ndarray, " gaussians"]] | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write Gaussians as a PLY file, atomically.

    The number of f_rest properties follows from the harmonics. Opacity is kept one step of single
    precision above 0 and below 1, and scale above 0, so that logit and log are finite. Values read
    back differ by rounding: relatively by about |log scale| and |logit opacity| units in the last
    place.

    Args:
        path: the file.
        gaussians: the Gaussians.
        more: further properties, by name.
        comments: lines of the header.

    Raises:
        ValueError: the Gaussians have a tint or several key states, for which the format has no
            place, or a value is not finite.
        OSError: the file cannot be written.
    """
    if gaussians.tint is not None or gaussians.mean.ndim != 2:
        raise ValueError(
            f"{path}: a PLY file must hold Gaussians at one instant and without tint. Fold the "
            "tint into the harmonics first, as `gaussray export` does."
        )
    coefficients = gaussians.harmonics.shape[1]
    if 3 * (coefficients - 1) not in RESTS:
        raise ValueError(f"{path}: harmonics must be 1, 4, 9 or 16, got {coefficients}.")
    values = _file_columns(gaussians)
    values |= {name: np.asarray(column)[:, None] for name, column in (more or {}).items()}
    for name, value in values.items():
        if not np.isfinite(value).all():
            raise ValueError(f"{path}: {name} must be finite to be written, got NaN or infinity.")
    table = np.concatenate(list(values.values()), axis=1, dtype="<f4")
    names = [*MEAN, *NORMAL, *CONSTANT, *(f"f_rest_{i}" for i in range(3 * (coefficients - 1)))]
    names += ["opacity", *SCALE, *QUAT, *(more or {})]
    head = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    head.append(f"element vertex {len(table)}")
    head += [*(f"property float {name}" for name in names), "end_header", ""]
    try:
        with atomic_path(path) as partial, open(partial, "wb") as file:
            file.write("\n".join(head).encode("ascii"))
            table.tofile(file)
    except OSError as error:
        raise OSError(f"{path}: cannot be written: {error}") from error


def _file_columns(gaussians: Gaussians) -> dict[str, Float[np.ndarray, "gaussians _"]]:
    """The columns of the file in their order, by quantity."""
    mean, quat, scale, opacity, harmonics = (
        np.asarray(x, np.float64)
        for x in (
            gaussians.mean,
            gaussians.quat,
            gaussians.scale,
            gaussians.opacity,
            gaussians.harmonics,
        )
    )
    opacity = np.clip(opacity, _ABOVE_ZERO, _BELOW_ONE)[:, None]
    rest = 3 * (harmonics.shape[1] - 1)
    return {
        "mean": mean,
        "normal": np.zeros_like(mean),
        "harmonics": harmonics[:, 0],
        "higher harmonics": harmonics[:, 1:].swapaxes(1, 2).reshape(len(mean), rest),
        "opacity": np.log(opacity) - np.log1p(-opacity),
        "scale": np.log(np.maximum(scale, _ABOVE_ZERO)),
        "quat": unit_quaternions(quat),
    }


def unit_quaternions(
    quat: Float[np.ndarray, "gaussians 4"],
) -> Float[np.ndarray, "gaussians 4"]:
    """Quaternions of unit length; zero becomes the identity."""
    largest = np.max(np.abs(quat), axis=1, keepdims=True)
    # Quaternions that are not finite are counted later; no warning here.
    with np.errstate(invalid="ignore"):
        scaled = quat / np.where(largest > 0, largest, 1)
        unit = scaled / np.linalg.norm(scaled, axis=1, keepdims=True).clip(min=1)
    return np.where(largest == 0, np.array([1.0, 0, 0, 0]), unit)


def _columns(
    table: np.ndarray, names: tuple[str, ...], kind: type = np.float64
) -> Float[np.ndarray, "gaussians _"]:
    columns = np.empty((len(table), len(names)), kind)
    with np.errstate(over="ignore"):
        for i, name in enumerate(names):
            columns[:, i] = table[name]
    return columns


def demand_valid(path: Path | str, valid: Bool[np.ndarray, " gaussians"]) -> None:
    """Refuse a file without a finite Gaussian; warn of how many are dropped.

    Args:
        path: the file, for the message.
        valid: which Gaussians are finite.

    Raises:
        ValueError: None is.
    """
    bad = int((~valid).sum())
    if bad == len(valid):
        raise ValueError(
            f"{path}: at least one Gaussian must be finite, got none of {len(valid)}. Export the "
            "model again."
        )
    if bad:
        warnings.warn(
            f"{path}: {bad} of {len(valid)} Gaussians are not finite in single precision and are "
            "dropped.",
            stacklevel=4,
        )


def _rest_names(path: Path, names: tuple[str, ...], more: tuple[str, ...]) -> tuple[str, ...]:
    """The properties f_rest in order; checks that all other properties exist."""
    missing = [x for x in (*MEAN, *CONSTANT, "opacity", *SCALE, *QUAT, *more) if x not in names]
    if missing:
        raise ValueError(
            f"{path}: element vertex must have the property {missing[0]}, got none. A model of 3D "
            "Gaussian Splatting has x y z f_dc_* opacity scale_* rot_*; export it so."
        )
    numbers = sorted(int(m[1]) for name in names if (m := re.fullmatch(r"f_rest_(\d+)", name)))
    if len(numbers) not in RESTS:
        raise ValueError(
            f"{path}: the properties f_rest must be 0, 9, 24 or 45 (degree 0 to 3), got "
            f"{len(numbers)}. Export the model with harmonics of degree 3 at most."
        )
    rest = tuple(f"f_rest_{i}" for i in range(len(numbers)))
    missing = [name for name in rest if name not in names]
    if missing:
        raise ValueError(
            f"{path}: the properties f_rest must be numbered from 0 without gaps, got no "
            f"{missing[0]}. Export the model again."
        )
    return rest
