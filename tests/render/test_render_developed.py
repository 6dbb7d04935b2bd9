"""Frames that are developed on their devices are those of `film`, however they are rendered."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.render import renderer as module
from gaussray.render.options import RenderOptions
from gaussray.render.parts import PIXEL, RAY, SAMPLE
from gaussray.render.renderer import Renderer
from gaussray.scene.segmented import Clip
from gaussray.tracer.traverse import Capacity


STRIPS = 8 * toy.SIZE * (RAY + SAMPLE + PIXEL) / 1e9
WAYS = {
    "whole": RenderOptions(samples=1),
    "strips": RenderOptions(samples=1, memory=STRIPS),
    "rows": RenderOptions(samples=1, chunk_rows=4),
    "until an error": RenderOptions(samples=2, error=1e-9, samples_most=8),
}


def views():
    return [record.camera for record in toy.records()[:3]]


def twice(number, values):
    """The colours times two, and the number of the frame."""
    assert isinstance(values, jax.Array)
    return 2 * values.reshape(toy.SIZE, toy.SIZE, -1)[..., :3], jnp.asarray(number)


def compare(renderer):
    expected = list(renderer.render_frames(views()))
    frames = list(renderer.render_developed(views(), twice))
    assert [int(frame.values[1]) for frame in frames] == [0, 1, 2]
    for frame, whole in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.values[0], 2 * whole.color)
        assert frame.samples == whole.samples and (frame.error is None) == (whole.error is None)


@pytest.mark.parametrize("way", WAYS)
def test_a_developed_frame_is_the_frame(way):
    compare(Renderer(toy.scene(), options=WAYS[way], trace=toy.TRACE))


def test_frames_of_several_segments_are_merged_before():
    clip = Clip((toy.carried(0.0, 0.4), toy.carried(0.4, 1.0)))
    compare(Renderer(clip, options=WAYS["whole"], trace=toy.TRACE))


def test_frames_whose_lists_were_too_short_are_developed_again(monkeypatch):
    monkeypatch.setattr(module, "staged_capacity", lambda *_: Capacity((1,), 2, 2))
    renderer = Renderer(toy.scene(), options=WAYS["whole"], trace=toy.TRACE)
    frames = list(renderer.render_developed(views(), twice))
    expected = list(renderer.render_frames(views()))
    for frame, whole in zip(frames, expected, strict=True):
        np.testing.assert_array_equal(frame.values[0], 2 * whole.color)


def test_each_of_two_devices_develops_its_own():
    run = "import test_render_developed as tests; tests.run_on_two_devices()"
    here = Path(__file__).parent
    paths = os.pathsep.join(map(str, (here, here.parent, here.parents[1])))
    devices = {"JAX_NUM_CPU_DEVICES": "2", "JAX_PLATFORMS": "cpu", "PYTHONPATH": paths}
    subprocess.run([sys.executable, "-c", run], check=True, env=os.environ | devices)


def run_on_two_devices():
    """Three frames: one on each device, and one alone."""
    renderer = Renderer(toy.scene(), options=WAYS["whole"], trace=toy.TRACE)
    assert renderer.mesh.size == 2
    places = set()

    def develop(number, values):
        places.update(values.devices())
        return twice(number, values)

    frames = list(renderer.render_developed(views(), develop))
    assert len(places) == 2
    for frame, whole in zip(frames, renderer.render_frames(views()), strict=True):
        np.testing.assert_array_equal(frame.values[0], 2 * whole.color)
