"""From the intrinsics and the `lens` block of a capture's JSON to a lens."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from gaussray.camera import distortion
from gaussray.camera.lens import (
    POLYNOMIALS,
    PROJECTIONS,
    AbstractLens,
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FisheyePolynomial,
    FTheta,
    KannalaBrandt,
    Pinhole,
    RadialLens,
    RayTable,
    ThinPrismFisheye,
    UnifiedSphere,
    check_lens,
    limit_of,
    pinhole,
    ray_table,
    thin_prism,
)
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.ray_map import read_ray_map


PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
# camera_model -> label of a frame that has neither a lens block nor an "effect".
LENS_LABELS = {
    "OPENCV_FISHEYE": "fisheye",
    "THIN_PRISM_FISHEYE": "fisheye",
    "EQUIRECTANGULAR": "equirectangular",
}
CAMERA_MODELS = (*PERSPECTIVE, *LENS_LABELS)
INTRINSICS = (
    *("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_model"),
    *distortion.NAMES,
)
LENS_KEYS = (
    *("model", "k", "fov", "sensor_width_mm", "sensor_height_mm", "shift"),
    *("polynomial", "limit", "file", "first", "every"),
)


def lens_of(keys: Keys, dtype: DTypeLike) -> AbstractLens:
    """The `lens` block if there is one, else the lens of `camera_model`."""
    block = keys.block("lens", LENS_KEYS)
    if block is not None:
        model = block.choice("model", tuple(BLOCKS))
        lens = BLOCKS[model](keys, block, dtype)
    else:
        model = keys.choice("camera_model", CAMERA_MODELS, "PINHOLE")
        none = Keys(keys.file, {}, keys.frame, "lens.")
        lens = MODELS.get(model, _perspective)(keys, none, dtype)
    # Radial lenses' own checks, and an ideal pinhole's, already cover every picture.
    plain = isinstance(lens, Pinhole) and not lens.distorted
    if not (plain or isinstance(lens, RadialLens | FisheyePolynomial)):
        check_lens(lens, keys.count("w"), keys.count("h"))
    return lens


def _focal_and_center(keys, dtype):
    remedy = ""
    if keys.has("camera_angle_x") and not keys.has("fl_x"):
        focal = keys.count("w") / 2 / np.tan(keys.number("camera_angle_x") / 2)
        remedy = f"From camera_angle_x it is {focal:.8g}; write fl_x, fl_y, cx and cy."
    focal = [keys.number("fl_x", remedy=remedy), keys.number("fl_y")]
    return jnp.array(focal, dtype), jnp.array([keys.number("cx"), keys.number("cy")], dtype)


def _perspective(keys, block, dtype):
    k = [keys.number(key, 0.0) for key in distortion.NAMES]
    # As few as will do.
    count = next(n for n in distortion.COUNTS if not any(k[n:]))
    bent = jnp.array(k[:count], dtype) if any(k) else None
    return pinhole(*_focal_and_center(keys, dtype), bent)


def _polynomial(keys, block, dtype):
    size = [keys.count("w"), keys.count("h")]
    for key, middle in (("cx", size[0] / 2), ("cy", size[1] / 2)):
        if not block.has("shift") and abs(keys.number(key, middle) - middle) > 1e-6:
            keys.warn(f"the key {key} is ignored by lens.model {block.values['model']}: its axis "
                      "meets the picture's centre. Write lens.shift to move it.")  # fmt: skip
    sensor = [block.number("sensor_width_mm"), block.number("sensor_height_mm")]
    return FisheyePolynomial(
        coefficients=jnp.array(block.vector("k", 5), dtype),
        sensor=jnp.array(sensor, dtype),
        resolution=jnp.array(size, dtype),
        shift=jnp.array(block.vector("shift", 2, [0.0, 0.0]), dtype),
        fov=jnp.array(block.number("fov"), dtype),
    )


def _kannala_brandt(keys, block, dtype):
    k = [keys.number(key, 0.0) for key in ("k1", "k2", "k3", "k4")]
    half = block.number("fov") / 2 if block.has("fov") else _monotone_angle(k)
    return _radial(KannalaBrandt, keys, dtype, half, k)


def _thin_prism(keys, block, dtype):
    k = [keys.number(key, 0.0) for key in thin_prism.NAMES]
    radial = k[0], k[1], k[4], k[5]
    half = block.number("fov") / 2 if block.has("fov") else _monotone_angle(radial)
    return _radial(ThinPrismFisheye, keys, dtype, half, k)


def _monotone_angle(k):
    """Half angle up to which r(theta) increases, at most pi: for a file that names no fov."""
    theta = np.linspace(0, np.pi, 4097)
    slope = np.polynomial.polynomial.polyval(theta**2, [1, *np.multiply(k, (3, 5, 7, 9))])
    falls = slope <= 1e-3
    return 0.9999 * (theta[int(np.argmax(falls))] if falls.any() else np.pi)


def _radial(kind, keys, dtype, half, k):
    return kind(*_focal_and_center(keys, dtype), jnp.array(k, dtype), jnp.array(half, dtype))


def _projection(keys, block, dtype):
    half = jnp.array(block.number("fov") / 2, dtype)
    return Fisheye(*_focal_and_center(keys, dtype), half, block.text("model"))


def _f_theta(keys, block, dtype):
    kind, k = block.choice("polynomial", POLYNOMIALS), block.numbers("k")
    limit = block.number("limit", 0.0) or limit_of(k, block.number("fov") / 2, kind)
    arrays = jnp.array(k, dtype), jnp.array(limit, dtype)
    return FTheta(*_focal_and_center(keys, dtype), *arrays, kind)


def _unified(keys, block, dtype):
    enhanced = block.text("model") == "enhanced_unified_sphere"
    k = block.vector("k", 2) if enhanced else [*block.vector("k", 1), 1.0]
    return _radial(UnifiedSphere, keys, dtype, block.number("fov") / 2, k)


def _double_sphere(keys, block, dtype):
    return _radial(DoubleSphere, keys, dtype, block.number("fov") / 2, block.vector("k", 2))


def _equirectangular(keys, block, dtype):
    return Equirectangular(*_focal_and_center(keys, dtype))


def _table(keys, block, dtype):
    path = block.path("file")
    if path is None:
        raise block.error("file", "a table of directions (.npz or .exr)")
    rays = jnp.array(read_ray_map(path), dtype)
    if not (block.has("first") or block.has("every")):
        return ray_table(rays, keys.count("w"), keys.count("h"))
    every, first = (jnp.array(block.vector(key, 2), dtype) for key in ("every", "first"))
    return RayTable(every, first, rays)


Builder = Callable[[Keys, Keys, DTypeLike], AbstractLens]
# camera_model, and model of a lens block, -> what builds it.
MODELS: dict[str, Builder] = {
    "OPENCV_FISHEYE": _kannala_brandt,
    "THIN_PRISM_FISHEYE": _thin_prism,
    "EQUIRECTANGULAR": _equirectangular,
}
BLOCKS: dict[str, Builder] = {
    "blender_fisheye_polynomial": _polynomial,
    "kannala_brandt": _kannala_brandt,
    "thin_prism_fisheye": _thin_prism,
    **dict.fromkeys(PROJECTIONS, _projection),
    "f_theta": _f_theta,
    "unified_sphere": _unified,
    "enhanced_unified_sphere": _unified,
    "double_sphere": _double_sphere,
    "equirectangular": _equirectangular,
    "table": _table,
}
