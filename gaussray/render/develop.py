"""Develops linear light by the sensor into the values of a picture file."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped, UInt8

from gaussray.camera.sensor.noise import picture_key
from gaussray.camera.sensor.sensor import (
    SensorOptions,
    develop_with,
    encode,
    sensor_numbers,
    sensor_steps,
)
from gaussray.dataset.images import check_half, write_image
from gaussray.dataset.levels import device_levels, encoded_table, require_finite, srgb_table
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.aov.files import SHARP
from gaussray.render.options import NO_SENSOR


# Bits of a sensor's levels that a half float can distinguish.
HALF_BITS = 10


def sensor_of(record: FrameRecord, sensor: SensorOptions) -> SensorOptions:
    """The sensor of a picture; none for the ground truth without effects (label `sharp`).

    Args:
        record: the frame.
        sensor: the sensor of all other frames.
    """
    return NO_SENSOR if record.effect == SHARP else sensor


def without_unused_seed(sensor: SensorOptions) -> SensorOptions:
    """`NO_SENSOR` for a sensor that changes nothing but has a seed for noise that it does not add.

    Randomised samples draw every seed, and equal pictures must have equal records.
    """
    same = dataclasses.replace(sensor, seed=NO_SENSOR.seed) == NO_SENSOR
    return NO_SENSOR if same else sensor


class DevelopedPicture(NamedTuple):
    """The values that a picture file stores, and whether its format can hold them.

    Args:
        values: 8-bit levels of a PNG; linear light of an EXR, in half or single precision.
        unfit: how many values of the light are not finite.
        largest: the largest finite magnitude of the light.
    """

    values: Shaped[Array | np.ndarray, "h w 3"]
    unfit: Int[Array | np.ndarray, ""]
    largest: Float[Array | np.ndarray, ""]


def develop_picture(
    record: FrameRecord, values: Float[Array, "..."], sensor: SensorOptions
) -> DevelopedPicture:
    """Develop a picture by the sensor for its file, on the device of its values.

    Args:
        record: the frame.
        values: pixels in rows, of any shape; linear light first, other values are ignored.
        sensor: the sensor.
    """
    film = record.camera.film
    size = film.height, film.width
    if Path(record.file_path).suffix != ".exr":
        return _develop_levels(record, values, sensor, size)
    if sensor == NO_SENSOR:
        return _store(values, size, "half")
    light = sensor_values(record, _light(values, size), sensor)
    return _store(light, size, "float" if sensor.bits > HALF_BITS else "half")


def write_picture(path: Path, picture: DevelopedPicture) -> None:
    """Write a developed picture.

    Args:
        path: the file, `.png` or `.exr`.
        picture: the picture, on the host.

    Raises:
        ValueError: The format cannot hold the light.
        OSError: The file cannot be written.
    """
    if path.suffix != ".exr":
        require_finite(int(picture.unfit))
        write_image(path, picture.values)
    elif picture.values.dtype == np.float16:
        check_half(path, float(picture.largest))
        write_image(path, picture.values)
    else:
        write_image(path, picture.values, depth="float")


def picture_levels(
    record: FrameRecord, light: Float[np.ndarray, "h w 3"], sensor: SensorOptions
) -> UInt8[np.ndarray, "h w 3"]:
    """The 8-bit levels that a PNG stores.

    Args:
        record: the frame.
        light: linear light, which may be of another size than the frame.
        sensor: the sensor.

    Raises:
        ValueError: A value is not finite.
    """
    size = light.shape[0], light.shape[1]
    picture = jax.device_get(_develop_levels(record, jnp.asarray(light), sensor, size))
    require_finite(int(picture.unfit))
    return picture.values


def _develop_levels(
    record: FrameRecord,
    values: Float[Array, "..."],
    sensor: SensorOptions,
    size: tuple[int, int],
) -> DevelopedPicture:
    if sensor == NO_SENSOR:
        return _store(values, size, "srgb")
    light = sensor_values(record, _light(values, size), sensor)
    if sensor.tone == "srgb":
        return _store(light, size, "srgb")
    curve = SensorOptions(tone=sensor.tone, table=sensor.table)
    return _store(_encode(light, options=curve), size, "encoded")


@partial(jax.jit, static_argnames=("size", "form"))
def _store(values: Float[Array, "..."], size: tuple[int, int], form: str) -> DevelopedPicture:
    """The picture of a size (height, width) in a form: 8-bit levels of light to be encoded (`srgb`)
    or of values that are encoded already (`encoded`), halves or floats."""
    light = _light(values, size)
    finite = jnp.isfinite(light)
    stored = {
        "srgb": lambda: device_levels(light, srgb_table()),
        "encoded": lambda: device_levels(light, encoded_table()),
        "half": lambda: light.astype(jnp.float16),
        "float": lambda: light.astype(jnp.float32),
    }[form]()
    unfit = jnp.sum(~finite, dtype=jnp.int32)
    return DevelopedPicture(stored, unfit, jnp.max(jnp.where(finite, jnp.abs(light), 0)))


@partial(jax.jit, static_argnames="size")
def _light(values: Float[Array, "..."], size: tuple[int, int]) -> Float[Array, "h w 3"]:
    return values.reshape(*size, -1)[..., :3]


_encode = eqx.filter_jit(encode)


def sensor_values(
    record: FrameRecord, light: Float[Array, "h w 3"], sensor: SensorOptions
) -> Float[Array, "h w 3"]:
    """The sensor's linear values of a frame, on the device of the light.

    The noise depends on the seed and the file's name without its suffix, not on other frames or the
    format.

    Args:
        record: the frame.
        light: linear light.
        sensor: the sensor.
    """
    key = picture_key(sensor.seed, str(Path(record.file_path).with_suffix("")))
    # Cameras of every kind share the program of a sensor that does not ask for them.
    camera = record.camera if sensor.falloff or any(sensor.vignetting) else None
    return _develop(sensor_numbers(sensor), light, camera, key, steps=sensor_steps(sensor))


_develop = eqx.filter_jit(develop_with)
