"""From the blocks of a capture's JSON: film, aperture, shutter and trajectory of a camera."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.aperture import FOCUS, Aperture, Rim
from gaussray.camera.film import FILTERS, Film
from gaussray.camera.focus_pull import EASES, FocusPull
from gaussray.camera.shake import Shake
from gaussray.camera.shutter import DIRECTIONS, Shutter, check_shutter, row_count, row_step_of
from gaussray.camera.trajectory import INTERPOLATIONS, Trajectory
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.world_origin import counted_positions
from gaussray.geometry import BLENDER_AXES, quaternion
from gaussray.io.plain_values import to_device
from gaussray.io.safe.limits import within
from gaussray.runtime.stored_programs import KeptProgram


# Poses that one call of a program turns into quaternions.
_BLOCK = 256
# The effect of a frame that has the block but names no "effect".
EFFECT_OF_BLOCK = {
    "lens": "fisheye",
    "aperture": "depth_of_field",
    "shutter": "rolling_shutter",
    "trajectory": "camera_motion",
}


def read_film(keys: Keys) -> Film:
    """Width and height in pixels, and the pixel filter if a `film` block names one."""
    block = keys.block("film", ("filter", "filter_width"))
    size = keys.count("w"), keys.count("h")
    within("the picture", "its megapixels", size[0] * size[1], "picture", 1e6)
    if block is None:
        return Film(*size)
    default = Film(*size)
    kind = block.choice("filter", FILTERS, default.filter)
    return Film(*size, kind, block.number("filter_width", default.filter_width))


def read_aperture(keys: Keys, dtype: DTypeLike) -> Aperture:
    """The aperture of an `aperture` block; a pinhole without one.

    Args:
        keys: keys of the frame, with those of the top level that it does not have.
        dtype: type of the aperture's numbers.
    """
    known = ("radius", "focus_distance", "focus", "blades", "rotation", "ratio", "rim")
    block = keys.block("aperture", known)
    if block is None:
        block = Keys(keys.file, {"radius": 0, "focus_distance": 1}, keys.frame, "aperture.")
    blades = block.count("blades", 0, least=0)
    return Aperture(
        radius=to_device(block.number("radius"), dtype),
        focus_distance=_focus(block, dtype),
        rotation=to_device(block.number("rotation", 0.0), dtype),
        ratio=to_device(block.number("ratio", 1.0), dtype),
        # Manifests of earlier versions may have 1 or 2, which were round.
        blades=blades if blades > 2 else 0,
        focus=block.choice("focus", FOCUS, "plane"),
        rim=_rim(block, dtype),
    )


def _focus(keys: Keys, dtype: DTypeLike) -> Array | FocusPull:
    """A distance, "infinity", or a focus pull with knots {time, distance, ease}."""
    value = keys.values.get("focus_distance")
    if not isinstance(value, dict):
        distance = np.inf if value == "infinity" else keys.number("focus_distance")
        return to_device(distance, dtype)
    block = keys.block("focus_distance", ("time", "distance", "ease")) or keys
    given = block.values.get("distance")
    far = [x == "infinity" for x in given] if isinstance(given, list) else []
    # JSON has no infinity: 1 takes its place while the other distances are checked.
    near = [1.0 if x == "infinity" else x for x in given] if isinstance(given, list) else given
    checked = dataclasses.replace(block, values={**block.values, "distance": near})
    distance = np.where(far, np.inf, checked.numbers("distance"))
    ease = block.choice("ease", EASES, "linear")
    return FocusPull(to_device(block.numbers("time"), dtype), to_device(distance, dtype), ease)


def _rim(keys: Keys, dtype: DTypeLike) -> Rim | None:
    block = keys.block("rim", ("radius", "distance"))
    if block is None:
        return None
    return Rim(*(to_device(block.number(key), dtype) for key in ("radius", "distance")))


def read_shutter(keys: Keys, dtype: DTypeLike) -> Shutter:
    """The shutter of a `shutter` block; without one, all rows see one time.

    `readout`, the time from the first to the last row, may replace `row_step`; without a
    `row_offset` the frame's time is then in the middle of the readout.

    Args:
        keys: keys of the frame, with those of the top level that it does not have.
        dtype: type of the shutter's numbers.

    Raises:
        CaptureError: the block has both `readout` and `row_step`.
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
        step = row_step_of(readout, row_count(direction, size))
        offset = block.number("row_offset", -readout / 2)
    table = to_device(block.numbers("row_times"), dtype) if block.has("row_times") else None
    shutter = Shutter(
        row_offset=to_device(offset, dtype),
        row_step=to_device(step, dtype),
        exposure=to_device(block.number("exposure", 0.0), dtype),
        direction=direction,
        row_times=table,
        trigger=to_device(block.number("trigger"), dtype) if block.has("trigger") else None,
    )
    check_shutter(shutter, size)
    return shutter


def read_trajectory(keys: Keys, dtype: DTypeLike) -> Trajectory:
    """The trajectory of a `trajectory` block.

    The block is a list of {time, transform_matrix}, or has such `poses`, the `interpolation`
    between them and a `shake` added to them.

    Args:
        keys: keys of the frame, among them `trajectory`.
        dtype: type of the trajectory's numbers.
    """
    value = keys.values["trajectory"]
    if not isinstance(value, dict):
        return Trajectory(*_poses(keys, "trajectory", dtype))
    block = keys.block("trajectory", ("poses", "interpolation", "shake")) or keys
    kind = block.choice("interpolation", INTERPOLATIONS, "linear")
    return Trajectory(*_poses(block, "poses", dtype), kind, _shake(block, dtype))


def _poses(keys: Keys, name: str, dtype: DTypeLike) -> tuple[Array, Array, Array]:
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
    return to_device(times, dtype), quat, to_device(counted_positions(poses[:, :, 3]), dtype)


def _shake(keys: Keys, dtype: DTypeLike) -> Shake | None:
    names = tuple(Shake.__dataclass_fields__)
    block = keys.block("shake", names)
    if block is None:
        return None
    return Shake(**{name: to_device(block.number(name), dtype) for name in names})


def quaternions(poses: np.ndarray, dtype: DTypeLike) -> Float[Array, "poses 4"]:
    """Rotations (wxyz) of camera-to-world matrices, in this package's camera axes.

    Args:
        poses: the matrices [poses, 3, 4], with OpenGL camera axes; at least one.
        dtype: type of the quaternions.
    """
    rotation = poses[:, :, :3] * np.array(BLENDER_AXES)[None, None]
    # In whole blocks, so that few programs serve all captures.
    padding = -len(rotation) % _BLOCK
    rotation = np.pad(rotation, ((0, padding), (0, 0), (0, 0)), mode="edge")
    found = _quaternions(to_device(rotation, jnp.result_type(float)))
    return to_device(np.asarray(found)[: len(poses)], dtype)


# Compiled as one program: operation by operation it takes a hundred times as long.
_quaternions = KeptProgram(jax.vmap(quaternion), ())
