"""A capture over whose wall a shadow passes: the scene shows it, where bodies show what moves."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.simplify.candidate import (
    at_time,
    begin_candidate,
    whole_candidate,
    without_shading,
)
from gaussray.reconstruct.simplify.finished import finished_scene
from gaussray.scene.scene import at, static_at
from gaussray.scene.shading import Shading
from gaussray.scene.store import load_scene


pytestmark = pytest.mark.usefixtures("known_sizes")

# The factor of the shaded half of the wall at the last of three times.
DARK = 0.75
# Pictures of 16 x 16 pixels in 8 bits, seen through Gaussians that spread over several.
CLOSE = 0.1
# Rounding of single precision.
ROUNDING = 1e-5
TIMES = (0.0, 0.5, 1.0)
# Places on the wall, in the shade and out of it, in front of which nothing moves.
SHADED, OPEN = [[-0.5, -0.9, 0.8]], [[0.5, -0.9, 0.8]]


def shade():
    """The left half of the wall darkens at the last time."""
    log_gain = np.zeros((3, 4, 2, 2))
    log_gain[2, :2] = np.log(DARK)
    parts = ([-1.5, -2, -2], [1.5, 2, 2], TIMES, log_gain)
    return Shading(*(toy.single(x) for x in parts))


def shaded():
    return replace(toy.scene(), shading=shade())


@pytest.fixture(scope="module")
def capture(tmp_path_factory, known_sizes):
    folder = tmp_path_factory.mktemp("capture")
    return read_capture(toy.write_capture(folder, shaded(), TIMES))


def with_fit(**changes):
    """Half a picture in the shade would pass for light that changes, if that was evened out."""
    fit = replace(toy.SHORT.fit, motion="deformation", equalize=False, **changes)
    return replace(toy.SHORT, fit=fit)


def test_the_scene_gets_the_shadow_and_keeps_it(capture, tmp_path):
    scene = reconstruct(capture, tmp_path / "run", options=with_fit(), quiet=True)
    assert scene.shading is not None
    now = [toy.single(t) for t in TIMES]
    dark = [float(scene.shading.at(toy.single(SHADED), t)[0]) for t in now]
    bright = [float(scene.shading.at(toy.single(OPEN), t)[0]) for t in now]
    np.testing.assert_allclose(dark, [1, 1, DARK], atol=CLOSE)
    np.testing.assert_allclose(bright, [1, 1, 1], atol=CLOSE)
    loaded = load_scene(tmp_path / "run")
    np.testing.assert_allclose(loaded.shading.log_gain, scene.shading.log_gain, atol=ROUNDING)


@pytest.mark.parametrize("changes", [{"shading": False}, {"motion": "none"}])
def test_without_the_option_and_where_nothing_moves_there_is_none(capture, tmp_path, changes):
    options = with_fit()
    options = replace(options, fit=replace(options.fit, **changes))
    assert reconstruct(capture, tmp_path / "run", options=options, quiet=True).shading is None


def test_an_interrupted_run_goes_on_with_the_same_shadow(capture, tmp_path, monkeypatch):
    options = with_fit(checkpoint=0.0, fine=20)
    whole = reconstruct(capture, tmp_path / "whole", options=options, quiet=True)
    with toy.stopped_after(monkeypatch, "record", 2), pytest.raises(KeyboardInterrupt):
        reconstruct(capture, tmp_path / "run", options=options, quiet=True)
    again = reconstruct(capture, tmp_path / "run", options=options, quiet=True, resume=True)
    np.testing.assert_array_equal(again.shading.log_gain, whole.shading.log_gain)
    toy.same_bytes(tmp_path / "whole", tmp_path / "run")


def test_pruning_leaves_out_a_shadow_that_is_not_needed():
    candidate = whole_candidate(shaded())
    kept = finished_scene(candidate).shading
    np.testing.assert_array_equal(kept.log_gain, shade().log_gain)
    assert finished_scene(without_shading(candidate)).shading is None
    plain = whole_candidate(toy.scene())
    assert without_shading(plain) is plain


def test_what_comes_to_rest_gets_the_shade_of_its_place():
    scene, time = shaded(), jnp.float32(1.0)
    candidate, _ = begin_candidate(scene, np.array(TIMES))
    resting = replace(candidate, resting=jnp.ones_like(candidate.resting))
    tried, finished = jax.jit(at_time)(resting, time), jax.jit(at)(finished_scene(resting), time)
    tint = np.asarray(tried.tint)[:, None]
    assert tint.shape[0] == tried.count == finished.count
    np.testing.assert_allclose(tint, 1, atol=ROUNDING)
    np.testing.assert_allclose(tried.harmonics, finished.harmonics, atol=ROUNDING)
    still = jax.jit(static_at)(finished_scene(resting), time)
    np.testing.assert_allclose(still.harmonics, finished.harmonics, atol=ROUNDING)
