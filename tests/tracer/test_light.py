"""Light that changes over time: each ray sees its colour times the light at its own time."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scenes import (
    CAPACITY,
    COUNT,
    OPTIONS,
    beside,
    fleeting,
    gaussians,
    look,
    moving,
    rays,
    resting,
    shot,
    wandering,
    weights,
)

from gaussray.runtime import cuda
from gaussray.scene.light import Light
from gaussray.tracer.measure import measure
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.vector_blend import blended_vector, color_by_vector


# Double precision: the same product in another order. Single precision: its rounding.
EXACT, SINGLE = 1e-12, 1e-6
TIME, GAIN = np.array([0.2, 0.5, 0.9]), np.array([[0.5, 1, 1], [2, 1, 0.3], [1, 3, 1]])


def lamp(dtype=np.float64):
    return Light(jnp.asarray(TIME, dtype), jnp.asarray(GAIN, dtype))


def factor(time):
    """Straight lines between the times, by hand."""
    return np.stack([np.interp(np.asarray(time), TIME, gain) for gain in GAIN.T], axis=-1)


SCENES = {
    "still": lambda dtype: resting(gaussians(COUNT), dtype),
    "moving": lambda dtype: wandering(*moving(COUNT), dtype),
    "transient": lambda dtype: beside(resting(gaussians(COUNT), dtype), fleeting(COUNT)),
}


@pytest.mark.parametrize("name", SCENES)
def test_colours_are_multiplied_and_nothing_else(name):
    motion, lines = SCENES[name](np.float64), shot(rays(), np.float64)
    room = measure(motion, lines, options=OPTIONS)
    usual, _ = look(motion, lines, options=OPTIONS, capacity=room)
    shown, report = look(replace(motion, light=lamp()), lines, options=OPTIONS, capacity=room)
    assert int(report.dropped) == 0
    np.testing.assert_allclose(shown.color, usual.color * factor(lines.time), rtol=EXACT)
    np.testing.assert_array_equal(shown.transmittance, usual.transmittance)
    np.testing.assert_array_equal(shown.depth, usual.depth)
    assert np.ptp(factor(lines.time)) > 1


def in_single_precision(options):
    """What machine code shows of a lit scene beside the arrays, with samples."""
    motion = replace(SCENES["transient"](np.float32), light=lamp(np.float32))
    one = shot(rays(256), np.float32)
    twice = {k: jnp.stack([getattr(one, k)] * 2) for k in ("origin", "direction")}
    lines = replace(one, **twice, time=jnp.stack([one.time, one.time[::-1]]))
    room = measure(motion, lines, options=options)
    shown, _ = look(motion, lines, options=options, capacity=room)
    usual, _ = look(replace(motion, light=None), lines, options=options, capacity=room)
    assert float(jnp.max(usual.color)) > 0.1
    np.testing.assert_allclose(
        shown.color, usual.color * factor(lines.time), rtol=SINGLE, atol=SINGLE
    )


def test_machine_code_is_lit_too():
    in_single_precision(TraceOptions(transmittance_min=0.0))


@pytest.mark.gpu
@pytest.mark.skipif(not cuda.available(), reason="needs a CUDA device")
def test_cuda_kernels_are_lit_too():
    in_single_precision(TraceOptions(backend="kernel", transmittance_min=0.0))


def test_gradients_reach_the_light_and_the_times():
    lines = shot(rays(), np.float64)

    def seen(light, time):
        motion = replace(SCENES["still"](np.float64), light=light)
        return jnp.sum(weights()[:, :3] * _color(motion, replace(lines, time=time)))

    check_grads(seen, (lamp(), lines.time), order=1, modes=["rev"], rtol=1e-5)


def _color(motion, lines):
    return look(motion, lines, options=OPTIONS, capacity=CAPACITY)[0].color


def test_vectors_are_not_lit():
    motion, lines = replace(SCENES["still"](np.float64), light=lamp()), shot(rays(), np.float64)

    def up(gaussians):
        return jnp.ones_like(gaussians.mean)

    pixels, _ = look(color_by_vector(motion, up, 1.0), lines, options=OPTIONS, capacity=CAPACITY)
    alpha = np.asarray(1 - pixels.transmittance)[:, None]
    np.testing.assert_allclose(blended_vector(pixels, 1.0), alpha * np.ones(3), atol=EXACT)
