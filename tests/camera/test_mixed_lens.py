"""A mixed lens is the lens that it has chosen, also among others of a stack."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray.camera.corrections import require_correctable
from gaussray.camera.lens import KannalaBrandt, pinhole
from gaussray.camera.mixed_lens import MixedLens


SIZE = (48, 32)
# Directions and pixels in single precision.
CLOSE = 1e-5
PIXELS = jnp.asarray(np.random.default_rng(0).uniform((0, 0), SIZE, (40, 2)), jnp.float32)
POINTS = jnp.asarray([[0.1, -0.2, 2.0], [-0.4, 0.3, 1.0], [0.2, 0.1, -1.0]], jnp.float32)


def lenses():
    focal, center = jnp.full(2, 20.0), jnp.asarray([25.0, 15.0])
    return (
        pinhole(0.9 * focal, center),
        KannalaBrandt(focal, center, jnp.asarray([0.05, 0.01, 0.0, 0.0]), jnp.asarray(3.0)),
        KannalaBrandt(1.3 * focal, center, jnp.asarray([-0.03, 0.0, 0.0, 0.0]), jnp.asarray(2.5)),
    )


def mixed():
    """The three lenses in two kinds, as cameras that are stacked have them."""
    first, second, third = lenses()
    number = jnp.asarray
    return (
        MixedLens((first, second), number(0)),
        MixedLens((first, second), number(1)),
        MixedLens((first, third), number(1)),
    )


def test_each_lens_of_a_stack_is_the_one_that_it_has_chosen():
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *mixed())
    seen = jax.vmap(lambda lens: jax.vmap(lens.direction)(PIXELS))(stacked)
    places = jax.vmap(lambda lens: jax.vmap(lens.project)(POINTS))(stacked)
    for k, own in enumerate(lenses()):
        np.testing.assert_allclose(seen[k], jax.vmap(own.direction)(PIXELS), atol=CLOSE)
        np.testing.assert_allclose(places[k], jax.vmap(own.project)(POINTS), rtol=CLOSE)


def test_gradients_are_those_of_the_chosen_lens():
    for lens, own in zip(mixed(), lenses(), strict=True):
        ray = jax.jacfwd(lens.direction)(PIXELS[0])
        np.testing.assert_allclose(ray, jax.jacfwd(own.direction)(PIXELS[0]), atol=CLOSE)


def test_a_part_of_the_picture_is_that_of_the_chosen_lens():
    box, size = (8, -4, 24, 40), (12, 20)
    for lens, own in zip(mixed(), lenses(), strict=True):
        part, expected = (x.resized(SIZE, box, size) for x in (lens, own))
        np.testing.assert_allclose(
            jax.vmap(part.direction)(PIXELS / 4),
            jax.vmap(expected.direction)(PIXELS / 4),
            atol=CLOSE,
        )


def test_what_is_written_is_the_chosen_lens():
    for lens, own in zip(mixed(), lenses(), strict=True):
        assert lens.record().keys == own.record().keys
        assert lens.sees_sideways == own.sees_sideways


def test_there_must_be_such_a_lens():
    with pytest.raises(ValueError, match=r"lens.chosen must be the number of one of the 2 lenses"):
        MixedLens(lenses()[:2], jnp.asarray(2))


def test_refinement_of_lenses_says_what_it_needs():
    with pytest.raises(ValueError, match=r"fit.refine=\[lens\] must be for cameras of one lens"):
        require_correctable(mixed()[0])
