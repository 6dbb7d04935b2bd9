"""The declaration of a lens model: its names, and how it is built from user input."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Array, DTypeLike, Float

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import AbstractLens
from gaussray.io.plain_values import to_device


class LensOptions(eqx.Module):
    """The config group `lens`: a lens by a few numbers, for pictures of any size.

    Args:
        model: `keep` (the capture's lens) or the name of a `LensModel`.
        fov: field of view in degrees, which sets the focal length. Perspective models and
            equirectangular: across the width of the picture. Others: across its smaller side.
        crop: field of view in degrees beyond which a fisheye's picture is black; None is `fov`, or
            the whole picture for an f_theta without `fov`. It does not change the focal length.
        k: coefficients of the model.
        sensor: width and height of the sensor in mm, on which a fisheye_polynomial has its focal
            length; its shape is the picture's, to half a pixel. Empty is the focal length that
            `fov` says.
        fov_y: angle from top to bottom in degrees (equirectangular).
        polynomial: direction of the polynomial, angle_of_radius or radius_of_angle (f_theta).
        file: table of directions, .npz or .exr (table).
    """

    model: str = eqx.field(static=True, default="keep")
    fov: float | None = eqx.field(static=True, default=None)
    k: tuple[float, ...] = eqx.field(static=True, default=())
    sensor: tuple[float, ...] = eqx.field(static=True, default=())
    fov_y: float = eqx.field(static=True, default=180.0)
    polynomial: str = eqx.field(static=True, default="angle_of_radius")
    file: str = eqx.field(static=True, default="")
    crop: float | None = eqx.field(static=True, default=None)


@runtime_checkable
class LensKeys(Protocol):
    """Access to the keys of a frame, or of its `lens` block, in a capture's JSON.

    Every method raises an error that names file, frame, key and rule if the value has the wrong
    type or range. A key without default is required.

    - `has`: whether the frame holds the key.
    - `number`, `count`: a finite float; an integer of at least `least`.
    - `text`, `choice`: a string; one of `choices`.
    - `vector`, `numbers`: a list of `length` floats; a list of at least one.
    - `path`: the file that the key names, in the folder of the JSON file; None without the key.
    - `error`: the error to raise for a key that breaks `rule`; `remedy` says what to do.
    - `warn`: warn with a message that names file and frame.
    """

    def has(self, key: str) -> bool: ...
    def number(self, key: str, default: Any = ..., remedy: str = ...) -> float: ...
    def count(self, key: str, default: Any = ..., least: int = ...) -> int: ...
    def text(self, key: str, default: Any = ..., remedy: str = ...) -> str: ...
    def choice(self, key: str, choices: Sequence[str], default: Any = ...) -> str: ...
    def vector(self, key: str, length: int, default: Any = ...) -> list[float]: ...
    def numbers(self, key: str) -> list[float]: ...
    def path(self, key: str) -> Path | None: ...
    def error(self, key: str, rule: str, remedy: str = ...) -> Exception: ...
    def warn(self, message: str) -> None: ...


FromOptions = Callable[[Film, LensOptions], AbstractLens]
FromKeys = Callable[[LensKeys, LensKeys, DTypeLike], AbstractLens]


@dataclasses.dataclass(frozen=True, kw_only=True)
class LensModel:
    """One lens model by its names. Every file of `camera/lens/` lists its own as `MODELS`.

    Args:
        name: `lens.model` of the configuration; empty if the model occurs in captures alone.
        label: effect that frames through this lens show.
        from_options: builds the lens for a film from the user's few numbers, axis in the middle.
        block: `model` in the `lens` block of a capture's JSON; empty if it needs no block.
        camera_models: values of `camera_model` in a capture's JSON that mean this model.
        from_keys: builds the lens from the keys of a frame, those of its `lens` block and a dtype.
        frame_keys: keys of a frame that belong to the model (`fl_x fl_y cx cy` go without saying).
        block_keys: keys of its `lens` block.
        perspective: whether the lens is a pinhole with distortion: `fov` is that of the width,
            focus is on a plane, and without coefficients there is no effect.
        widest: largest `fov`, in degrees, with the coefficients of its config file.
        any_size: a config file of the model suits pictures of any size and names no file.
        option_keys: keys of `LensOptions` that `from_options` reads; all others are refused.
    """

    name: str = ""
    label: str = "fisheye"
    from_options: FromOptions | None = None
    block: str = ""
    camera_models: tuple[str, ...] = ()
    from_keys: FromKeys
    frame_keys: tuple[str, ...] = ()
    block_keys: tuple[str, ...] = ()
    perspective: bool = False
    widest: float = 360.0
    any_size: bool = True
    option_keys: tuple[str, ...] = ("fov", "k", "crop")

    def effect(self, options: LensOptions) -> str:
        """Effect that frames through the lens of these options show; empty if there is none."""
        return "" if self.perspective and not any(options.k) else self.label


def focal_and_center(
    keys: LensKeys, dtype: DTypeLike
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Focal lengths and principal point of a frame's keys, in pixels.

    Args:
        keys: the keys of the frame.
        dtype: precision of the arrays.
    """
    remedy = ""
    if keys.has("camera_angle_x") and not keys.has("fl_x"):
        focal = keys.count("w") / 2 / np.tan(keys.number("camera_angle_x") / 2)
        remedy = f"From camera_angle_x it is {focal:.8g}; write fl_x, fl_y, cx and cy."
    focal = [keys.number("fl_x", remedy=remedy), keys.number("fl_y")]
    return to_device(focal, dtype), to_device([keys.number("cx"), keys.number("cy")], dtype)


def film_size(film: Film) -> Float[np.ndarray, "2"]:
    """Width and height in pixels."""
    return np.array([film.width, film.height], np.float32)


def half_angle(options: LensOptions, widest: float = 180.0) -> float:
    """Half of `lens.fov`, in radians.

    Args:
        options: the lens options.
        widest: largest half angle of the model, in degrees.

    Raises:
        ValueError: `lens.fov` is missing or too wide.
    """
    return _half_of("fov", options.fov, options.model, widest)


def half_crop(options: LensOptions, widest: float = 180.0) -> float:
    """Half of `lens.crop`, in radians: the angle from the axis beyond which a picture is black.

    Args:
        options: the lens options; without `crop`, `fov` counts.
        widest: largest half angle of the model, in degrees.

    Raises:
        ValueError: The angle is missing or too wide.
    """
    crop = options.fov if options.crop is None else options.crop
    return _half_of("crop", crop, options.model, widest)


def _half_of(key: str, degrees: float | None, model: str, widest: float) -> float:
    if degrees is None or not 0 < degrees <= 2 * widest:
        raise ValueError(
            f"lens.{key} must be in (0, {2 * widest:g}] for {_choices(model)}, got {degrees}."
        )
    return np.deg2rad(degrees) / 2


def coefficients_of(options: LensOptions, *counts: int) -> Float[np.ndarray, " coefficients"]:
    """The coefficients `lens.k`.

    Args:
        options: the lens options.
        counts: allowed numbers of coefficients.

    Raises:
        ValueError: `lens.k` holds another number of them.
    """
    if len(options.k) not in counts:
        rule = " or ".join(str(count) for count in counts)
        raise ValueError(
            f"lens.k must hold {rule} coefficients for {_choices(options.model)}, got "
            f"{len(options.k)}. docs/lenses.md has their order and units."
        )
    return np.array(options.k, np.float32)


def _choices(model: str) -> str:
    """A model as users choose it: conf/lens/ has other names for some."""
    return {"pinhole": "pinhole and opencv", "fisheye_polynomial": "fisheye"}.get(model, model)
