"""A focal length that explains matched details is found, and none where something else is off."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaussray.camera.lens import Equirectangular, Fisheye, Pinhole
from gaussray.reconstruct.checks.focal_check import (
    BETTER_FIT,
    FocalFit,
    MatchedPixels,
    explains,
    focal_fit,
    line_distances,
)


W, H, FOCAL, VIEWS = 640, 480, 500.0, 6
CENTER = (W / 2, H / 2)
LENSES = {
    "pinhole": Pinhole(FOCAL, CENTER, (-0.1, 0.02, 0.0, 0.0)),
    "fisheye": Fisheye(FOCAL, CENTER, 1.2),
}


def stacked(lens, factors=(1.0,) * VIEWS):
    """A lens for each view, with factors on its focal length."""
    each = [dataclasses.replace(lens, focal=k * lens.focal) for k in factors]
    return jax.tree.map(lambda *x: jnp.stack(x), *each)


def cameras(turn=0.25, seed=0):
    """Views that move and turn."""
    random = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(turn * random.normal(size=(VIEWS, 3))).as_matrix()
    return rotation, random.normal(size=(VIEWS, 3)) * [0.5, 0.5, 0.2]


def seen(lens, rotation, eye, noise=0.0, count=40):
    """What neighbouring views see of the same points."""
    random = np.random.default_rng(1)
    project = jax.jit(jax.vmap(lens.project))
    matched = []
    for first in range(VIEWS - 1):
        second = first + 1
        middle = rotation[first, :, 2] + rotation[second, :, 2]
        points = eye[first] + 2.5 * middle + random.normal(size=(count, 3))
        pixel, other = (
            np.asarray(project(jnp.asarray((points - eye[k]) @ rotation[k])))
            + noise * random.normal(size=(count, 2))
            for k in (first, second)
        )
        matched.append(MatchedPixels(first, second, pixel, other, 2.0))
    return matched


@pytest.mark.parametrize("kind", LENSES)
@pytest.mark.parametrize("factor", [0.7, 0.85, 1.2, 1.5])
def test_the_right_focal_length_is_found(kind, factor):
    lens, poses = LENSES[kind], cameras()
    matched = seen(lens, *poses, noise=0.3)
    found = focal_fit(stacked(lens, (1 / factor,) * VIEWS), W, matched, *poses)
    assert found is not None
    assert found.factor == pytest.approx(factor, rel=0.02) and found.error < 0.5
    assert found.recorded == pytest.approx(FOCAL / factor) and found.width == W


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0, 10.0])
@pytest.mark.parametrize("kind", LENSES)
def test_none_is_found_where_the_lens_is_right(kind, noise):
    lens, poses = LENSES[kind], cameras()
    assert focal_fit(stacked(lens), W, seen(lens, *poses, noise=noise), *poses) is None


@pytest.mark.parametrize("turned", [True, False])
def test_hardly_ever_is_one_found_for_wrong_poses(turned):
    lens, (rotation, eye) = LENSES["pinhole"], cameras()
    matched, found = seen(lens, rotation, eye), []
    for seed in range(20):
        random = np.random.default_rng(seed)
        turn = 0.02 * random.normal(size=(VIEWS, 3)) * turned
        moved = eye + 0.1 * random.normal(size=(VIEWS, 3)) * (not turned)
        off = rotation @ Rotation.from_rotvec(turn).as_matrix()
        found.append(focal_fit(stacked(lens), W, matched, off, moved))
    assert sum(fit is not None for fit in found) <= 1


def test_a_longer_lens_alone_brings_nothing_closer_to_its_line():
    """Lines of a camera that moves to the right are rows: what lies 4 pixels below is 2 steps off,
    at the middle and at the rim, however long the lens is."""
    lens = stacked(Pinhole(FOCAL, CENTER))
    rotation = np.tile(np.eye(3), (VIEWS, 1, 1))
    eye = np.arange(VIEWS)[:, None] * np.array([1.0, 0, 0])
    x, y = np.meshgrid(np.linspace(10, W - 10, 5), np.linspace(10, H - 10, 4))
    pixel = np.stack([x.ravel(), y.ravel()], axis=1)
    pair = MatchedPixels(0, 1, pixel, pixel + [-30.0, 4.0], 2.0)
    factors = np.array([0.6, 1.0, 3.0])
    # To first order in pixels of the focal length.
    found = line_distances(lens, pair, rotation, eye, factors)
    assert found == pytest.approx(np.full((3, 20), 2.0), rel=0.02)
    pairs = [pair._replace(first=k, second=k + 1) for k in range(VIEWS - 1)]
    assert focal_fit(lens, W, pairs, rotation, eye) is None


def test_few_pairs_and_lenses_without_a_focal_length_tell_none():
    lens, poses = LENSES["pinhole"], cameras()
    matched, wrong = seen(lens, *poses), stacked(lens, (0.8,) * VIEWS)
    assert focal_fit(wrong, W, matched, *poses) is not None
    assert focal_fit(wrong, W, matched[:2], *poses) is None
    assert focal_fit(wrong, W, [], *poses) is None
    assert focal_fit(stacked(Equirectangular((W / 2, H), CENTER)), W, matched, *poses) is None


def test_lenses_that_differ_have_a_factor_in_common():
    lens, poses = LENSES["pinhole"], cameras()
    factors = np.array([0.8, 0.8, 0.8, 0.8, 0.8, 0.81])
    found = focal_fit(stacked(lens, factors), W, seen(lens, *poses), *poses)
    assert found is not None and found.recorded is None
    assert found.words == f"{found.factor:.2f} times as long"


def test_words_tell_the_focal_length_of_the_pictures():
    found = FocalFit(0.8502, 0.7, 585.0, 640)
    assert found.words == (
        "0.85 times as long: multiply fl_x and fl_y by that (497 instead of 585 pixels, in "
        "pictures 640 pixels wide)"
    )


def test_details_are_explained_if_they_fit_and_fit_much_better():
    assert explains(0.7, 2.2) and not explains(0.8, 2.2) and not explains(1.6, 20.0)
    assert explains(0.99, 0.99 * BETTER_FIT + 0.01)
