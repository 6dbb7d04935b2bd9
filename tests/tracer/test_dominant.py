"""The Gaussian that a ray sees most of, against a full sort in float64."""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from dominants import dominant_of

from gaussray.camera.rays import Rays
from gaussray.scene.gaussians import Gaussians
from gaussray.tracer.measure import measure
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.options import TraceOptions


OPTIONS = TraceOptions(k=4, bundle=2, levels=1, group=4, chunk=8, transmittance_min=0.0)
# Of weights in double precision: sums of a few dozen terms of logarithms.
TOLERANCE = 1e-12

look = eqx.filter_jit(dominant_of)


def matter(count=48, keys=1, seed=3):
    """Large, half-transparent Gaussians that overlap, at key states a little apart."""
    rng = np.random.default_rng(seed)
    mean = rng.uniform(-1, 1, (1, count, 3)) + 0.1 * rng.normal(size=(keys, count, 3))
    quat = rng.normal(size=(1, count, 4)) + 0.05 * rng.normal(size=(keys, count, 4))
    scale = np.broadcast_to(rng.uniform(0.1, 0.4, (1, count, 3)), mean.shape)
    harmonics = np.zeros((count, 1, 3))
    parts = mean, quat, scale, rng.uniform(0.1, 0.9, count), harmonics
    return Gaussians(*map(jnp.asarray, parts))


def lines(count=60, seed=5):
    """Rays from near one place, all to one side; their number fills no bundle."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(count, 3)) * 0.3 + [0, 0, 1]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = 0.05 * rng.normal(size=(count, 3)) - [0, 0, 3]
    return Rays(*map(jnp.asarray, (origin, direction, rng.uniform(0, 1, count))))


def largest(mean, frame, opacity, origin, direction):
    """Index and weight by hand: all Gaussians on one ray, sorted."""
    o = np.linalg.solve(frame, (origin - mean)[..., None])[..., 0]
    d = np.linalg.solve(frame, np.broadcast_to(direction, mean.shape)[..., None])[..., 0]
    square = np.sum(d * d, axis=-1)
    t = -np.sum(o * d, axis=-1) / square
    q = np.sum(np.cross(o, d) ** 2, axis=-1) / square
    alpha = np.minimum(opacity * np.exp(-q / 2), OPTIONS.alpha_max)
    alpha = np.where((alpha > OPTIONS.alpha_min) & (t > 0), alpha, 0)
    order = np.argsort(t, kind="stable")
    weight = np.zeros_like(alpha)
    weight[order] = alpha[order] * np.cumprod(np.append(1, 1 - alpha[order][:-1]))
    best = int(np.argmax(weight))
    return (best, weight[best]) if weight[best] > 0 else (-1, 0.0)


@pytest.mark.ci
@pytest.mark.parametrize("keys", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_the_largest_weight_is_found_among_all(keys):
    every, rays = matter(keys=keys), lines()
    time = jnp.linspace(0, 1, keys)
    motion = Motion(time, every) if keys > 1 else still(one_key(every))
    capacity = measure(motion, rays, options=OPTIONS)
    found = look(motion, rays, options=OPTIONS, capacity=capacity)
    assert int(found.dropped) == 0
    axes = reference.rotation(every.quat) * np.asarray(every.scale)[..., None, :]
    share = reference.key_shares(np.asarray(time), np.asarray(rays.time))
    share = np.asarray(share).T if np.shape(share)[0] == keys else np.asarray(share)
    expected = []
    for i in range(len(rays.time)):
        mean = np.einsum("k,knc->nc", share[i], every.mean)
        frame = np.einsum("k,knij->nij", share[i], axes)
        ray = np.asarray(rays.origin[i]), np.asarray(rays.direction[i])
        expected.append(largest(mean, frame, np.asarray(every.opacity), *ray))
    index, weight = zip(*expected, strict=True)
    np.testing.assert_array_equal(found.index, index)
    np.testing.assert_allclose(found.weight, weight, atol=TOLERANCE)
    assert len(set(index)) > 10


def one_key(gaussians):
    """The first state alone."""
    states = gaussians.mean[0], gaussians.quat[0], gaussians.scale[0]
    return Gaussians(*states, gaussians.opacity, gaussians.harmonics)


def test_a_ray_that_meets_nothing_has_none_and_resting_gaussians_come_first():
    every, rays = matter(keys=3), lines(8)
    rest = one_key(matter(count=5, seed=9))
    motion = Motion(jnp.linspace(0, 1, 3), every, rest)
    capacity = measure(motion, rays, options=OPTIONS)
    trace = partial(look, motion, options=OPTIONS, capacity=capacity)
    away = Rays(rays.origin, -rays.direction, rays.time)
    np.testing.assert_array_equal(trace(away).index, -1)
    np.testing.assert_array_equal(trace(away).weight, 0)
    # A wall in front of everything, among those that rest, is seen by all.
    wall = eqx.tree_at(
        lambda g: (g.mean, g.scale, g.opacity),
        rest,
        (
            rest.mean.at[2].set(jnp.asarray([0.0, 0, -2])),
            rest.scale.at[2].set(jnp.full(3, 5.0)),
            rest.opacity.at[2].set(0.99),
        ),
    )
    front = Motion(motion.time, every, wall)
    far = Rays(rays.origin - 20 * rays.direction, rays.direction, rays.time)
    capacity = measure(front, far, options=OPTIONS)
    np.testing.assert_array_equal(look(front, far, options=OPTIONS, capacity=capacity).index, 2)
