"""A focus pull: even in reciprocal distance, at rest at its knots, and differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.aperture import Aperture, focused, thin_lens
from gaussray.camera.focus_pull import FocusPull
from gaussray.geometry import normalize


EXACT = 1e-12
GRADIENT = 1e-5
SIDEWAYS = normalize(jnp.array([0.5, -0.3, 1.0]))


def pulled(ease="linear", distance=(1.0, 4.0, np.inf)):
    pull = FocusPull(jnp.array([0.0, 1.0, 3.0]), jnp.array(distance), ease)
    return Aperture(jnp.array(0.3), pull)


at = jax.jit(lambda lens, time: focused(lens, time).focus_distance)


@pytest.mark.parametrize(
    "ease, time, expected",
    [
        ("linear", -1.0, 1.0),
        ("linear", 0.0, 1.0),
        ("linear", 0.5, 1.6),  # half way from 1 to 1/4
        ("linear", 1.0, 4.0),
        ("linear", 2.0, 8.0),
        ("linear", 9.0, np.inf),
        ("smooth", 0.25, 1 / (1 - 0.75 * 0.15625)),  # 3/16 - 2/64
        ("smooth", 0.5, 1.6),
    ],
)
def test_focus_is_pulled_evenly_in_reciprocal_distance(ease, time, expected):
    np.testing.assert_allclose(at(pulled(ease), jnp.array(time)), expected, rtol=EXACT)


def test_a_smooth_pull_rests_at_its_knots_and_never_overshoots():
    h = 1e-6
    speed = (at(pulled("smooth"), jnp.array(1 - h)) - 4) / h
    assert abs(speed) < 1e-3 < abs((at(pulled(), jnp.array(1 - h)) - 4) / h)
    time = jnp.linspace(-1, 2.9, 200)
    distance = jax.vmap(at, in_axes=(None, 0))(pulled("smooth"), time)
    assert np.all(np.diff(distance) >= 0)


def test_gradients_of_a_focus_pull_are_right_and_finite_at_infinity():
    lens = pulled("smooth", (1.0, 4.0, 6.0))
    check_grads(at, (lens, jnp.array(1.7)), order=1, modes=["rev"], rtol=GRADIENT)
    slope = jax.grad(lambda t: thin_lens(
        focused(pulled(), t), SIDEWAYS, jnp.array([0.8, 0.3]))[1][0])  # fmt: skip
    assert all(np.isfinite(slope(jnp.array(t))) for t in (2.5, 3.0, 4.0))


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: pulled("fast"), "aperture.focus_distance.ease must be one of"),
        (lambda: pulled(distance=(1.0, -1.0, 2.0)), "aperture.focus_distance.distance must be ab"),
        (lambda: pulled(distance=(1.0, 2.0)), "one distance for each of at least one time"),
        (
            lambda: FocusPull(jnp.array([1.0, 0.0]), jnp.array([1.0, 2.0])),
            "aperture.focus_distance.time must be finite and strictly increasing",
        ),
    ],
)
def test_what_is_no_focus_pull_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()
