"""Difference quotients part from a picture's derivative where hits change, and nowhere else."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense import dense_scene

import gaussray
from gaussray.camera.camera import camera_rays
from gaussray.camera.film import pixel_grid
from gaussray.tracer.line import line_hits


pytestmark = pytest.mark.ci


FOCAL, SIDE = 24.0, 16
# A ray that ends early does so behind a whole round of hits.
TRACE = gaussray.TraceOptions(levels=0, group=2, transmittance_min=0.0)
# Of a smooth function in double precision: rounding divided by the step, and the step squared.
SMOOTH = 1e-4


def camera(focal):
    return gaussray.Camera(
        gaussray.Film(SIDE, SIDE, "center"),
        gaussray.Pinhole(focal, (SIDE / 2, SIDE / 2)),
        trajectory=gaussray.look_at((0, -4, 1)),
    )


def hits(scene, focal):
    """The Gaussians on every ray in the order of their distances."""
    pixel = pixel_grid(camera(focal).film).reshape(-1, 2)
    rays = camera_rays(camera(focal), pixel, jnp.full((len(pixel), 5), 0.5))
    both = jax.jit(jax.vmap(lambda o, d: line_hits(scene.static, o, d, options=TRACE)))
    sequences = []
    for t, alpha in zip(*map(np.asarray, both(rays.origin, rays.direction)), strict=True):
        met = np.flatnonzero(alpha)
        sequences.append(tuple(met[np.argsort(t[met])]))
    return sequences


def test_difference_quotients_differ_where_hits_change_and_nowhere_else():
    scene = dense_scene(60, seed=1)
    options = gaussray.RenderOptions(samples=1)
    plan = gaussray.plan(scene, camera(FOCAL), options=options, trace=TRACE)
    other = gaussray.render(scene, camera(1.03 * FOCAL), plan=plan).color

    @jax.jit
    @jax.value_and_grad
    def loss(focal):
        return jnp.mean((gaussray.render(scene, camera(focal), plan=plan).color - other) ** 2)

    slope = float(loss(FOCAL)[1])
    same, changed = [], []
    for step in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        ends = [FOCAL * (1 - step), FOCAL * (1 + step)]
        low, high = (float(loss(focal)[0]) for focal in ends)
        off = abs((high - low) / (ends[1] - ends[0]) / slope - 1)
        before, after = (hits(scene, focal) for focal in ends)
        (same if before == after else changed).append(off)
    assert same and max(same) < SMOOTH
    assert changed and min(changed) > 10 * SMOOTH


def test_the_number_of_hits_of_a_round_does_not_change_the_derivative():
    scene, options = dense_scene(60, seed=1), gaussray.RenderOptions(samples=1)

    def slope(k):
        trace = dataclasses.replace(TRACE, k=k)
        plan = gaussray.plan(scene, camera(FOCAL), options=options, trace=trace)

        @jax.jit
        @jax.grad
        def mean(focal):
            return jnp.mean(gaussray.render(scene, camera(focal), plan=plan).color)

        return float(mean(FOCAL))

    # Sums of dozens of hits in double precision.
    assert slope(3) == pytest.approx(slope(16), rel=1e-9)
