"""Spare rows: how many; no picture shows them; scenes of about the same size share shapes."""

from dataclasses import replace

import jax
import numpy as np
import toy
from hypothesis import given, strategies

from gaussray.render.picture import render
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.scene import Scene
from gaussray.scene.spare_rows import enlarged, round_count, with_spare_rows


# Sums of the same numbers in another order, in single precision.
SAME = 1e-6


def crowd(count, seed=0):
    """A scene of so many static, moving and transient Gaussians, all in view."""
    dice = np.random.default_rng(seed)

    def some():
        return toy.gaussians(
            dice.uniform(-0.5, 0.5, (count, 3)),
            0.03,
            dice.uniform(0, 1, (count, 3)),
            dice.uniform(0.2, 0.9),
        )

    return Scene(some(), some(), toy.deformation(), (0.0, 1.0), toy.transients(count))


@given(strategies.integers(0, 10**8))
def test_a_round_number_is_at_most_a_sixteenth_too_large(count):
    rows = round_count(count)
    assert count <= rows <= max(count * 17 / 16, count + 1)
    assert round_count(rows) == rows


@given(strategies.integers(0, 10**6), strategies.integers(0, 10**6))
def test_more_gaussians_never_have_fewer_rows(one, other):
    less, more = sorted((one, other))
    assert round_count(less) <= round_count(more)


def test_scenes_of_about_the_same_size_have_the_same_shapes():
    few, more = (with_spare_rows(crowd(n)) for n in (1030, 1070))
    assert jax.tree.map(np.shape, few) == jax.tree.map(np.shape, more)


def test_every_gaussian_stays_where_it_is_and_the_others_are_transparent():
    scene = crowd(70)
    padded = with_spare_rows(scene)
    for name in ("static", "moving", "transient"):
        own, spare = getattr(scene, name), getattr(padded, name)
        assert spare.count == round_count(70) > 70
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a, b[:70]), own, spare)
        assert not np.any(spare.opacity[70:])
        assert np.all(np.isfinite(spare.mean)) and np.all(np.asarray(spare.scale) > 0)


def test_no_picture_shows_spare_rows():
    scene, camera = crowd(70), toy.camera(0.3, 0.4)
    shown, padded = (render(one, camera) for one in (scene, with_spare_rows(scene)))
    assert np.ptp(shown.color) > 0.1
    np.testing.assert_allclose(padded.color, shown.color, atol=SAME)
    np.testing.assert_allclose(padded.alpha, shown.alpha, atol=SAME)


def test_none_stay_none_and_few_stay_as_they_are():
    nothing = jax.tree.map(lambda x: x[:0], toy.scene().static)
    assert enlarged(nothing, 8).count == 0
    small = toy.scene()
    same = with_spare_rows(small)
    jax.tree.map(np.testing.assert_array_equal, small, same)


def test_what_a_field_counts_one_by_one_stays_as_many():
    scene = crowd(70)
    heads = dict.fromkeys(("mean", "rotation", "scale", "opacity", "harmonics", "logit_opacity"))
    field = ResidualField(scene.deformation.planes, (), **heads)
    padded = with_spare_rows(replace(scene, deformation=field))
    assert padded.moving.count == 70 and padded.static.count == round_count(70)
