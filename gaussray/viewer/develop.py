"""Sketches as a screen shows them: light through the sensor to codes, on the device."""

import dataclasses
import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, UInt8

from gaussray.camera.camera import Camera
from gaussray.camera.sensor.noise import picture_key
from gaussray.camera.sensor.sensor import SensorOptions, amounts, develop_by, steps_of
from gaussray.camera.sensor.tone import toned
from gaussray.render.randomize.generate import Shot
from gaussray.viewer.preview import Sketch


def developed(sketch: Sketch, shot: Shot) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit codes of a sketch of a shot, those of its PNG up to rounding."""
    camera, sensor = shot.records[0].camera, shot.sensor
    steps, *settings = _settings(sensor, shot.records[0].file_path.rsplit(".", 1)[0])
    # What no step asks for costs the host as much to hand over as what one does.
    seen = camera if steps.falloff or any(steps.vignetting) else None
    how = {"steps": steps, "tone": sensor.tone, "size": sketch.size}
    return np.asarray(_codes(jnp.asarray(sketch.values), seen, *settings, **how))


@functools.lru_cache(64)
def _settings(sensor: SensorOptions, name: str) -> tuple:
    """The steps that a sensor takes, their numbers, its table and the key of a picture's noise, on
    the device."""
    # An exposure of 0 stops is a step like any other, so that the first touch compiles nothing.
    steps = dataclasses.replace(steps_of(sensor), exposure=1.0)
    table = jnp.asarray(sensor.table, jnp.float32)
    return steps, amounts(sensor), table, picture_key(sensor.seed, name)


@eqx.filter_jit
def _codes(
    values: Float[Array, "pixels 5"],
    camera: Camera | None,
    numbers: dict[str, Array],
    table: Float[Array, " knots"],
    key: PRNGKeyArray,
    *,
    steps: SensorOptions,
    tone: str,
    size: tuple[int, int],
) -> UInt8[Array, "h w 3"]:
    light = values[:, :3].reshape(size[1], size[0], 3)
    light = develop_by(numbers, light, camera, key, steps=steps)
    shown = jnp.clip(toned(light, tone, table), 0, 1)
    return jnp.floor(255 * shown + 0.5).astype(jnp.uint8)
