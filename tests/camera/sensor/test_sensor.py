"""The sensor: its parts in the order of the physics, each nothing at its default."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from jax.test_util import check_grads

from gaussray.camera.sensor.mosaic import demosaic, mosaic
from gaussray.camera.sensor.noise import add_noise, picture_key
from gaussray.camera.sensor.sensor import (
    SensorOptions,
    apply_exposure,
    check_sensor,
    develop,
    develop_with,
    encode,
    quantize,
    sensor_numbers,
    sensor_record,
    sensor_steps,
)
from gaussray.camera.sensor.vignetting import transmission


# A few operations in double precision.
EXACT = 1e-12
GRADIENT = 1e-5
CAMERA = toy.camera(width=6, height=4)
LIGHT = jnp.asarray(np.random.default_rng(0).uniform(0, 1.5, (4, 6, 3)))
KEY = picture_key(3, "a")


def developed(light=LIGHT, **chosen):
    return develop(light, CAMERA, KEY, options=SensorOptions(**chosen))


def test_by_default_light_stays_what_it_is():
    np.testing.assert_array_equal(developed(), LIGHT)
    assert not jax.tree.leaves(SensorOptions())
    program = jax.make_jaxpr(lambda x: develop(x, CAMERA, KEY, options=SensorOptions()))(LIGHT)
    assert not program.eqns


def test_stops_double_light_and_add():
    np.testing.assert_allclose(developed(exposure=1.0), 2 * LIGHT, rtol=EXACT)
    np.testing.assert_allclose(developed(exposure=-0.5, gain=2.0), 2**0.5 * LIGHT, rtol=EXACT)
    twice = apply_exposure(apply_exposure(LIGHT, 0.7), -1.9)
    np.testing.assert_allclose(twice, apply_exposure(LIGHT, -1.2), rtol=EXACT)
    # Light of two exposures, and of one that lasts as long as both.
    both = apply_exposure(LIGHT, 0.7) + apply_exposure(LIGHT, -1.9)
    np.testing.assert_allclose(both, apply_exposure(LIGHT, np.log2(2**0.7 + 2**-1.9)), rtol=EXACT)


def test_values_end_at_white_and_count_evenly_up_to_it():
    cut = developed(white=0.8)
    np.testing.assert_array_equal(cut, np.clip(LIGHT, 0, 0.8))
    counted = np.asarray(developed(white=0.8, bits=3)) / 0.8 * 7
    np.testing.assert_allclose(counted, np.round(counted), atol=1e-9)
    assert set(np.round(counted).ravel()) == set(range(8))
    assert np.abs(counted / 7 * 0.8 - cut).max() <= 0.8 / 14 + EXACT
    assert quantize(jnp.array([0.0, 0.5, 1.0]), 1).tolist() == [0, 0, 1]  # ties to even


def test_the_parts_come_in_the_order_of_the_physics():
    chosen = {
        "falloff": 4.0,
        "vignetting": (-0.2, 0.0, 0.0),
        "exposure": -1.0,
        "full_well": 900.0,
        "read_noise": 2.0,
        "gain": 4.0,
        "white": 2.0,
        "bits": 5,
        "bayer": "GRBG",
    }
    edge = jnp.array(4.0), jnp.array([-0.2, 0.0, 0.0])
    x = LIGHT * transmission(CAMERA.lens, CAMERA.film, *edge)[..., None] / 2
    x = 4 * 2 * add_noise(KEY, x / 2, 900.0, 2.0)
    x = jnp.clip(mosaic(x, "GRBG"), 0, 2)
    x = demosaic(jnp.round(x / 2 * 31) / 31 * 2, "GRBG")
    np.testing.assert_allclose(developed(**chosen), x, atol=EXACT)
    raw = developed(**chosen, demosaic="none")
    assert np.all(np.count_nonzero(np.asarray(raw), axis=-1) <= 1)
    np.testing.assert_allclose(demosaic(raw, "GRBG"), x, atol=EXACT)


def test_gain_amplifies_light_and_noise_alike():
    dark = developed(exposure=-3.0, full_well=500.0, read_noise=1.0)
    amplified = developed(exposure=-3.0, full_well=500.0, read_noise=1.0, gain=8.0)
    np.testing.assert_allclose(amplified, 8 * dark, rtol=EXACT)


def test_a_stop_less_of_light_is_noisier_by_the_root_of_two():
    """With light alone: mean over deviation is the root of the electrons."""
    even = jnp.full((60, 60, 3), 0.5)
    camera, ratio = toy.camera(width=60, height=60), []
    for stops in (0.0, -1.0):
        options = SensorOptions(exposure=stops, full_well=800.0)
        seen = np.asarray(develop(even, camera, KEY, options=options))
        ratio.append(seen.mean() / seen.std())
    # A deviation is known to 1/sqrt(2 n): five of them, of two estimates.
    bound = 5 * np.sqrt(2 / (2 * even.size))
    assert abs(ratio[0] / ratio[1] / np.sqrt(2) - 1) < bound
    assert abs(ratio[0] / np.sqrt(400) - 1) < bound


def test_stored_values_are_those_of_the_curve():
    table = (0.0, 0.9, 1.0)
    options = SensorOptions(tone="table", table=table)
    expected = np.interp(np.asarray(LIGHT), [0, 0.5, 1], table)
    np.testing.assert_allclose(encode(LIGHT, options=options), expected, atol=EXACT)
    np.testing.assert_array_equal(encode(LIGHT, options=SensorOptions(tone="linear")), LIGHT)


def test_gradients_reach_the_light_through_all_that_is_smooth():
    options = SensorOptions(
        falloff=4.0, vignetting=(-0.1, 0.0, 0.0), exposure=0.5, bayer="RGGB", tone="filmic"
    )

    def stored(light):
        light = jnp.asarray(light)
        return encode(develop(light, CAMERA, KEY, options=options), options=options)

    light = jnp.asarray(np.random.default_rng(1).uniform(0.1, 0.6, (4, 6, 3)))
    check_grads(stored, (light,), 1, ("rev",), GRADIENT, GRADIENT)
    check_grads(
        lambda s: apply_exposure(light, jnp.asarray(s)),
        (jnp.array(0.3),),
        1,
        ("rev",),
        GRADIENT,
        GRADIENT,
    )


def test_a_manifest_records_every_key():
    told = sensor_record(SensorOptions(seed=5, bayer="RGGB"))
    assert json.loads(json.dumps(told))["seed"] == 5
    assert set(told) == {*SensorOptions.__dataclass_fields__, "noise_key"}


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"chromatic": (1.0, 0.0, 1.0)}, "sensor.chromatic must be 3 numbers above 0"),
        ({"chromatic": (1.0, 1.0)}, "sensor.chromatic must be 3 numbers"),
        ({"vignetting": (0.1,)}, "sensor.vignetting must be 3 numbers"),
        ({"vignetting": (-1.5, 0.0, 0.0)}, "sensor.vignetting must be a1, a2, a3 with"),
        ({"falloff": -1.0}, "sensor.falloff must be at least 0, got -1.0"),
        ({"exposure": np.inf}, "sensor.exposure must be finite"),
        ({"full_well": -5.0}, "sensor.full_well must be in 0 ... 100000 electrons"),
        ({"full_well": 2e5}, "sensor.full_well must be in 0 ... 100000 electrons"),
        ({"gain": 0.5}, "sensor.gain must be at least 1, got 0.5"),
        ({"bits": 17, "white": 1.0}, "sensor.bits must be in 0 ... 16, got 17"),
        ({"bits": 8}, "sensor.bits needs sensor.white above 0"),
        ({"read_noise": 2.0}, "sensor.read_noise needs sensor.full_well above 0"),
        ({"bayer": "RGBG"}, "sensor.bayer must be none or one of"),
        ({"demosaic": "ahd"}, "sensor.demosaic must be bilinear or none"),
        ({"tone": "aces"}, "sensor.tone must be one of"),
        ({"tone": "table"}, "sensor.table must be at least 2 numbers"),
        ({"tone": "table", "table": (0.0, 1.0, 0.5)}, "sensor.table must be"),
        ({"table": (0.0, 1.0)}, "sensor.table needs sensor.tone=table"),
        ({"seed": -1}, "sensor.seed must be in 0"),
    ],
)
def test_a_sensor_that_cannot_be_is_named(chosen, message):
    with pytest.raises(ValueError) as error:
        SensorOptions(**chosen)
    assert str(error.value).startswith(message)


def test_linear_light_has_no_curve():
    check_sensor(SensorOptions(tone="filmic"), CAMERA, "png")
    with pytest.raises(ValueError, match="sensor.tone must be srgb with format=exr"):
        check_sensor(SensorOptions(tone="filmic"), CAMERA, "exr")


def test_sensors_of_the_same_steps_are_one_program_and_each_keeps_its_numbers():
    traces = []

    @eqx.filter_jit
    def compiled(amounts, light, *, steps):
        traces.append(steps)
        return develop_with(amounts, light, CAMERA, KEY, steps=steps)

    for exposure, gain, seed in ((1.0, 2.0, 0), (-0.5, 4.0, 7)):
        chosen = SensorOptions(
            vignetting=(-0.2, 0.0, 0.1), exposure=exposure, full_well=500.0, read_noise=3.0,
            gain=gain, white=1.5, bits=10, bayer="RGGB", seed=seed,
        )  # fmt: skip
        found = compiled(sensor_numbers(chosen), LIGHT, steps=sensor_steps(chosen))
        # One of 1023 steps: what is compiled as one may be rounded to the other side of a half.
        expected = develop(LIGHT, CAMERA, KEY, options=chosen)
        assert np.mean(np.abs(found - expected) > 1e-6) < 0.01
        assert np.max(np.abs(found - expected)) < 1.001 * 1.5 / 1023
    assert len(traces) == 1
    assert sensor_steps(SensorOptions(seed=3, chromatic=(1.0, 1.1, 1.0))) == SensorOptions()
