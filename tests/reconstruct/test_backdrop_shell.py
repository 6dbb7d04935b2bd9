"""The shell that shows a plain backdrop: of its colour in every direction, behind everything, and
spared by pruning."""

import dataclasses

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.color import srgb_decode
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest
from gaussray.reconstruct import reconstruct
from gaussray.reconstruct.backdrop_shell import with_backdrop_shell
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.scene import Scene


PLAIN = (1.0, 0.8, 0.4)
EYES = np.array([[3.0, 0, 0], [-3, 0, 0], [0, 0, 3], [0, 1, -3]])
# Rays end where a thousandth of their light is left; colours of the shell are of single precision.
REST = 2e-3


def test_every_direction_shows_the_colour_of_the_backdrop():
    thing = Scene(toy.gaussians(np.zeros((1, 3)), 0.3, (0.1, 0.4, 0.2)))
    scene, stays = with_backdrop_shell(thing, np.zeros(1, bool), PLAIN, EYES)
    render = Renderer(scene, options=RenderOptions(samples=1), trace=toy.TRACE)
    before = Renderer(thing, options=RenderOptions(samples=1), trace=toy.TRACE)
    light = srgb_decode(np.array(PLAIN))
    for angle in np.linspace(0, 2 * np.pi, 5)[:-1]:
        camera = toy.camera(angle, 0.0, 32, 32)
        shown, alone = render(camera), before(camera)
        empty = np.asarray(alone.alpha) == 0
        assert 0.1 < empty.mean() < 1
        assert np.abs(np.asarray(shown.color)[empty] - light).max() < REST
        # What stands before it is as it was, and the backdrop fills the rest.
        filled = np.asarray(alone.color) + (1 - np.asarray(alone.alpha))[..., None] * light
        assert np.abs(np.asarray(shown.color) - filled).max() < 2 * REST
    assert len(stays) == scene.static.count + scene.moving.count


def test_all_cameras_are_inside_and_its_gaussians_stay():
    unmet = np.zeros(27, bool)
    unmet[-1] = True
    scene, stays = with_backdrop_shell(toy.scene(), unmet, PLAIN, EYES)
    count = toy.scene().static.count
    added = scene.static.count - count
    shell = np.asarray(scene.static.mean)[count:]
    middle = EYES.mean(axis=0)
    away = np.linalg.norm(shell - middle, axis=1)
    assert away.min() > 2 * np.linalg.norm(EYES - middle, axis=1).max()
    assert stays[count : count + added].all() and stays[-1] and stays.sum() == added + 1
    assert scene.moving.count == toy.scene().moving.count


def test_black_is_nothing():
    scene = toy.scene()
    same, stays = with_backdrop_shell(scene, np.zeros(27, bool), (0.01, 0.01, 0.01), EYES)
    assert same is scene and not stays.any()


@pytest.fixture(scope="module")
def before_white(tmp_path_factory):
    """Balls before white, and the folder of a capture of them."""
    folder = tmp_path_factory.mktemp("white")
    place = np.array([[-0.5, 0, 0], [0.4, 0.3, 0.2], [0.2, -0.5, 0], [0.7, -0.1, 0.3]])
    color = np.array([[0.6, 0.1, 0.1], [0.1, 0.4, 0.1], [0.1, 0.1, 0.5], [0.4, 0.3, 0.0]])
    balls = Scene(toy.gaussians(place, 0.12, color))
    render = Renderer(balls, options=RenderOptions(samples=1), trace=toy.TRACE)
    listed = toy.records(times=[0.0])
    for record in listed:
        seen = render(record.camera)
        white = np.asarray(seen.color) + 1 - np.asarray(seen.alpha)[..., None]
        write_image(folder / record.file_path, white)
    toy.write_points(folder / "points3d.ply", balls)
    write_manifest(folder / "transforms.json", listed, extra={"ply_file_path": "points3d.ply"})
    return balls, folder


@pytest.mark.ci
def test_an_object_before_white_is_fitted_with_its_backdrop(before_white, tmp_path):
    balls, folder = before_white
    fit = dataclasses.replace(toy.SHORT.fit, coarse=120, fine=30, points=40)
    density = dataclasses.replace(toy.SHORT.density, kind="relocate", gaussians=60)
    options = dataclasses.replace(toy.SHORT, fit=fit, density=density)
    scene = reconstruct(read_capture(folder), tmp_path / "run", options=options, quiet=True)
    # Opposite to all training cameras, the balls are before white, too.
    for angle in (0.15, np.pi):
        camera = toy.camera(angle, 0.0, toy.SIZE, toy.SIZE)
        views = (
            Renderer(x, options=RenderOptions(samples=1), trace=toy.TRACE)(camera)
            for x in (balls, scene)
        )
        truth, found = views
        empty = np.asarray(truth.alpha) < 1e-3
        light = np.asarray(found.color)
        assert empty.sum() > 20 and np.median(np.abs(light[empty] - 1)) < 2 * REST
        solid = np.asarray(truth.alpha) > 0.8
        assert solid.any() and light[solid].mean() < 0.6
