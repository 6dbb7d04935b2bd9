"""Reads and writes Gaussians as OpenUSD, ParticleField3DGaussianSplat (UsdVol, OpenUSD 26.03 on).

Positions, orientations, linear scales and opacities are arrays; the harmonics of a Gaussian, in the
order and sign of 3DGS, follow one another. The layer is y up, right-handed: x and y change sign
against PLY files. A scene unit is a metre. The attribute of the harmonics states the colour space
of their colours.
"""

import warnings
from collections.abc import Sequence
from importlib import import_module
from math import isqrt
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from gaussray.io.atomic import atomic_path
from gaussray.io.safe.limits import within
from gaussray.scene.formats.gltf import transform_columns, upright_columns
from gaussray.scene.gaussians import Gaussians


PRIM = "/Gaussians"
_HARMONICS = "radiance:sphericalHarmonicsCoefficients"
_COLOR_SPACES = {"srgb": "srgb_rec709_scene", "linear": "lin_rec709_scene"}
# How far a Gaussian is seen, in standard deviations, for bounding boxes.
_EXTENT = 3
# Time codes per second; a timestamp has one time code.
_RATE = 24.0


def write_usd(path: Path | str, states: Sequence[Gaussians], color: str) -> None:
    """Write a scene at one timestamp or several, which become the time codes 0, 1, ...

    Args:
        path: the file, `.usd`, `.usdc` (binary) or `.usda` (text).
        states: the Gaussians of each timestamp, of one degree; their numbers may differ.
        color: colour space of their colours, `srgb` or `linear`.

    Raises:
        ValueError: usd-core is not installed, the ending is another, or a value is not finite.
        OSError: The file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".usd", ".usdc", ".usda"):
        raise ValueError(f"out must end in .usd, .usdc or .usda with format=usd, got {path.name}.")
    stage = _stage(path, states, color)
    with atomic_path(path) as partial:
        if not stage.GetRootLayer().Export(str(partial)):
            raise OSError(f"{path}: the USD layer cannot be written.")


def read_usd(path: Path | str) -> tuple[Gaussians, str | None]:
    """Read the Gaussians of all prims of a USD file together, with their transforms.

    The world becomes y up and then that of PLY files; a scene unit is a metre. Of time samples the
    first is read, with a warning.

    Returns:
        The Gaussians in the axes of PLY files, and the colour space that the file states, `srgb`
        or `linear`; None if it states none.

    Raises:
        ValueError: usd-core is not installed, the file is no USD file, or holds no Gaussians.
        FileNotFoundError: The file does not exist.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file.")
    Usd, UsdGeom, UsdVol = _modules()
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception:
        stage = None
    if stage is None:
        raise ValueError(f"{path}: must be a USD file. Copy it again.")
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdVol.ParticleField3DGaussianSplat)]
    if not prims:
        raise ValueError(f"{path}: must hold a prim of the type ParticleField3DGaussianSplat.")
    world = np.diag([*[UsdGeom.GetStageMetersPerUnit(stage)] * 3, 1.0])
    if UsdGeom.GetStageUpAxis(stage) == "Z":
        world = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]) @ world
    parts, spaces = [], set[str | None]()
    for prim in prims:
        first = _first_time(path, prim, Usd)
        matrix = np.array(UsdGeom.XformCache(first).GetLocalToWorldTransform(prim)).T
        *columns, opacity, space = _columns(path, prim, first)
        placed = transform_columns(tuple(columns), world @ matrix)
        if placed is None:
            raise ValueError(
                f"{path}: {prim.GetPath()} must have transforms that scale all axes alike, without "
                "mirrors. Apply the others before the export."
            )
        parts.append((*placed[:3], opacity, placed[3]))
        spaces.add(space)
    if len(spaces) > 1 or len({part[4].shape[1] for part in parts}) > 1:
        raise ValueError(f"{path}: all prims must have one colour space and one degree.")
    values = [np.concatenate(x) for x in zip(*parts, strict=True)]
    good = np.all([np.isfinite(x.reshape(len(x), -1)).all(axis=1) for x in values], axis=0)
    if not good.any():
        raise ValueError(f"{path}: at least one Gaussian must be finite, got none.")
    return Gaussians(*(jnp.asarray(x[good], jnp.float32) for x in values)), spaces.pop()


def _first_time(path: Path, prim: Any, Usd: Any) -> Any:
    """The time code at which a prim is read."""
    codes = sorted({t for a in prim.GetAttributes() for t in a.GetTimeSamples()})
    if len(codes) > 1:
        warnings.warn(
            f"{path}: {prim.GetPath()} has {len(codes)} time samples, of which the first is read.",
            stacklevel=4,
        )
    return Usd.TimeCode(codes[0]) if codes else Usd.TimeCode.Default()


def _columns(path: Path, prim: Any, when: Any) -> tuple[Any, ...]:
    """Means, quaternions x y z w, scales, harmonics [n, k, 3], opacities, and the colour space."""

    def column(name: str, width: int) -> np.ndarray:
        # Attributes of half precision end in h.
        values = [prim.GetAttribute(x).Get(when) for x in (name, f"{name}h")]
        column_values = next(
            (np.array(x, np.float64) for x in values if x is not None and len(x)), None
        )
        if column_values is None:
            raise ValueError(f"{path}: {prim.GetPath()} must have the attribute {name}.")
        return column_values.reshape(-1, width)

    mean = column("positions", 3)
    within(path, "the millions of Gaussians", len(mean), "points", 1e6)
    value = next(
        prim.GetAttribute(x).Get(when)
        for x in ("orientations", "orientationsh")
        if prim.GetAttribute(x).Get(when)
    )
    quat = np.array([[*q.GetImaginary(), q.GetReal()] for q in value], np.float64)
    scale, opacity = column("scales", 3), column("opacities", 1)[:, 0]
    harmonics = column(_HARMONICS, 3)
    each = len(harmonics) // len(mean)
    if [len(x) for x in (quat, scale, opacity)] != [len(mean)] * 3 or (
        each not in (1, 4, 9, 16) or each * len(mean) != len(harmonics)
    ):
        raise ValueError(
            f"{path}: the attributes of {prim.GetPath()} must have a value, or 1, 4, 9 or 16 "
            "harmonics, for each position."
        )
    colors = {name: color for color, name in _COLOR_SPACES.items()}
    stated = {prim.GetAttribute(x).GetColorSpace() for x in (_HARMONICS, f"{_HARMONICS}h")}
    space = next((colors[name] for name in stated if name in colors), None)
    return mean, quat, scale, harmonics.reshape(len(mean), each, 3), np.clip(opacity, 0, 1), space


def _modules() -> tuple[Any, Any, Any]:
    """The modules Usd, UsdGeom and UsdVol of OpenUSD, which fill themselves when they are imported:
    a type checker cannot see that."""
    try:
        Usd, UsdGeom, UsdVol = (import_module(f"pxr.{x}") for x in ("Usd", "UsdGeom", "UsdVol"))
        _ = UsdVol.ParticleField3DGaussianSplat
    except (ImportError, AttributeError) as error:
        raise ValueError(
            "USD needs the package usd-core from 26.3 on: pip install -e '.[usd]', or choose "
            "another format."
        ) from error
    return Usd, UsdGeom, UsdVol


def _stage(path: Path, states: Sequence[Gaussians], color: str) -> Any:
    """The stage with one prim."""
    Usd, UsdGeom, UsdVol = _modules()
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(_RATE)
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
    stage.SetDefaultPrim(prim.GetPrim())
    degree = isqrt(states[0].harmonics.shape[1]) - 1
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(degree)
    prim.CreateSortingModeHintAttr("rayHitDistance")
    if len(states) > 1:
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(states) - 1)
    for code, gaussians in enumerate(states):
        when = Usd.TimeCode(code) if len(states) > 1 else Usd.TimeCode.Default()
        for name, values in _values(path, gaussians).items():
            attribute = getattr(prim, f"Create{name}Attr")()
            attribute.Set(values, when)
    prim.GetRadianceSphericalHarmonicsCoefficientsAttr().SetColorSpace(_COLOR_SPACES[color])
    return stage


def _values(path: Path, gaussians: Gaussians) -> dict[str, Any]:
    """The arrays of one timestamp, by the names of their attributes."""
    Vt = import_module("pxr.Vt")
    columns = upright_columns(gaussians)
    if not all(np.isfinite(x).all() for x in columns) or not len(columns[0]):
        raise ValueError(f"{path}: all values of at least one Gaussian must be finite.")
    mean, turned, scale, opacity, harmonics = columns
    reach = _EXTENT * scale.max(axis=1, keepdims=True)
    extent = np.stack([(mean - reach).min(axis=0), (mean + reach).max(axis=0)])
    return {
        "Positions": Vt.Vec3fArray.FromNumpy(mean),
        "Orientations": Vt.QuatfArray.FromNumpy(turned),
        "Scales": Vt.Vec3fArray.FromNumpy(scale),
        "Opacities": Vt.FloatArray.FromNumpy(np.ascontiguousarray(opacity[:, 0])),
        "RadianceSphericalHarmonicsCoefficients": Vt.Vec3fArray.FromNumpy(
            np.ascontiguousarray(harmonics.reshape(-1, 3))
        ),
        "Extent": Vt.Vec3fArray.FromNumpy(extent),
    }
