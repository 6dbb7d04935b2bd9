"""The numbers of a camera that a known scene tells: their names, and the camera that they make."""

import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera import distortion
from gaussray.camera.array import CameraSet, camera_set
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import Corrections, coefficients, corrected_lens, refined
from gaussray.camera.lens import (
    AbstractLens,
    DoubleSphere,
    FisheyePolynomial,
    FocalLens,
    FTheta,
    Pinhole,
    ThinPrismFisheye,
    UnifiedSphere,
    thin_prism,
)
from gaussray.geometry import product, rotation_matrix


# What calibrate.parameters can name; the first three are common to all cameras.
KINDS = ("focal", "lens", "shutter", "pose", "exposure", "offset")
SHARED = ("focal", "lens", "shutter")
_AXES = ("right", "down", "forward")


class Unknown(eqx.Module):
    """One number: the parameter it belongs to, its own name, the unit in which it is told, and
    where it stands in its field of `Corrections`."""

    kind: str = eqx.field(static=True)
    name: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    place: int = eqx.field(static=True)

    @property
    def field(self) -> str:
        """The field of `Corrections` that holds it."""
        return "lens" if self.kind == "focal" else self.kind


def unknowns(
    kinds: Sequence[str], lens: AbstractLens, named: Sequence[str] = (), unit: str = "time"
) -> tuple[Unknown, ...]:
    """The unknowns of a camera with this lens (`prepared`); times are told in the capture's `unit`.

    Of the lens: its principal point and its coefficients, those `named` or else all that are not
    zero. A polynomial's linear coefficient is its focal length, and goes with that.
    """
    found = []
    if "focal" in kinds:
        length = "mm" if isinstance(lens, FisheyePolynomial) else "px"
        found.append(Unknown("focal", "focal", length, 0))
    if "lens" in kinds:
        length = "sensor" if isinstance(lens, FisheyePolynomial) else "px"
        found += [Unknown("lens", f"center.{a}", length, i) for i, a in enumerate("xy", 1)]
        bent = np.asarray(coefficients(lens, "calibrate.parameters"))
        linear = 1 if isinstance(lens, FisheyePolynomial | FTheta) else -1
        for i, name in enumerate(_names(lens)):
            if (name in named if named else bent[i] != 0) and i != linear:
                found.append(Unknown("lens", name, "1", 3 + i))
    if "shutter" in kinds:
        found.append(Unknown("shutter", "readout", unit, 0))
    if "pose" in kinds:
        found += [Unknown("pose", f"turn.{a}", "degrees", i) for i, a in enumerate(_AXES)]
        found += [Unknown("pose", f"shift.{a}", "scene", i) for i, a in enumerate(_AXES, 3)]
    if "exposure" in kinds:
        channels = enumerate(("red", "green", "blue"))
        found += [Unknown("exposure", f"gain.{name}", "1", i) for i, name in channels]
    if "offset" in kinds:
        found.append(Unknown("offset", "offset", unit, 0))
    return tuple(found)


def prepared(lens: AbstractLens, named: Sequence[str]) -> AbstractLens:
    """The lens with room for the coefficients `named`, ValueError if it has no such ones."""
    known = distortion.NAMES if isinstance(lens, Pinhole) else _names(lens)
    wrong = [name for name in named if name not in known]
    if wrong:
        raise ValueError(
            f"calibrate.coefficients must be among {', '.join(known) or 'none'}, those of a lens "
            f"of type {type(lens).__name__}, got {wrong[0]!r}."
        )
    if not named or not isinstance(lens, Pinhole):
        return lens
    least = 1 + max(known.index(name) for name in named)
    held = lens.distortion.shape[-1]
    count = next(n for n in distortion.COUNTS if n >= max(least, held))
    return Pinhole(lens.focal, lens.center, jnp.pad(lens.distortion, (0, count - held)))


def units(camera: Camera) -> CameraSet:
    """Units of one for lengths and times: a camera by itself has neither extent nor interval."""
    return camera_set(np.zeros(1, int), jax.tree.map(lambda x: x[None], camera), extent=1.0)


def applied(
    value: Float[Array, " unknowns"], camera: Camera, unit: CameraSet, told: tuple[Unknown, ...]
) -> tuple[Camera, Float[Array, "3"]]:
    """A camera with these values of its unknowns, and the gains of its linear light; zeros are the
    camera as recorded.

    As in `Corrections`, in these `units`: logarithms of factors, radians, focal lengths; a pose is
    turned and moved along the camera's own axes, about its place.
    """
    size = {"pose": 6, "exposure": 3, "shutter": 1, "offset": 1}
    if any(one.field == "lens" for one in told):
        size["lens"] = 3 + coefficients(camera.lens, "calibrate.parameters").shape[-1]
    rows = {name: _row(value, told, name, count) for name, count in size.items()}
    own = {name: row for name, row in rows.items() if row is not None}
    if "pose" in own:
        turn = rotation_matrix(camera.trajectory.quat[camera.trajectory.quat.shape[0] // 2])
        axes = own["pose"].reshape(2, 3)
        own["pose"] = product("ij,kj->ki", turn, axes).reshape(6)
    lens = corrected_lens(camera.lens, own.pop("lens")) if "lens" in own else camera.lens
    gain = jnp.exp(own.pop("exposure", jnp.zeros(3, value.dtype)))
    corrections = Corrections(**{k: row if k == "pose" else row[0] for k, row in own.items()})
    return dataclasses.replace(refined(camera, corrections, unit), lens=lens), gain


def _row(value, told, field, size):
    places = [(one.place, i) for i, one in enumerate(told) if one.field == field]
    if not places:
        return None
    place, own = np.array(places).T
    return jnp.zeros(size, value.dtype).at[place].set(value[own])


def readings(
    value: Float[Array, " unknowns"], camera: Camera, unit: CameraSet, told: tuple[Unknown, ...]
) -> Float[Array, " unknowns"]:
    """What is told of each unknown, in its unit: focal length, principal point and coefficients of
    the lens as a capture's JSON has them, the time from the first row to the last, gains of linear
    light; turn, shift and offset from what was recorded."""
    seen, gain = applied(value, camera, unit, told)
    lens, film = seen.lens, camera.film
    sideways = seen.shutter.direction in ("left_to_right", "right_to_left")
    rows = film.width if sideways else film.height
    result = []
    for one, own in zip(told, value, strict=True):
        match one.kind:
            case "focal" if isinstance(lens, FisheyePolynomial):
                result.append(1 / jnp.abs(lens.coefficients[1]))
            case "focal" if isinstance(lens, FocalLens):
                result.append(lens.focal[0])
            case "lens" if one.place < 3 and isinstance(lens, FisheyePolynomial):
                result.append(lens.shift[one.place - 1])
            case "lens" if one.place < 3 and isinstance(lens, FocalLens):
                result.append(lens.center[one.place - 1])
            case "lens":
                result.append(coefficients(lens, "calibrate.parameters")[one.place - 3])
            case "shutter":
                result.append(seen.shutter.row_step * (rows - 1))
            case "exposure":
                result.append(gain[one.place])
            case _:
                result.append(own * (math.degrees(1) if one.unit == "degrees" else 1))
    return jnp.stack(result)


def _names(lens: AbstractLens) -> tuple[str, ...]:
    """What the coefficients of a lens are called, in their order."""
    count = coefficients(lens, "calibrate.parameters").shape[-1]
    match lens:
        case Pinhole():
            return distortion.NAMES[:count]
        case ThinPrismFisheye():
            return thin_prism.NAMES
        case UnifiedSphere():
            return ("alpha", "beta")
        case DoubleSphere():
            return ("xi", "alpha")
        case FisheyePolynomial() | FTheta():
            return tuple(f"k{i}" for i in range(count))
        case FocalLens():
            return tuple(f"k{i}" for i in range(1, count + 1))
        case _:
            return ()
