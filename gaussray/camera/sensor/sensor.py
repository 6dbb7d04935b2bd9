"""The sensor: from linear light on the film to the values that a picture stores."""

import itertools
import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gaussray.camera.camera import Camera
from gaussray.camera.principal_point import require_axis
from gaussray.camera.sensor.mosaic import PATTERNS, demosaic, mosaic
from gaussray.camera.sensor.noise import add_noise
from gaussray.camera.sensor.tone import TONE_CURVES, apply_tone_curve
from gaussray.camera.sensor.vignetting import least_transmission, transmission
from gaussray.io.validate import check_field_types


# Electrons up to which single precision draws Poisson's law: the variance of 10^6 draws is as near
# as that of any (at 3e5 it is 0.9 % off).
MOST_ELECTRONS = 100_000


class SensorOptions(eqx.Module):
    """The config group `sensor`. Every key is off by default and then costs nothing.

    Args:
        chromatic: magnifications of red, green and blue (`Camera.chromatic`).
        falloff: exponent of natural vignetting, cos(theta)^falloff (`sensor.vignetting`).
        vignetting: a1, a2, a3 of the vignetting polynomial (`sensor.vignetting`).
        exposure: exposure in stops: light times 2^exposure.
        full_well: electrons that stand for the light `white` (or 1); 0 is no noise.
        read_noise: standard deviation of the read noise in electrons
            (gaussray.camera.sensor.noise).
        gain: ISO over the sensor's base ISO, at least 1; multiplies signal and noise.
        white: level at which values are clipped after the gain; 0 is no clipping.
        bits: bits of the quantisation from 0 to `white`; 0 is none.
        bayer: pattern of the Bayer colour filter array, or "none" (gaussray.camera.sensor.mosaic).
        demosaic: "bilinear" or "none".
        tone: tone curve of PNG files (`sensor.tone`).
        table: stored values of the curve `tone="table"`.
        seed: seed of the noise.

    Raises:
        ValueError: If a key breaks its rule.
    """

    chromatic: tuple[float, ...] = eqx.field(static=True, default=(1.0, 1.0, 1.0))
    falloff: float = eqx.field(static=True, default=0.0)
    vignetting: tuple[float, ...] = eqx.field(static=True, default=(0.0, 0.0, 0.0))
    exposure: float = eqx.field(static=True, default=0.0)
    full_well: float = eqx.field(static=True, default=0.0)
    read_noise: float = eqx.field(static=True, default=0.0)
    gain: float = eqx.field(static=True, default=1.0)
    white: float = eqx.field(static=True, default=0.0)
    bits: int = eqx.field(static=True, default=0)
    bayer: str = eqx.field(static=True, default="none")
    demosaic: str = eqx.field(static=True, default="bilinear")
    tone: str = eqx.field(static=True, default="srgb")
    table: tuple[float, ...] = eqx.field(static=True, default=())
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        check_field_types("sensor", self)
        _require(self, "chromatic", _numbers(self.chromatic, 3, above=0.0), "3 numbers above 0")
        _require(self, "vignetting", _numbers(self.vignetting, 3), "3 numbers")
        _require(
            self,
            "vignetting",
            least_transmission(self.vignetting) >= 0,
            "a1, a2, a3 with 1 + a1 r^2 + a2 r^4 + a3 r^6 at least 0 for r up to 1",
        )
        _require(
            self,
            "full_well",
            0 <= self.full_well <= MOST_ELECTRONS,
            f"in 0 ... {MOST_ELECTRONS} electrons",
        )
        for key in ("falloff", "read_noise", "white"):
            _require(self, key, 0 <= getattr(self, key) < math.inf, "at least 0")
        _require(self, "exposure", math.isfinite(self.exposure), "finite")
        _require(self, "gain", 1 <= self.gain < math.inf, "at least 1")
        _require(self, "bits", 0 <= self.bits <= 16, "in 0 ... 16")
        _require(self, "bayer", self.bayer in ("none", *PATTERNS), f"none or one of {PATTERNS}")
        _require(self, "demosaic", self.demosaic in ("bilinear", "none"), "bilinear or none")
        _require(self, "tone", self.tone in TONE_CURVES, f"one of {TONE_CURVES}")
        _require(self, "seed", 0 <= self.seed < 2**32, "in 0 ... 2^32 - 1")
        if self.tone == "table":
            _require(self, "table", _rises(self.table), "at least 2 numbers that never fall")
        elif self.table:
            raise ValueError(f"sensor.table needs sensor.tone=table, got {self.tone!r}.")
        for key, needed in (("read_noise", "full_well"), ("bits", "white")):
            if getattr(self, key) and not getattr(self, needed):
                raise ValueError(
                    f"sensor.{key} needs sensor.{needed} above 0, got {getattr(self, key)} and 0."
                )


def check_sensor(options: SensorOptions, camera: Camera, format: str) -> None:
    """Check that a camera can have this sensor, and a file format can hold its values.

    Args:
        options: the sensor.
        camera: the camera.
        format: "png" or "exr".

    Raises:
        ValueError: A key does not fit; the message names it.
    """
    if format == "exr" and options.tone != "srgb":
        raise ValueError(
            f"sensor.tone must be srgb with format=exr, which holds linear light, got "
            f"{options.tone!r}. Choose format=png."
        )
    for key in ("chromatic", "vignetting"):
        if getattr(options, key) != getattr(SensorOptions(), key):
            require_axis(f"sensor.{key}", camera.lens)


def develop(
    light: Float[Array, "h w 3"], camera: Camera, key: PRNGKeyArray, *, options: SensorOptions
) -> Float[Array, "h w 3"]:
    """Develop a picture: the sensor's linear values of the light on the film.

    The steps are those of the physics, in their order: vignetting, exposure, noise of the
    electrons, gain, colour filters, saturation, quantisation, demosaicing. Differentiable up to the
    quantisation.

    Args:
        light: linear light, 1 is white.
        camera: the camera, for the vignetting.
        key: random key of the noise (`picture_key`).
        options: the sensor.
    """
    return develop_with(sensor_numbers(options), light, camera, key, steps=options)


def develop_with(
    amounts: Mapping[str, Float[Array, "..."]],
    light: Float[Array, "h w 3"],
    camera: Camera | None,
    key: PRNGKeyArray,
    *,
    steps: SensorOptions,
) -> Float[Array, "h w 3"]:
    """`develop` with the sensor's numbers as data, which a compiled program does not hold.

    Args:
        amounts: numbers of the sensor (`sensor_numbers`).
        light: linear light, 1 is white.
        camera: the camera; only vignetting needs it.
        key: random key of the noise.
        steps: which steps the sensor takes (`sensor_steps`).
    """
    n = {name: x.astype(light.dtype) for name, x in amounts.items()}
    if steps.falloff or any(steps.vignetting):
        assert camera is not None
        edge = transmission(camera.lens, camera.film, n["falloff"], n["vignetting"])
        light = light * edge[..., None]
    if steps.exposure:
        light = apply_exposure(light, n["exposure"])
    white = n["white"] if steps.white else jnp.ones((), light.dtype)
    if steps.full_well:
        light = white * add_noise(key, light / white, n["full_well"], n["read_noise"])
    if steps.gain != 1:
        light = n["gain"] * light
    if steps.bayer != "none":
        light = mosaic(light, steps.bayer)
    if steps.white:
        light = jnp.clip(light, 0, white)
    if steps.bits:
        light = white * quantize(light / white, steps.bits)
    if steps.bayer != "none" and steps.demosaic == "bilinear":
        light = demosaic(light, steps.bayer)
    return light


# A number that stands for each step, whatever the sensor's own number is.
_STEP_NUMBERS = {"falloff": 1.0, "vignetting": (-0.5, 0.0, 0.0), "exposure": 1.0, "full_well": 1.0,
          "read_noise": 1.0, "gain": 2.0, "white": 1.0}  # fmt: skip


def sensor_numbers(options: SensorOptions) -> dict[str, Float[Array, "..."]]:
    """The numbers of a sensor that may differ from picture to picture, by key."""
    return {name: jnp.asarray(getattr(options, name), float) for name in _STEP_NUMBERS}


def sensor_steps(options: SensorOptions) -> SensorOptions:
    """A sensor that stands for all with the same steps, whatever their numbers: they share a
    compiled program."""
    off = SensorOptions()
    numbers = {k: v for k, v in _STEP_NUMBERS.items() if getattr(options, k) != getattr(off, k)}
    structure = {name: getattr(options, name) for name in ("bits", "bayer", "demosaic")}
    return SensorOptions(**numbers, **structure)


def encode(light: Float[Array, "h w 3"], *, options: SensorOptions) -> Float[Array, "h w 3"]:
    """The values that a PNG stores: the sensor's tone curve applied to its linear values.

    Args:
        light: linear values of the sensor; 1 is white.
        options: the sensor, of which `tone` and `table` are used.

    Returns:
        Encoded values, in [0, 1] for light in [0, 1].
    """
    return apply_tone_curve(light, options.tone, jnp.asarray(options.table, light.dtype))


def apply_exposure(
    light: Float[Array, "*n"], stops: Float[Array, ""] | float
) -> Float[Array, "*n"]:
    """Light times 2^stops.

    Args:
        light: linear light.
        stops: exposure; 0 changes nothing, 1 doubles the light.
    """
    return light * 2.0**stops


def quantize(value: Float[Array, "*n"], bits: int) -> Float[Array, "*n"]:
    """Round to the nearest of 2^bits even levels from 0 to 1.

    Args:
        value: linear light over the white level; values beyond 0 ... 1 are not clipped.
        bits: number of bits, at least 1.
    """
    steps = 2**bits - 1
    return jnp.round(value * steps) / steps


def sensor_record(options: SensorOptions) -> Mapping[str, Any]:
    """The sensor as a manifest records it, with the formula of its noise key."""
    record = {name: getattr(options, name) for name in options.__dataclass_fields__}
    key = "jax.random.key(seed), then fold_in of the first two little-endian 32-bit words of "
    return record | {"noise_key": key + "sha256(file_path without suffix)"}


def _rises(values: Any) -> bool:
    """Whether values are at least 2 numbers, none below the one before it."""
    if not isinstance(values, tuple | list) or not _numbers(values, len(values)):
        return False
    return len(values) > 1 and all(a <= b for a, b in itertools.pairwise(values))


def _numbers(values: Any, count: int, above: float = -math.inf) -> bool:
    if not isinstance(values, tuple | list):
        return False
    numbers = [x for x in values if isinstance(x, int | float) and above < x < math.inf]
    return len(values) == count == len(numbers)


def _require(options: SensorOptions, key: str, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"sensor.{key} must be {rule}, got {getattr(options, key)!r}.")
