"""The sensor model applied to a preview, on the device: from linear light to 8-bit levels."""

import dataclasses
import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, UInt8

from gaussray.camera.camera import Camera
from gaussray.camera.sensor.noise import picture_key
from gaussray.camera.sensor.sensor import SensorOptions, develop_with, sensor_numbers, sensor_steps
from gaussray.camera.sensor.tone import apply_tone_curve
from gaussray.render.job import RenderJob
from gaussray.viewer.preview import Preview


def develop_preview(preview: Preview, job: RenderJob) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit sRGB levels of a preview; up to rounding, those of the PNG that `render` writes.

    Args:
        preview: linear light of every pixel, rendered from the job's first record.
        job: the render job, with the camera and the sensor model to apply.
    """
    camera, sensor = job.records[0].camera, job.dataset.sensor
    steps, *settings = _settings(sensor, job.records[0].file_path.rsplit(".", 1)[0])
    # Passing the camera takes time, so it is passed only where a step needs it.
    lens_camera = camera if steps.falloff or any(steps.vignetting) else None
    levels = _levels(
        jnp.asarray(preview.values),
        lens_camera,
        *settings,
        steps=steps,
        tone=sensor.tone,
        size=preview.size,
    )
    return np.asarray(levels)


@functools.lru_cache(64)
def _settings(sensor: SensorOptions, name: str) -> tuple:
    """The sensor's steps, their numbers, its tone table, and the random key of the picture's noise,
    on the device."""
    # Exposure is always applied, also 0 stops, so that moving its slider compiles nothing.
    steps = dataclasses.replace(sensor_steps(sensor), exposure=1.0)
    table = jnp.asarray(sensor.table, jnp.float32)
    return steps, sensor_numbers(sensor), table, picture_key(sensor.seed, name)


@eqx.filter_jit
def _levels(
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
    light = develop_with(numbers, light, camera, key, steps=steps)
    levels = jnp.clip(apply_tone_curve(light, tone, table), 0, 1)
    return jnp.floor(255 * levels + 0.5).astype(jnp.uint8)
