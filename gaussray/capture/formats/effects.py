"""From the blocks of a capture's JSON to the parts of a camera."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.aperture import EASES, FOCUS, Aperture, FocusPull, Rim
from gaussray.camera.film import FILTERS, Film
from gaussray.camera.shake import Shake
from gaussray.camera.shutter import DIRECTIONS, Shutter, check_shutter, row_count, step_of
from gaussray.camera.trajectory import INTERPOLATIONS, Trajectory
from gaussray.capture.formats.json_keys import Keys
from gaussray.geometry import BLENDER_AXES, quaternion
from gaussray.io.safe.limits import within


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
    within("the picture", "its megapixels", size[0] * size[1], "picture", 1e6)
    if block is None:
        return Film(*size)
    default = Film(*size)
    kind = block.choice("filter", FILTERS, default.filter)
    return Film(*size, kind, block.number("filter_width", default.filter_width))


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
    distance = np.where(far, np.inf, checked.numbers("distance"))
    ease = block.choice("ease", EASES, "linear")
    return FocusPull(jnp.array(block.numbers("time"), dtype), jnp.array(distance, dtype), ease)


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
    table = jnp.array(block.numbers("row_times"), dtype) if block.has("row_times") else None
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
    return _quaternions(ours).astype(dtype)


# Compiled whole: step by step it takes a hundred times as long, and every capture waits for it.
_quaternions = jax.jit(jax.vmap(quaternion))
