"""Develops linear light by the sensor into the values of a picture file."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from gaussray.camera.sensor.noise import picture_key
from gaussray.camera.sensor.sensor import (
    SensorOptions,
    develop_with,
    encode,
    sensor_numbers,
    sensor_steps,
)
from gaussray.dataset.images import srgb_levels, write_image
from gaussray.dataset.manifest import FrameRecord
from gaussray.render.aov.files import SHARP
from gaussray.render.options import NO_SENSOR


# Bits of a sensor's levels that a half float can distinguish.
HALF_BITS = 10


def sensor_of(record: FrameRecord, sensor: SensorOptions) -> SensorOptions:
    """The sensor of a picture; none for the ground truth without effects (label `sharp`).

    Args:
        record: The frame.
        sensor: The sensor of all other frames.
    """
    return NO_SENSOR if record.effect == SHARP else sensor


def without_unused_seed(sensor: SensorOptions) -> SensorOptions:
    """`NO_SENSOR` for a sensor that changes nothing but has a seed for noise that it does not add.

    Randomised samples draw every seed, and equal pictures must have equal records.
    """
    same = dataclasses.replace(sensor, seed=NO_SENSOR.seed) == NO_SENSOR
    return NO_SENSOR if same else sensor


def write_picture(
    path: Path, record: FrameRecord, light: Float[np.ndarray, "h w 3"], sensor: SensorOptions
) -> None:
    """Develop a picture by the sensor and write it.

    Args:
        path: The file, `.png` or `.exr`.
        record: The frame.
        light: Linear light.
        sensor: The sensor.
    """
    if path.suffix != ".exr":
        write_image(path, picture_levels(record, light, sensor))
    elif sensor == NO_SENSOR:
        write_image(path, light)
    else:
        depth = "float" if sensor.bits > HALF_BITS else "half"
        write_image(path, _sensor_values(record, light, sensor), depth=depth)


def picture_levels(
    record: FrameRecord, light: Float[np.ndarray, "h w 3"], sensor: SensorOptions
) -> UInt8[np.ndarray, "h w 3"]:
    """The 8-bit levels that a PNG stores.

    Args:
        record: The frame.
        light: Linear light.
        sensor: The sensor.
    """
    if sensor == NO_SENSOR:
        return srgb_levels(light)
    light = _sensor_values(record, light, sensor)
    if sensor.tone == "srgb":
        return srgb_levels(light)
    return srgb_levels(light, lambda x: encode(jnp.asarray(x), options=sensor))


def _sensor_values(
    record: FrameRecord, light: Float[np.ndarray, "h w 3"], sensor: SensorOptions
) -> Float[np.ndarray, "h w 3"]:
    return np.asarray(sensor_values(record, jnp.asarray(light), sensor))


def sensor_values(
    record: FrameRecord, light: Float[Array, "h w 3"], sensor: SensorOptions
) -> Float[Array, "h w 3"]:
    """The sensor's linear values of a frame, on the device of the light.

    The noise depends on the seed and the file's name without its suffix, not on other frames or the
    format.

    Args:
        record: The frame.
        light: Linear light.
        sensor: The sensor.
    """
    key = picture_key(sensor.seed, str(Path(record.file_path).with_suffix("")))
    # Cameras of every kind share the program of a sensor that does not ask for them.
    camera = record.camera if sensor.falloff or any(sensor.vignetting) else None
    return _develop(sensor_numbers(sensor), light, camera, key, steps=sensor_steps(sensor))


_develop = eqx.filter_jit(develop_with)
