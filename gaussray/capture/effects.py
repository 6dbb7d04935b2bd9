"""From the blocks of a capture's JSON to the parts of a camera."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.aperture import FOCUS, Aperture
from gaussray.camera.film import FILTERS, Film
from gaussray.camera.lens import (
    AbstractLens,
    FisheyePolynomial,
    KannalaBrandt,
    Pinhole,
    check_lens,
    pinhole,
)
from gaussray.camera.shutter import DIRECTIONS, Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.keys import Keys
from gaussray.geometry import BLENDER_AXES, quaternion


PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
CAMERA_MODELS = (*PERSPECTIVE, "OPENCV_FISHEYE")
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
LENS_MODELS = ("blender_fisheye_polynomial", "kannala_brandt")
LENS_KEYS = ("model", "k", "sensor_width_mm", "sensor_height_mm", "fov", "shift")
INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_model", *DISTORTION)
# block -> label of a frame that has the block but no "effect"
LABELS = {
    "lens": "fisheye",
    "aperture": "depth_of_field",
    "shutter": "rolling_shutter",
    "trajectory": "camera_motion",
}


def film_of(keys: Keys) -> Film:
    """Size of the picture, and its pixel filter if a `film` block names one."""
    block = keys.block("film", ("filter", "filter_width"))
    size = keys.count("w"), keys.count("h")
    if block is None:
        return Film(*size)
    default = Film(*size)
    kind = block.choice("filter", FILTERS, default.filter)
    return Film(*size, kind, block.number("filter_width", default.filter_width))


def lens_of(keys: Keys, dtype: DTypeLike) -> AbstractLens:
    """The `lens` block if there is one, else the lens of `camera_model`."""
    block = keys.block("lens", LENS_KEYS)
    model = block.choice("model", LENS_MODELS) if block else ""
    if block and model == "blender_fisheye_polynomial":
        lens = _polynomial(keys, block, dtype)
    elif model == "kannala_brandt" or keys.values.get("camera_model") == "OPENCV_FISHEYE":
        lens = _kannala_brandt(keys, block, dtype)
    else:
        keys.choice("camera_model", CAMERA_MODELS, "PINHOLE")
        distortion = [keys.number(key, 0.0) for key in DISTORTION]
        lens = pinhole(
            *_focal_and_center(keys, dtype),
            jnp.array(distortion, dtype) if any(distortion) else None,
        )
    # The fisheyes' own checks already cover the whole picture; a distortion may fold it anywhere.
    if isinstance(lens, Pinhole) and lens.distorted:
        check_lens(lens, keys.count("w"), keys.count("h"))
    return lens


def _focal_and_center(keys, dtype):
    remedy = ""
    if keys.has("camera_angle_x") and not keys.has("fl_x"):
        focal = keys.count("w") / 2 / np.tan(keys.number("camera_angle_x") / 2)
        remedy = f"From camera_angle_x it is {focal:.8g}; write fl_x, fl_y, cx and cy."
    focal = [keys.number("fl_x", remedy=remedy), keys.number("fl_y")]
    return jnp.array(focal, dtype), jnp.array([keys.number("cx"), keys.number("cy")], dtype)


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
    half = block.number("fov") / 2 if block and block.has("fov") else _monotone_angle(k)
    return KannalaBrandt(
        *_focal_and_center(keys, dtype),
        coefficients=jnp.array(k, dtype),
        max_angle=jnp.array(half, dtype),
    )


def _monotone_angle(k):
    """Half angle up to which r(theta) increases, at most pi: for a file that names no fov."""
    theta = np.linspace(0, np.pi, 4097)
    slope = np.polynomial.polynomial.polyval(theta**2, [1, *np.multiply(k, (3, 5, 7, 9))])
    falls = slope <= 1e-3
    return 0.9999 * (theta[int(np.argmax(falls))] if falls.any() else np.pi)


def aperture_of(keys: Keys, dtype: DTypeLike) -> Aperture:
    """The `aperture` block; without one, a pinhole."""
    known = ("radius", "focus_distance", "focus", "blades", "rotation", "ratio")
    block = keys.block("aperture", known)
    if block is None:
        block = Keys(keys.file, {"radius": 0, "focus_distance": 1}, keys.frame, "aperture.")
    distance = block.values.get("focus_distance")
    distance = np.inf if distance == "infinity" else block.number("focus_distance")
    return Aperture(
        radius=jnp.array(block.number("radius"), dtype),
        focus_distance=jnp.array(distance, dtype),
        rotation=jnp.array(block.number("rotation", 0.0), dtype),
        ratio=jnp.array(block.number("ratio", 1.0), dtype),
        blades=block.count("blades", 0, least=0),
        focus=block.choice("focus", FOCUS, "plane"),
    )


def shutter_of(keys: Keys, dtype: DTypeLike) -> Shutter:
    """The `shutter` block; without one, all rows at one instant."""
    block = keys.block("shutter", ("row_offset", "row_step", "exposure", "direction"))
    block = block or Keys(keys.file, {}, keys.frame, "shutter.")
    return Shutter(
        row_offset=jnp.array(block.number("row_offset", 0.0), dtype),
        row_step=jnp.array(block.number("row_step", 0.0), dtype),
        exposure=jnp.array(block.number("exposure", 0.0), dtype),
        direction=block.choice("direction", DIRECTIONS, "top_to_bottom"),
    )


def trajectory_of(keys: Keys, dtype: DTypeLike) -> Trajectory:
    """The `trajectory` block: poses at the capture's times."""
    value = keys.values["trajectory"]
    if not isinstance(value, list) or not value:
        raise keys.error("trajectory", "a list of at least one {time, transform_matrix}")
    times, poses = [], []
    for k, entry in enumerate(value):
        pose = Keys(keys.file, {f"trajectory[{k}]": entry}, keys.frame)
        block = pose.block(f"trajectory[{k}]", ("time", "transform_matrix"))
        if block is None:
            raise pose.error(f"trajectory[{k}]", "a block with time and transform_matrix")
        times.append(block.number("time"))
        poses.append(block.pose())
    poses = np.stack(poses)
    quat = quaternions(poses, dtype)
    return Trajectory(jnp.array(times, dtype), quat, jnp.array(poses[:, :, 3], dtype))


def quaternions(poses: np.ndarray, dtype: DTypeLike) -> Float[Array, "poses 4"]:
    """world_from_camera rotations, in our camera axes, of camera-to-world matrices in OpenGL's."""
    ours = poses[:, :, :3] * np.array(BLENDER_AXES)[None, None]
    return jax.vmap(quaternion)(jnp.asarray(ours)).astype(dtype)
