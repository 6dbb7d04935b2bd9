"""Pictures are developed on the device into what their files store."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.sensor.sensor import SensorOptions, encode
from gaussray.dataset.images import srgb_levels
from gaussray.render.develop import develop_picture, picture_levels, write_picture
from gaussray.render.options import NO_SENSOR


# Tone curves in single precision differ from double precision by 1e-7 of white, 3e-5 of a level.
CURVE = 1e-3
SHAPE = toy.SIZE, toy.SIZE, 3


def record(suffix):
    one = toy.records(times=(0.5,), cameras=("cam_3",))[0]
    return dataclasses.replace(one, file_path=f"images/a.{suffix}")


def light():
    dice = np.random.default_rng(0)
    values = np.exp(dice.uniform(-18, 1.5, SHAPE)) * dice.choice([1, 1, 1, -1], SHAPE)
    return values.astype(np.float32)


def developed(values, suffix, sensor=NO_SENSOR):
    return jax.device_get(develop_picture(record(suffix), jnp.asarray(values), sensor))


def test_a_png_gets_the_levels_of_the_light_whatever_else_is_in_its_values():
    values = np.dstack([light(), np.full((*SHAPE[:2], 2), np.nan, np.float32)])
    picture = developed(values.reshape(1, -1, 5), "png")
    assert picture.values.dtype == np.uint8 and picture.unfit == 0
    np.testing.assert_array_equal(picture.values, srgb_levels(light().astype(np.float64)))
    np.testing.assert_array_equal(picture_levels(record("png"), light(), NO_SENSOR), picture.values)


def test_an_exr_gets_halves_rounded_to_nearest():
    picture = developed(light(), "exr")
    assert picture.values.dtype == np.float16
    np.testing.assert_array_equal(picture.values, light().astype(np.float16))
    assert picture.largest == np.abs(light()).max()
    fine = developed(light(), "exr", SensorOptions(white=1.0, bits=12))
    assert fine.values.dtype == np.float32
    np.testing.assert_allclose(fine.values, np.clip(np.round(light() * 4095) / 4095, 0, 1), 1e-6)


def test_light_that_a_format_cannot_hold_is_refused(tmp_path):
    values = light()
    values[0, 0] = np.nan, np.inf, 1
    with pytest.raises(ValueError, match="stored in 8 bits must be finite, got 2 values"):
        write_picture(tmp_path / "a.png", developed(values, "png"))
    with pytest.raises(ValueError, match="stored in 8 bits must be finite, got 2 values"):
        picture_levels(record("png"), values, NO_SENSOR)
    write_picture(tmp_path / "a.exr", developed(values, "exr"))
    values[0, 1] = -7e4
    with pytest.raises(ValueError, match="b.exr: .* within 65504, got 70000.0"):
        write_picture(tmp_path / "b.exr", developed(values, "exr"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.parametrize("tone", ["linear", "filmic", "table"])
def test_tone_curves_give_the_levels_of_double_precision(tone):
    table = tuple((k / 8) ** 0.4 for k in range(9)) if tone == "table" else ()
    sensor = SensorOptions(tone=tone, table=table)
    exact = 255 * np.clip(encode(jnp.asarray(light(), float), options=sensor), 0, 1)
    ours = developed(light(), "png", sensor).values
    tie = np.abs(exact % 1 - 0.5) < CURVE
    np.testing.assert_array_equal(ours[~tie], np.floor(exact + 0.5)[~tie])
    assert np.abs(ours - exact).max() < 0.5 + CURVE and tie.mean() < 0.01
