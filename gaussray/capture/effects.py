"""From the blocks of a capture's JSON to the parts of a camera."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.aperture import FOCUS, Aperture
from gaussray.camera.film import FILTERS, Film
from gaussray.camera.shutter import DIRECTIONS, Shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.keys import Keys
from gaussray.geometry import BLENDER_AXES, quaternion


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
