"""Shadows that pass over a wall are measured in the pictures of cameras that stand still."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_rays
from gaussray.color import srgb_encode
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels
from gaussray.reconstruct.initialize.shadows import measured_shading


SIZE, SIDE, TIMES = 64, 8, 6
# Colours are averaged over 3 pixels of a shadow that is 40 wide, and a cell of the grid is 4 wide.
BLURRED = 0.06
# What is left of noise of 2 % of the light in pictures of 9 pixels each and medians of 4 cameras.
QUIET = 0.01
ANGLES = (-0.4, -0.1, 0.2, 0.5)


def shadow(x, y, time):
    """A soft shadow that passes from left to right over the wall z = 0."""
    return 1 - 0.6 * np.exp(-0.5 * (((x + 0.8 - 0.3 * time) / 0.35) ** 2 + (y / 0.5) ** 2))


def filmed(gain=shadow, *, angles=ANGLES, noise=0.0, passing=False, turning=0.0):
    """Footage of a wall of random colours under a gain of place and time."""
    dice, pictures, cameras, names = np.random.default_rng(0), [], [], []
    base = dice.uniform(0.2, 0.6, (40, 40, 3))
    for number, angle in enumerate(angles):
        for time in range(TIMES):
            camera = toy.camera(angle + turning * time, float(time), width=SIZE, height=SIZE)
            y, x = np.mgrid[:SIZE, :SIZE] + 0.5
            pixel = jnp.asarray(np.stack([x, y], -1).reshape(-1, 2), jnp.float32)
            rays = camera_rays(camera, pixel, jnp.full((len(pixel), 5), 0.5, jnp.float32))
            origin, direction = (np.asarray(v, np.float64) for v in (rays.origin, rays.direction))
            hit = origin - direction * (origin[:, 2:] / direction[:, 2:])
            cell = np.clip(((hit[:, :2] + 2) * 10).astype(int), 0, 39)
            light = base[cell[:, 1], cell[:, 0]] * gain(hit[:, 0], hit[:, 1], time)[:, None]
            light = (light * (1 + noise * dice.normal(size=light.shape))).reshape(SIZE, SIZE, 3)
            if passing and number == 0:
                # Something bright before one camera alone.
                light[10 * time : 10 * time + 12] = 0.9
            pictures.append(np.rint(255 * srgb_encode(np.clip(light, 0, 1))).astype(np.uint8))
            cameras.append(camera)
            names.append(f"camera {number}")
    camera = jax.tree.map(lambda *x: jnp.stack(x), *cameras)
    pixels = tile_pixels(camera.film, SIDE)
    tiles = np.stack([cut(p, pixels) for p in pictures])
    return Footage(tiles, None, camera, np.array(names), SIDE)


def wall(count=4000):
    place = np.random.default_rng(1).uniform(-1, 1, (count, 3))
    return (place * [1, 1, 0]).astype(np.float32)


def error(shading, place, gain=shadow):
    """Difference of the logarithms of measured and true factors, beside their median over time."""
    times = np.arange(TIMES)
    found = np.log(np.stack([shading.at(jnp.asarray(place), jnp.float32(t)) for t in times]))
    true = np.log(np.stack([gain(place[:, 0], place[:, 1], t) for t in times]))
    return found - (true - np.median(true, axis=0))


@pytest.mark.parametrize("passing", [False, True])
def test_a_shadow_is_measured_where_it_is(passing):
    place = wall()
    found = measured_shading(filmed(passing=passing), place)
    inner = place[np.all(np.abs(place[:, :2]) < 0.9, axis=1)]
    off = error(found, inner)
    # At most times; where the shadow is so dark that pixels count as moving, others tell.
    assert np.quantile(np.abs(off), 0.5) < BLURRED / 2
    true = np.log(np.stack([shadow(inner[:, 0], inner[:, 1], t) for t in range(TIMES)]))
    before = true - np.median(true, axis=0)
    assert np.mean(off**2) < 0.5 * np.mean(before**2)


def test_a_faint_shadow_is_measured_everywhere():
    def faint(x, y, time):
        return shadow(x, y, time) ** 0.2

    place = wall()
    found = measured_shading(filmed(faint), place)
    inner = place[np.all(np.abs(place[:, :2]) < 0.9, axis=1)]
    assert np.quantile(np.abs(error(found, inner, faint)), 0.95) < BLURRED


def test_noise_is_no_shadow():
    def steady(x, y, time):
        return np.ones_like(x)

    assert measured_shading(filmed(steady), wall()) is None
    found = measured_shading(filmed(steady, noise=0.02), wall())
    assert found is None or np.quantile(np.abs(found.log_gain), 0.95) < QUIET


def test_two_cameras_or_cameras_that_move_tell_nothing():
    assert measured_shading(filmed(angles=ANGLES[:2]), wall()) is None
    assert measured_shading(filmed(turning=0.02), wall()) is None
    assert measured_shading(filmed(), wall(0)) is None
