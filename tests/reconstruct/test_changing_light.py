"""A capture whose light changes: the scene shows what stands still in the light of each time."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.light import Light
from gaussray.scene.store import load_scene


pytestmark = pytest.mark.usefixtures("known_sizes")

# The factor of the last picture's light against the first one's; pictures of 16 x 16 pixels in 8
# bits, of which some move, tell it to some percent.
BRIGHTER, CLOSE = 1.6, 0.05
TIMES = (0.0, 0.5, 1.0)


@pytest.fixture(scope="module")
def capture(tmp_path_factory, known_sizes):
    gain = np.linspace(1, BRIGHTER, 3)[:, None] * np.ones(3)
    light = Light(toy.single(TIMES), toy.single(gain / gain[1]))
    folder = tmp_path_factory.mktemp("capture")
    return read_capture(toy.write_capture(folder, replace(toy.scene(), light=light), TIMES))


def test_the_scene_gets_the_light_and_keeps_it(capture, tmp_path, capsys):
    scene = reconstruct(capture, tmp_path / "run", options=toy.SHORT)
    assert "the light by up to 0.7 stops" in capsys.readouterr().out
    first, last = scene.light.at(jnp.asarray([0.0, 1.0]))
    np.testing.assert_allclose(last / first, BRIGHTER, rtol=CLOSE)
    loaded = load_scene(tmp_path / "run")
    np.testing.assert_allclose(loaded.light.gain, scene.light.gain)
    # A still part of the picture: the corner.
    render = Renderer(loaded, options=RenderOptions(samples=1), trace=toy.TRACE)
    corner = [render(toy.camera(time=t)).color[:3, :3].mean() for t in (0.0, 1.0)]
    np.testing.assert_allclose(corner[1] / corner[0], BRIGHTER, rtol=2 * CLOSE)


def test_without_the_option_pictures_stay_as_they_are(capture, tmp_path):
    options = replace(toy.SHORT, fit=replace(toy.SHORT.fit, equalize=False))
    assert reconstruct(capture, tmp_path / "run", options=options, quiet=True).light is None
