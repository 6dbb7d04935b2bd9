"""The unknowns of a calibration: their names, units, and the camera with given values of them."""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.array import CameraSet, camera_set
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import Corrections, apply_corrections, require_correctable
from gaussray.camera.lens import AbstractLens
from gaussray.camera.lens.correctable import CorrectableLens
from gaussray.geometry import product, rotation_matrix


# The choices of calibrate.parameters; the first three are common to all cameras.
KINDS = ("focal", "lens", "shutter", "pose", "exposure", "offset")
SHARED = ("focal", "lens", "shutter")
_AXES = ("right", "down", "forward")
_CHANNELS = ("red", "green", "blue")
_KEY = "calibrate.parameters"


class Unknown(eqx.Module):
    """One number of a camera that is estimated.

    Args:
        kind: the choice of `calibrate.parameters` that it belongs to.
        name: its name in the report.
        unit: unit in which it is reported.
        column: its index in its field of `Corrections`.
    """

    kind: str = eqx.field(static=True)
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    column: int = eqx.field(static=True)

    @property
    def field(self) -> str:
        """The field of `Corrections` that holds it."""
        return "lens" if self.kind == "focal" else self.kind


def unknowns(
    kinds: Sequence[str], lens: AbstractLens, named: Sequence[str] = (), unit: str = "time"
) -> tuple[Unknown, ...]:
    """The unknowns of a camera.

    Args:
        kinds: choices of `calibrate.parameters`.
        lens: the camera's lens, from `prepare_lens`. Its unknowns are the principal point and the
            coefficients; a polynomial's linear coefficient is its focal length and counts as that.
        named: the coefficients to estimate; empty means all that are not zero.
        unit: name of the capture's unit of time.

    Raises:
        ValueError: If the lens has no focal length of its own and `kinds` asks for its parameters.
    """
    chosen = []
    if "focal" in kinds:
        chosen.append(Unknown("focal", "focal", require_correctable(lens, _KEY).focal_unit, 0))
    if "lens" in kinds:
        chosen += _lens_unknowns(require_correctable(lens, _KEY), named)
    if "shutter" in kinds:
        chosen.append(Unknown("shutter", "readout", unit, 0))
    if "pose" in kinds:
        chosen += [Unknown("pose", f"turn.{a}", "degrees", i) for i, a in enumerate(_AXES)]
        chosen += [Unknown("pose", f"shift.{a}", "scene", i) for i, a in enumerate(_AXES, 3)]
    if "exposure" in kinds:
        chosen += [Unknown("exposure", f"gain.{c}", "1", i) for i, c in enumerate(_CHANNELS)]
    if "offset" in kinds:
        chosen.append(Unknown("offset", "offset", unit, 0))
    return tuple(chosen)


def _lens_unknowns(lens: CorrectableLens, named: Sequence[str]) -> list[Unknown]:
    """Principal point and coefficients."""
    center = [Unknown("lens", f"center.{a}", lens.center_unit, i) for i, a in enumerate("xy", 1)]
    values = np.asarray(lens.coefficient_values)
    return center + [
        Unknown("lens", name, "1", 3 + i)
        for i, name in enumerate(lens.coefficient_names)
        if (name in named if named else values[i] != 0) and i != lens.linear_coefficient
    ]


def prepare_lens(lens: AbstractLens, named: Sequence[str]) -> AbstractLens:
    """The lens with the coefficients to estimate; new ones are zero.

    Args:
        lens: the recorded lens.
        named: names of the coefficients.

    Raises:
        ValueError: If the lens has no coefficient of such a name.
    """
    names = lens.possible_coefficients if isinstance(lens, CorrectableLens) else ()
    wrong = [name for name in named if name not in names]
    if wrong:
        raise ValueError(
            f"calibrate.coefficients must be among {', '.join(names) or 'none'}, those of a lens "
            f"of type {type(lens).__name__}, got {wrong[0]!r}."
        )
    return lens.with_named_coefficients(named) if isinstance(lens, CorrectableLens) else lens


def unit_camera_set(camera: Camera) -> CameraSet:
    """A set of one camera, whose unit of length and time is 1.

    A single camera has neither an extent nor an interval between frames.
    """
    return camera_set(np.zeros(1, int), jax.tree.map(lambda x: x[None], camera), extent=1.0)


def corrected_camera(
    value: Float[Array, " unknowns"],
    camera: Camera,
    unit: CameraSet,
    parameters: tuple[Unknown, ...],
) -> tuple[Camera, Float[Array, "3"]]:
    """The camera with these values of its unknowns, and the gains of its linear light.

    Args:
        value: logarithms of factors, radians, focal lengths, as in `Corrections`; all zero is the
            camera as recorded. A pose is turned and shifted along the camera's own axes, about its
            position.
        camera: the camera as recorded.
        unit: `unit_camera_set` of the camera.
        parameters: meaning of each element of `value`.
    """
    rows = _rows(value, camera.lens, parameters)
    pose = rows.get("pose")
    if pose is not None:
        turn = rotation_matrix(camera.trajectory.quat[camera.trajectory.quat.shape[0] // 2])
        pose = product("ij,kj->ki", turn, pose.reshape(2, 3)).reshape(6)
    corrections = Corrections(
        pose=pose,
        shutter=rows["shutter"][0] if "shutter" in rows else None,
        offset=rows["offset"][0] if "offset" in rows else None,
    )
    lens = camera.lens
    if "lens" in rows:
        row = rows["lens"]
        lens = require_correctable(lens, _KEY).corrected(jnp.exp(row[0]), row[1:3], row[3:])
    gain = jnp.exp(rows.get("exposure", jnp.zeros(3, value.dtype)))
    return dataclasses.replace(apply_corrections(camera, corrections, unit), lens=lens), gain


def _rows(
    value: Float[Array, " unknowns"], lens: AbstractLens, parameters: tuple[Unknown, ...]
) -> dict[str, Float[Array, " numbers"]]:
    """The rows of `Corrections` that hold the unknowns, by field; other numbers are zero."""
    size = {"pose": 6, "exposure": 3, "shutter": 1, "offset": 1}
    if any(one.field == "lens" for one in parameters):
        size["lens"] = 3 + require_correctable(lens, _KEY).coefficient_values.shape[-1]
    rows = {}
    for field, count in size.items():
        index = [i for i, one in enumerate(parameters) if one.field == field]
        if index:
            column = np.array([parameters[i].column for i in index])
            rows[field] = jnp.zeros(count, value.dtype).at[column].set(value[np.array(index)])
    return rows


def reported_values(
    value: Float[Array, " unknowns"],
    camera: Camera,
    unit: CameraSet,
    parameters: tuple[Unknown, ...],
) -> Float[Array, " unknowns"]:
    """The reported value of each unknown, in its unit.

    Focal length, principal point and coefficients are those of a capture's JSON, `readout` is the
    time from the first row to the last, gains are those of linear light. Turn, shift and offset are
    differences from the recorded values.

    Args:
        value: as for `corrected_camera`.
        camera: as for `corrected_camera`.
        unit: as for `corrected_camera`.
        parameters: as for `corrected_camera`.
    """
    corrected, gain = corrected_camera(value, camera, unit, parameters)
    film, shutter = camera.film, corrected.shutter
    sideways = shutter.direction in ("left_to_right", "right_to_left")
    rows = film.width if sideways else film.height

    def reading(one: Unknown, raw: Float[Array, ""]) -> Float[Array, ""]:
        match one.kind:
            case "focal":
                return require_correctable(corrected.lens, _KEY).focal_length
            case "lens" if one.column < 3:
                return require_correctable(corrected.lens, _KEY).principal_point[one.column - 1]
            case "lens":
                return require_correctable(corrected.lens, _KEY).coefficient_values[one.column - 3]
            case "shutter":
                return shutter.row_step * (rows - 1)
            case "exposure":
                return gain[one.column]
            case _:
                return raw * (math.degrees(1) if one.unit == "degrees" else 1)

    pairs = zip(parameters, value, strict=True)
    return jnp.stack([reading(one, raw) for one, raw in pairs])
