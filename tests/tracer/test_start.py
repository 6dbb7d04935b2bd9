"""Rays that begin to see at a distance are rays that begin there, by any backend."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import COUNT, OPTIONS, RAYS, gaussians, rays, resting, shot
from single import roomy

from gaussray.camera.rays import moved_to_start
from gaussray.tracer.measure import measure
from gaussray.tracer.trace import trace


# The same lists of the same rays: rounding of single precision.
SAME = 1e-5
BACKENDS = ["array", "auto", pytest.param("kernel", marks=pytest.mark.gpu)]


@pytest.mark.parametrize("backend", BACKENDS)
def test_colours_are_those_of_moved_rays_and_distances_count_from_the_origin(backend):
    options, motion = replace(OPTIONS, backend=backend), resting(gaussians(COUNT, size=(0.1, 0.5)))
    capacity, lines = roomy(options), shot(rays())
    # Single precision, from behind the first Gaussians to behind all of them.
    motion, lines = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), (motion, lines))
    start = jnp.linspace(0, 6, RAYS, dtype=jnp.float32)
    later = replace(lines, start=start)

    def loss(motion, lines):
        pixels, report = trace(motion, lines, options=options, capacity=capacity)
        total = jnp.sum(pixels.color) + jnp.sum(pixels.depth - start * (1 - pixels.transmittance))
        return total, (pixels, report)

    def moved_loss(motion, lines):
        pixels, report = trace(motion, moved_to_start(lines), options=options, capacity=capacity)
        return jnp.sum(pixels.color) + jnp.sum(pixels.depth), (pixels, report)

    both = (loss, moved_loss)
    (slope, (seen, report)), (expected_slope, (expected, _)) = (
        jax.jit(jax.grad(f, has_aux=True))(motion, later) for f in both
    )
    assert int(report.dropped) == 0 and float(jnp.min(seen.transmittance)) < 0.9
    np.testing.assert_allclose(seen.color, expected.color, atol=SAME)
    np.testing.assert_allclose(seen.transmittance, expected.transmittance, atol=SAME)
    depth = expected.depth + start * (1 - expected.transmittance)
    np.testing.assert_allclose(seen.depth, depth, atol=10 * SAME)
    largest = float(jnp.max(jnp.abs(expected_slope.gaussians.mean)))
    difference = slope.gaussians.mean - expected_slope.gaussians.mean
    assert largest > 0 and float(jnp.max(jnp.abs(difference))) < 1e-3 * largest


def test_list_sizes_are_those_of_moved_rays():
    motion, lines = resting(gaussians(COUNT, size=(0.1, 0.5))), shot(rays())
    later = replace(lines, start=jnp.full(RAYS, 4.0))
    options = replace(OPTIONS, backend="array")
    sizes = [measure(motion, x, options=options) for x in (later, moved_to_start(later), lines)]
    assert sizes[0] == sizes[1] and sizes[0].pairs < sizes[2].pairs
