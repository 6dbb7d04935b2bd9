"""Cameras that are drawn at random stand neither in objects nor behind them."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.placement import look_at
from gaussray.camera.rays import Rays
from gaussray.camera.trajectory import Trajectory
from gaussray.config.compose import compose_config
from gaussray.config.samples import sample_source
from gaussray.render.picture import render_rays
from gaussray.render.randomize.clearance import FreeSpace, ObstructedError
from gaussray.render.randomize.distributions import read_distributions
from gaussray.render.randomize.generate import draw_sample
from gaussray.render.randomize.options import DrawOptions
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene, at
from gaussray.tracer.line import light_between
from gaussray.tracer.options import TraceOptions


# A limit in space is met within this share of it.
SHARE = 0.01


def camera_at(place):
    """A camera at a place that looks along x, with a global shutter."""
    target = np.add(place, (1.0, 0, 0))
    path = look_at([float(x) for x in place], [float(x) for x in target])
    return dataclasses.replace(toy.camera(), trajectory=path)


def space_of(mean, known, **matter):
    gaussians = Gaussians.colored(np.array(mean, np.float32), (0.5, 0.5, 0.5), **matter)
    return FreeSpace(Scene(gaussians), [camera_at(x) for x in known], TraceOptions())


def is_free(space, place, clearance=0.05):
    """Whether a place is free; the clearance is in scene units."""
    try:
        space.check(camera_at(place), clearance / space.length)
    except ObstructedError:
        return False
    return True


def free_at(space, place, share):
    """Whether a place is free by a clearance relative to the scene's length."""
    return is_free(space, place, share * space.length)


def shell(count=600):
    """Points on the unit sphere: a hollow object."""
    draws = np.random.default_rng(0).normal(size=(count, 3))
    return draws / np.linalg.norm(draws, axis=1, keepdims=True)


def test_the_inside_of_a_hollow_object_and_the_space_behind_it_are_not_free():
    one_side = space_of(shell(), [(3, 0, 0)], scale=0.1)
    assert is_free(one_side, (2, 0, 0))
    assert not is_free(one_side, (0, 0, 0))
    assert not is_free(one_side, (-2, 0, 0))
    assert is_free(space_of(shell(), [(3, 0, 0), (-3, 0, 0)], scale=0.1), (-2, 0, 0))


def test_without_a_capture_the_distance_alone_counts():
    space = space_of(shell(), [], scale=0.1)
    assert is_free(space, (0, 0, 0)) and is_free(space, (-2, 0, 0))
    assert not is_free(space, (1, 0, 0))


def test_the_places_of_the_capture_are_free():
    space = space_of(shell(), [(1, 0, 0)], scale=0.1)
    assert is_free(space, (1, 0, 0))
    assert not is_free(space, (0.99, 0, 0))


def test_a_line_is_blocked_where_less_than_half_of_the_light_passes():
    # 1 - 0.6 exp(-d^2 / 2 s^2) = 1/2 at d = s sqrt(2 ln 1.2).
    scale, opacity = 0.2, 0.6
    limit = scale * math.sqrt(2 * math.log(1.2))
    for share, free in ((1 - SHARE, False), (1 + SHARE, True)):
        space = space_of([(0, limit * share, 0)], [(3, 0, 0)], scale=scale, opacity=opacity)
        assert is_free(space, (-3, 0, 0)) == free


def test_a_camera_keeps_its_distance():
    # The nearest place with half of the light is s sqrt(2 ln(0.9 / 0.5)) from the middle.
    scale, clearance = 0.1, 0.5
    edge = scale * math.sqrt(2 * math.log(0.9 / 0.5))
    for share, free in ((0.9, False), (1 + SHARE, True)):
        place = ((edge + clearance) * share, 0, 0)
        assert is_free(space_of([(0, 0, 0)], [], scale=scale), place, clearance) == free


def test_lines_let_through_the_light_that_the_tracer_lets_through():
    scene = toy.scene()
    place = np.array([0.0, -3.0, 0.5], np.float32)
    ends = place + 6 * np.random.default_rng(0).normal(size=(64, 3)).astype(np.float32)
    direction = (ends - place) / np.linalg.norm(ends - place, axis=1, keepdims=True)
    time = np.zeros(64, np.float32)
    rays = Rays(np.broadcast_to(place, (64, 3)), direction, time)
    traced = render_rays(scene, rays)
    gaussians = at(scene, jnp.float32(0))
    far = place + 1e3 * direction
    light = light_between(gaussians, jnp.asarray(place), jnp.asarray(far), options=TraceOptions())
    assert np.min(light) < 0.5 < np.max(light)
    # A ray ends where less than `transmittance_min` is left.
    np.testing.assert_allclose(1 - light, traced.alpha, atol=2e-4)


def test_clearance_has_no_unit():
    rng = np.random.default_rng(1)
    for known in ([(3.0, 0, 0)], []):
        lengths, kept = [], []
        for unit in (1.0, 1000.0):
            wall = rng.uniform(-2, 2, (2000, 3)) * (0, 1, 1) + (5, 0, 0)
            space = space_of(unit * wall, unit * np.array(known), scale=0.1 * unit)
            lengths.append(space.length / unit)
            places = [(5 - distance, 0.0, 0.0) for distance in (0.02, 0.7)]
            kept.append([free_at(space, unit * np.array(place), 0.05) for place in places])
        assert lengths[0] == pytest.approx(lengths[1], rel=0.05)
        assert kept == [[False, True], [False, True]]
        # What is seen is two units away, to the edges of the picture a little more.
        assert not known or 2 <= lengths[0] < 2.5


def test_two_half_opaque_layers_block_together():
    matter = {"scale": 0.2, "opacity": 0.4}
    assert is_free(space_of([(0, 0, 0)], [(3, 0, 0)], **matter), (-3, 0, 0))
    assert not is_free(space_of([(0, 0, 0), (1, 0, 0)], [(3, 0, 0)], **matter), (-3, 0, 0))


def test_a_moving_object_blocks_where_it_is_at_the_time_of_the_frame():
    scene = toy.scene()
    space = FreeSpace(scene, [], TraceOptions())
    places = {}
    for time in (0.0, 1.0):
        gaussians = at(scene, jnp.asarray(time, jnp.float32))
        moved = int(
            np.argmax(np.linalg.norm(gaussians.mean - at(scene, toy.single(0.5)).mean, axis=1))
        )
        places[time] = np.asarray(gaussians.mean)[moved]

    def free(place, time):
        camera = dataclasses.replace(camera_at(place), time=toy.single(time))
        try:
            space.check(camera, 0.01 / space.length)
        except ObstructedError:
            return False
        return True

    for time, place in places.items():
        assert not free(place, time)
        assert free(place, 1.0 - time)


def test_a_camera_that_moves_into_an_object_while_its_rows_are_read_is_not_free():
    space = space_of([(0, 0, 0)], [(3, 0, 0)], scale=0.1)
    path = Trajectory([-1.0, 1.0], [[1, 0, 0, 0.0]] * 2, [[2.0, 0, 0], [0, 0, 0]])
    camera = dataclasses.replace(toy.camera(), trajectory=path, time=toy.single(0))
    space.check(camera, 0.05 / space.length)
    rolling = dataclasses.replace(camera.shutter, exposure=toy.single(2.0))
    with pytest.raises(ObstructedError):
        space.check(dataclasses.replace(camera, shutter=rolling), 0.05 / space.length)


def make_none(values):
    raise ObstructedError("its camera at [0, 0, 0] stands in an object.")


def test_cameras_in_objects_are_drawn_again_also_without_redraws():
    radius = read_distributions({"aperture": {"radius": {"uniform": [0.0, 1.0]}}})

    def make(values):
        if values["aperture.radius"] > 0.1:
            raise ObstructedError("its camera stands in an object.")
        return {}, None

    drawn = [draw_sample(i, radius, make, options=DrawOptions()) for i in range(8)]
    assert all(sample.values["aperture.radius"] <= 0.1 for sample in drawn)
    assert max(sample.attempt for sample in drawn) > 0
    with pytest.raises(ValueError, match=r"in 101 attempts: .*dataset\.clearance=0\."):
        draw_sample(0, radius, make_none, options=DrawOptions())


@pytest.mark.ci
def test_samples_of_the_command_keep_their_distance():
    def source(clearance):
        words = ["scene=sample", "sample=cameras", f"dataset.clearance={clearance}"]
        return sample_source(compose_config("render", words), words)

    any_place, free = source(0), source(0.1)

    def attempts(one):
        return [
            draw_sample(i, one.distributions, one.make_job, options=one.options).attempt
            for i in range(12)
        ]

    assert not any(attempts(any_place))
    assert 0 < np.count_nonzero(attempts(free)) < 12
