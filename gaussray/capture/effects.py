"""From the blocks of a capture's JSON to the parts of a camera."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.aperture import EASES, FOCUS, Aperture, FocusPull, Rim
from gaussray.camera.film import FILTERS, Film
from gaussray.camera.lens import (
    AbstractLens,
    FisheyePolynomial,
    KannalaBrandt,
    Pinhole,
    check_lens,
    pinhole,
)
from gaussray.camera.shake import Shake
from gaussray.camera.shutter import DIRECTIONS, Shutter, check_shutter, row_count, step_of
from gaussray.camera.trajectory import INTERPOLATIONS, Trajectory
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
    known = ("radius", "focus_distance", "focus", "blades", "rotation", "ratio", "rim")
    block = keys.block("aperture", known)
    if block is None:
        block = Keys(keys.file, {"radius": 0, "focus_distance": 1}, keys.frame, "aperture.")
    return Aperture(
        radius=jnp.array(block.number("radius"), dtype),
        focus_distance=_focus(block, dtype),
        rotation=jnp.array(block.number("rotation", 0.0), dtype),
        ratio=jnp.array(block.number("ratio", 1.0), dtype),
        blades=block.count("blades", 0, least=0),
        focus=block.choice("focus", FOCUS, "plane"),
        rim=_rim(block, dtype),
    )


def _focus(keys, dtype):
    """A distance, "infinity", or knots {time, distance, ease}."""
    value = keys.values.get("focus_distance")
    if not isinstance(value, dict):
        distance = np.inf if value == "infinity" else keys.number("focus_distance")
        return jnp.array(distance, dtype)
    block = keys.block("focus_distance", ("time", "distance", "ease")) or keys
    told = block.values.get("distance")
    far = [x == "infinity" for x in told] if isinstance(told, list) else []
    # Any number stands for infinity, which JSON has no number for, while the others are checked.
    near = [1.0 if x else told[i] for i, x in enumerate(far)] or told
    checked = dataclasses.replace(block, values={**block.values, "distance": near})
    distance = np.where(far, np.inf, checked.series("distance"))
    ease = block.choice("ease", EASES, "linear")
    return FocusPull(jnp.array(block.series("time"), dtype), jnp.array(distance, dtype), ease)


def _rim(keys, dtype):
    block = keys.block("rim", ("radius", "distance"))
    if block is None:
        return None
    return Rim(*(jnp.array(block.number(key), dtype) for key in ("radius", "distance")))


def shutter_of(keys: Keys, dtype: DTypeLike) -> Shutter:
    """The `shutter` block; without one, all rows at one instant.

    `readout`, from the first to the last row, may stand for `row_step`; without a `row_offset` the
    frame's time is then in its middle.
    """
    known = ("row_offset", "row_step", "exposure", "direction", "row_times", "trigger", "readout")
    block = keys.block("shutter", known)
    block = block or Keys(keys.file, {}, keys.frame, "shutter.")
    direction = block.choice("direction", DIRECTIONS, "top_to_bottom")
    offset, step = block.number("row_offset", 0.0), block.number("row_step", 0.0)
    size = keys.count("w"), keys.count("h")
    if block.has("readout"):
        if block.has("row_step"):
            raise block.error("readout", "left out where there is a row_step")
        readout = block.number("readout")
        step = step_of(readout, row_count(direction, size))
        offset = block.number("row_offset", -readout / 2)
    table = jnp.array(block.series("row_times"), dtype) if block.has("row_times") else None
    shutter = Shutter(
        row_offset=jnp.array(offset, dtype),
        row_step=jnp.array(step, dtype),
        exposure=jnp.array(block.number("exposure", 0.0), dtype),
        direction=direction,
        row_times=table,
        trigger=jnp.array(block.number("trigger"), dtype) if block.has("trigger") else None,
    )
    check_shutter(shutter, size)
    return shutter


def trajectory_of(keys: Keys, dtype: DTypeLike) -> Trajectory:
    """The `trajectory` block: a list of poses at the capture's times, or such `poses` with the
    `interpolation` between them and a `shake` around them."""
    value = keys.values["trajectory"]
    if not isinstance(value, dict):
        return Trajectory(*_poses(keys, "trajectory", dtype))
    block = keys.block("trajectory", ("poses", "interpolation", "shake")) or keys
    kind = block.choice("interpolation", INTERPOLATIONS, "linear")
    return Trajectory(*_poses(block, "poses", dtype), kind, _shake(block, dtype))


def _poses(keys, name, dtype):
    value = keys.values.get(name)
    if not isinstance(value, list) or not value:
        raise keys.error(name, "a list of at least one {time, transform_matrix}")
    times, poses = [], []
    for k, entry in enumerate(value):
        pose = Keys(keys.file, {f"{name}[{k}]": entry}, keys.frame, keys.prefix)
        block = pose.block(f"{name}[{k}]", ("time", "transform_matrix"))
        if block is None:
            raise pose.error(f"{name}[{k}]", "a block with time and transform_matrix")
        times.append(block.number("time"))
        poses.append(block.pose())
    poses = np.stack(poses)
    quat = quaternions(poses, dtype)
    return jnp.array(times, dtype), quat, jnp.array(poses[:, :, 3], dtype)


def _shake(keys, dtype):
    names = tuple(Shake.__dataclass_fields__)
    block = keys.block("shake", names)
    if block is None:
        return None
    return Shake(**{name: jnp.array(block.number(name), dtype) for name in names})


def quaternions(poses: np.ndarray, dtype: DTypeLike) -> Float[Array, "poses 4"]:
    """world_from_camera rotations, in our camera axes, of camera-to-world matrices in OpenGL's."""
    ours = poses[:, :, :3] * np.array(BLENDER_AXES)[None, None]
    return jax.vmap(quaternion)(jnp.asarray(ours)).astype(dtype)
