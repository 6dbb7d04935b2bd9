"""The part of a scene that blocks of rays may meet looks like the whole scene to them."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import (
    OPTIONS,
    RAYS,
    Lines,
    beside,
    fleeting,
    gaussians,
    moving,
    rays,
    resting,
    score,
    shot,
    wandering,
    weights,
)

from gaussray.tracer.trace import trace
from gaussray.tracer.traverse import Capacity
from gaussray.tracer.visible_subset import seen_counts, seen_part


# Of double precision: sums of the same numbers, of which none is left out.
SAME = 1e-12
COUNT, BLOCKS = 300, 4
ROOM = Capacity((80, 1280), 5120, 320, COUNT)
SMALL = {"size": (0.02, 0.1)}


def blocks(jitter, time):
    """Four blocks of coherent rays from a place each; their times are within `time`."""
    each, parts = RAYS // BLOCKS, []
    for i in range(BLOCKS):
        part = rays(each, seed=i, place=(0.6 * i - 0.9, 0, -3.0), jitter=jitter, spread=0.05)
        parts.append(part._replace(time=time[0] + (time[1] - time[0]) * part.time))
    lines = Lines(*(np.concatenate(x) for x in zip(*parts, strict=True)))
    # Some form no ray.
    lines.direction[::11] = 0
    return jax.tree.map(lambda x: x[None], shot(lines, np.float64))


SCENES = {
    "still": (lambda: resting(gaussians(COUNT, **SMALL), np.float64), 0.01, (0.5, 0.5)),
    "lens": (lambda: resting(gaussians(COUNT, **SMALL), np.float64), 0.1, (0.5, 0.5)),
    "rolling": (lambda: wandering(*moving(COUNT, amount=0.05, **SMALL), np.float64), 0.01, (0, 1)),
    "transient": (
        lambda: beside(
            resting(gaussians(COUNT, **SMALL), np.float64), fleeting(COUNT, seed=3, **SMALL)
        ),
        *(0.01, (0.4, 0.6)),
    ),
    "transient_resting": (
        lambda: beside(
            resting(gaussians(COUNT, **SMALL), np.float64),
            *(fleeting(COUNT, seed=3, **SMALL), (0.0, 0.3)),
        ),
        *(0.01, (0.4, 0.6)),
    ),
}


@eqx.filter_jit
def filmed(motion, lines, weight, places):
    """Pixels, what is needed, and the gradient to the scene."""

    def loss(motion):
        seen, needed = motion, None
        if places:
            seen, needed = seen_part(motion, lines, blocks=BLOCKS, places=places, options=OPTIONS)
        pixels, report = trace(seen, lines, options=OPTIONS, capacity=ROOM)
        flat = jax.tree.map(lambda x: x[0], (pixels.color, pixels.transmittance, pixels.depth))
        return score(flat, weight), (flat, needed, report)

    return jax.grad(loss, has_aux=True)(motion)


@pytest.mark.parametrize("name", SCENES)
def test_pixels_and_gradients_are_those_of_the_whole_scene(name):
    build, jitter, time = SCENES[name]
    motion, lines, weight = build(), blocks(jitter, time), weights()
    gradient, (pixels, _, report) = filmed(motion, lines, weight, ())
    needed = seen_counts(motion, lines, blocks=BLOCKS, options=OPTIONS)
    # One place is left empty.
    places = tuple(int(n) + 1 for n in needed)
    part_gradient, (part, again, _) = filmed(motion, lines, weight, places)
    np.testing.assert_array_equal(again, needed)
    for x, y in zip(part, pixels, strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=SAME)
    for x, y in zip(*map(jax.tree.leaves, (part_gradient, gradient)), strict=True):
        np.testing.assert_allclose(x, y, rtol=0, atol=SAME * max(np.abs(y).max(initial=0), 1))
    # The rays meet something, and most Gaussians are left out.
    assert int(report.dropped) == 0 and float(report.hits) > 4 * RAYS
    total = COUNT * (1 + (motion.transient is not None))
    assert 10 < int(jnp.sum(needed)) < 0.6 * total


def test_what_is_not_finite_is_kept_for_the_tracer_to_count():
    motion, lines = SCENES["transient"][0](), blocks(0.01, (0.4, 0.6))
    mean = motion.gaussians.mean.at[0, :3].set(jnp.nan)
    instant = motion.transient.instant.at[:2].set(jnp.nan)
    broken = replace(
        motion,
        gaussians=replace(motion.gaussians, mean=mean),
        transient=replace(motion.transient, instant=instant),
    )
    _, (_, _, report) = filmed(broken, lines, weights(), (COUNT, COUNT))
    assert int(report.skipped) == 5


def test_places_that_lack_are_told():
    motion, lines = SCENES["transient"][0](), blocks(0.01, (0.4, 0.6))
    part = seen_part(motion, lines, blocks=BLOCKS, places=(8, 4), options=OPTIONS)
    needed = seen_counts(motion, lines, blocks=BLOCKS, options=OPTIONS)
    np.testing.assert_array_equal(part.needed, needed)
    assert (np.asarray(needed) > (8, 4)).all()
    assert part.motion.gaussians.mean.shape[1] == 8 and part.motion.transient.count == 4
