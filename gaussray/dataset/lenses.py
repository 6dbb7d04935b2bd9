"""What a capture's JSON says of a lens."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.camera import distortion
from gaussray.camera.lens import (
    AbstractLens,
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FisheyePolynomial,
    FocalLens,
    FTheta,
    KannalaBrandt,
    Pinhole,
    RayTable,
    ThinPrismFisheye,
    UnifiedSphere,
    thin_prism,
)
from gaussray.io.atomic import whole


def lens_keys(lens: AbstractLens) -> dict[str, Any]:
    """The keys from which `capture` builds the same lens, bit by bit."""
    match lens:
        case Pinhole():
            k = dict(zip(distortion.NAMES, plain(lens.distortion), strict=False))
            used = {key: value for key, value in k.items() if value != 0}
            return {"camera_model": "OPENCV" if used else "PINHOLE", **_intrinsics(lens), **used}
        case Equirectangular():
            return {"camera_model": "EQUIRECTANGULAR", **_intrinsics(lens)}
        case KannalaBrandt():
            k = dict(zip(("k1", "k2", "k3", "k4"), plain(lens.coefficients), strict=True))
            block = {"model": "kannala_brandt", "fov": plain(2 * lens.max_angle)}
            return {"camera_model": "OPENCV_FISHEYE", **_intrinsics(lens), **k, "lens": block}
        case ThinPrismFisheye():
            k = dict(zip(thin_prism.NAMES, plain(lens.coefficients), strict=True))
            block = {"model": "thin_prism_fisheye", "fov": plain(2 * lens.max_angle)}
            return {"camera_model": "THIN_PRISM_FISHEYE", **_intrinsics(lens), **k, "lens": block}
        case FisheyePolynomial():
            return {"lens": _polynomial(lens)}
        case RayTable():
            first, every = plain(lens.center), plain(lens.focal)
            table = {"model": "table", "file": _table(lens), "first": first, "every": every}
            return {"lens": table}
        case FocalLens():
            return {**_intrinsics(lens), "lens": _block(lens)}
        case _:
            raise TypeError(f"the manifest has no words for a lens of type {type(lens).__name__}.")


def write_tables(folder: Path, lenses: Sequence[AbstractLens]) -> None:
    """The tables of rays that `lens_keys` names, into the manifest's folder."""
    for name, rays in {_table(x): x.rays for x in lenses if isinstance(x, RayTable)}.items():
        with whole(folder / name) as partial:
            np.savez_compressed(partial, rays=np.asarray(rays))


def _block(lens: FocalLens) -> dict[str, Any]:
    match lens:
        case Fisheye():
            return {"model": lens.projection, "fov": plain(2 * lens.max_angle)}
        case FTheta():
            k, limit = plain(lens.coefficients), plain(lens.limit)
            return {"model": "f_theta", "polynomial": lens.polynomial, "k": k, "limit": limit}
        case UnifiedSphere():
            k, fov = plain(lens.coefficients), plain(2 * lens.max_angle)
            return {"model": "enhanced_unified_sphere", "k": k, "fov": fov}
        case DoubleSphere():
            k, fov = plain(lens.coefficients), plain(2 * lens.max_angle)
            return {"model": "double_sphere", "k": k, "fov": fov}
        case _:
            raise TypeError(f"the manifest has no words for a lens of type {type(lens).__name__}.")


def _polynomial(lens: FisheyePolynomial) -> dict[str, Any]:
    sensor, shift = plain(lens.sensor), plain(lens.shift)
    block = {
        "model": "blender_fisheye_polynomial",
        "k": plain(lens.coefficients),
        "sensor_width_mm": sensor[0],
        "sensor_height_mm": sensor[1],
        "fov": plain(lens.fov),
    }
    return {**block, "shift": shift} if any(shift) else block


def _intrinsics(lens: FocalLens) -> dict[str, float]:
    (fl_x, fl_y), (cx, cy) = plain(lens.focal), plain(lens.center)
    return {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy}


def _table(lens: RayTable) -> str:
    """Name of a table's file, by what it holds."""
    return f"lens_{hashlib.sha256(np.asarray(lens.rays).tobytes()).hexdigest()[:12]}.npz"


def plain(value: Any) -> Any:
    """Python numbers, each the shortest that gives back the same bits in the value's dtype."""
    array = np.asarray(value)
    return [plain(v) for v in array] if array.ndim else float(str(array[()])) + 0.0
