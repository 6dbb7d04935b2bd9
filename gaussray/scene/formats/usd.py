"""Writes Gaussians as OpenUSD, a ParticleField3DGaussianSplat (UsdVol, from OpenUSD 26.03 on).

Positions, orientations, linear scales and opacities are arrays; the harmonics of a Gaussian, in the
order and sign of 3DGS, follow one another. The layer is y up, right-handed: x and y change sign
against PLY files. A scene unit is a metre. The attribute of the harmonics states the colour space
of their colours.
"""

from collections.abc import Sequence
from importlib import import_module
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.io.atomic import whole
from gaussray.scene.formats.gltf import upright_columns
from gaussray.scene.gaussians import Gaussians


PRIM = "/Gaussians"
_COLOR_SPACES = {"srgb": "srgb_rec709_scene", "linear": "lin_rec709_scene"}
# How far a Gaussian is seen, in standard deviations, for bounding boxes.
_EXTENT = 3
# Time codes per second; a timestamp has one time code.
_RATE = 24.0


def write_usd(path: Path | str, states: Sequence[Gaussians], color: str) -> None:
    """Write a scene at one timestamp or several, which become the time codes 0, 1, ...

    Args:
        path: The file, `.usd`, `.usdc` (binary) or `.usda` (text).
        states: The Gaussians of each timestamp, of one degree; their numbers may differ.
        color: Colour space of their colours, `srgb` or `linear`.

    Raises:
        ValueError: usd-core is not installed, the ending is another, or a value is not finite.
        OSError: The file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".usd", ".usdc", ".usda"):
        raise ValueError(f"out must end in .usd, .usdc or .usda with format=usd, got {path.name}.")
    stage = _stage(path, states, color)
    with whole(path) as partial:
        if not stage.GetRootLayer().Export(str(partial)):
            raise OSError(f"{path}: the USD layer cannot be written.")


# The modules of OpenUSD fill themselves when they are imported, which a type checker cannot see.
def _stage(path: Path, states: Sequence[Gaussians], color: str) -> Any:
    """The stage with one prim."""
    try:
        Usd, UsdGeom, UsdVol = (import_module(f"pxr.{x}") for x in ("Usd", "UsdGeom", "UsdVol"))
        schema = UsdVol.ParticleField3DGaussianSplat
    except (ImportError, AttributeError) as error:
        raise ValueError(
            "format=usd needs the package usd-core from 26.3 on: pip install -e '.[usd]', or "
            "choose another format."
        ) from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(_RATE)
    prim = schema.Define(stage, PRIM)
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
