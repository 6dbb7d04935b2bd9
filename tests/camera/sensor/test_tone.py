"""What a picture stores of linear light, curve by curve."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.sensor.tone import TONE_CURVES, apply_tone_curve
from gaussray.color import srgb_encode


# A few operations in double precision.
EXACT = 1e-12
GRADIENT = 1e-5
TABLE = jnp.array([0.0, 0.6, 0.8, 1.0, 1.0])
LIGHT = jnp.linspace(0, 1, 33)


def one(light, curve):
    return float(apply_tone_curve(jnp.array([float(light)]), curve, TABLE)[0])


def test_the_standard_curve():
    # IEC 61966-2-1 by hand: 1.055 0.5^(1/2.4) - 0.055, and 12.92 x near black.
    assert one(0.5, "srgb") == pytest.approx(0.7353569830524495, abs=EXACT)
    assert one(0.001, "srgb") == pytest.approx(0.01292, abs=EXACT)


def test_linear_stores_the_light():
    np.testing.assert_array_equal(apply_tone_curve(LIGHT, "linear", TABLE), LIGHT)


def test_a_table_is_straight_between_its_values():
    for light, value in ((0, 0), (0.25, 0.6), (0.375, 0.7), (0.9, 1), (3, 1), (-1, 0)):
        assert one(light, "table") == pytest.approx(value, abs=EXACT)


def test_the_filmic_curve_rolls_highlights_off():
    white = float(srgb_encode(np.array(2.54 / 3.16)))
    assert one(1.0, "filmic") == pytest.approx(white, abs=EXACT)
    assert one(0.0, "filmic") == 0 and one(-0.1, "filmic") == 0
    # Where sRGB has run out of values there still are some: up to 2.51 / 2.43, which is above 1.
    assert white < one(2.0, "filmic") < one(4.0, "filmic") < 1
    assert one(1e6, "filmic") == pytest.approx(float(srgb_encode(np.array(2.51 / 2.43))), abs=1e-5)


@pytest.mark.parametrize("curve", TONE_CURVES)
def test_more_light_never_stores_less(curve):
    stored = np.asarray(apply_tone_curve(jnp.linspace(-0.1, 9, 500), curve, TABLE))
    assert np.all(np.diff(stored) >= 0)


@pytest.mark.parametrize("curve", TONE_CURVES)
def test_gradients(curve):
    inside = jnp.array([0.001, 0.13, 0.4, 0.61, 0.9])

    def stored(light):
        return apply_tone_curve(jnp.asarray(light), curve, TABLE)

    check_grads(stored, (inside,), 1, ("rev",), GRADIENT, GRADIENT)
