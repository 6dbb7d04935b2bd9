"""Scenes, rays and compiled functions that the tests of the tracer share, so that few compile."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reference

from gaussray.camera.rays import Rays
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.transient import Transients
from gaussray.tracer.motion import Motion, still
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.trace import trace
from gaussray.tracer.traverse import Capacity


# Sixteen bundles of 2 x 2 rays, which share one coarse bundle; several rounds of four hits. The
# capacity is what 64 Gaussians can need at most.
RAYS, COUNT = 64, 64
OPTIONS = TraceOptions(k=4, bundle=2, levels=1, group=4, chunk=8, transmittance_min=0.0)
CAPACITY = Capacity((8, 128), 1024, 64)

look = eqx.filter_jit(trace)


class Matter(NamedTuple):
    """Gaussians as numpy arrays."""

    mean: np.ndarray
    quat: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    harmonics: np.ndarray


class Lines(NamedTuple):
    """Rays as numpy arrays."""

    origin: np.ndarray
    direction: np.ndarray
    time: np.ndarray


def pull(motion, rays, weight, *, options=OPTIONS, capacity=CAPACITY):
    """Pixels, report and the gradients of `score` to motion and rays."""
    return _pull(motion, rays, weight, options, capacity)


def pixels_and_gradients(motion, rays, weight, options=OPTIONS, capacity=CAPACITY):
    """`pull`, to be compiled."""

    def loss(motion, rays):
        pixels, report = trace(motion, rays, options=options, capacity=capacity)
        return score((pixels.color, pixels.transmittance, pixels.depth), weight), (pixels, report)

    gradient, (pixels, report) = jax.grad(loss, argnums=(0, 1), has_aux=True)(motion, rays)
    return pixels, report, gradient


_pull = eqx.filter_jit(pixels_and_gradients)


@jax.jit
def pull_dense(motion, rays, weight):
    """The gradients that autodiff of the dense compositor gives."""
    return jax.grad(lambda m, r: score(reference.dense(m, r), weight), argnums=(0, 1))(motion, rays)


def score(pixels, weight):
    """Any number that depends on all that a ray sees; depth counts less, being larger."""
    color, transmittance, depth = pixels
    return (
        jnp.sum(weight[:, :3] * color)
        + jnp.sum(weight[:, 3] * transmittance)
        + 0.1 * jnp.sum(weight[:, 4] * depth)
    )


def weights(count=RAYS, dtype=np.float64, seed=7):
    """What `score` weighs with: random, so that no errors cancel."""
    return jnp.asarray(np.random.default_rng(seed).normal(size=(count, 5)), dtype)


def gaussians(count, *, seed=0, degree=1, size=(0.02, 0.2), around=(0.0, 0.0, 0.0), spread=1.0):
    """Random Gaussians in a cube, of random shape, turn and colour."""
    r = np.random.default_rng(seed)
    return Matter(
        mean=np.asarray(around) + spread * r.uniform(-1, 1, (count, 3)),
        quat=r.normal(size=(count, 4)),
        scale=np.exp(r.uniform(*np.log(size), (count, 3))),
        opacity=r.uniform(0.05, 1.0, count),
        harmonics=0.5 * r.normal(size=(count, (degree + 1) ** 2, 3)),
    )


def rays(count=RAYS, *, seed=1, place=(0.0, 0.0, -3.0), jitter=0.05, spread=0.25):
    """Random rays from about a place along +z."""
    r = np.random.default_rng(seed)
    direction = np.array([0, 0, 1]) + spread * r.uniform(-1, 1, (count, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    origin = np.asarray(place) + jitter * r.normal(size=(count, 3))
    return Lines(origin, direction, r.uniform(size=count))


def moving(count, keys=3, *, seed=0, amount=0.1, **kind):
    """Gaussians that wander, turn and grow between key times in [0, 1]."""
    start = gaussians(count, seed=seed, **kind)
    r = np.random.default_rng(seed + 100)

    def wander(x):
        return x + amount * np.cumsum(r.normal(size=(keys, *x.shape)), axis=0)

    time = np.linspace(0, 1, keys)
    time[1:-1] += 0.1
    quat = start.quat / np.linalg.norm(start.quat, axis=-1, keepdims=True)
    return time, start._replace(
        mean=wander(start.mean), quat=wander(quat), scale=np.exp(wander(np.log(start.scale)))
    )


def fleeting(count, *, seed=0, lifetime=(0.05, 0.3), speed=0.5, **kind):
    """Random transient Gaussians about times in [0, 1], half of them with a plateau."""
    start = gaussians(count, seed=seed, **kind)
    r = np.random.default_rng(seed + 200)
    parts = start._asdict() | {
        "velocity": speed * r.normal(size=(count, 3)),
        "opacity": r.uniform(0.3, 1.0, count),
        "instant": r.uniform(-0.1, 1.1, count),
        "lifetime": np.exp(r.uniform(*np.log(lifetime), count)),
        "plateau": np.where(r.uniform(size=count) < 0.5, 0, r.uniform(0.02, 0.1, count)),
    }
    return Transients(**cast(parts, np.float64))


def beside(motion, transients, time_range=None):
    """A scene with transient Gaussians of its own precision."""
    dtype = motion.gaussians.mean.dtype
    limits = None if time_range is None else jnp.asarray(time_range, dtype)
    return Motion(motion.time, motion.gaussians, motion.rest, cast(transients, dtype), limits)


def resting(matter, dtype=np.float32):
    """Gaussians that stand still, for the tracer."""
    return still(Gaussians(*cast(matter, dtype)))


def wandering(time, matter, dtype=np.float32):
    """Gaussians with key states, for the tracer."""
    return Motion(jnp.asarray(time, dtype), Gaussians(*cast(matter, dtype)))


def tinted(motion, *, seed=5):
    """The same Gaussians in a light of another colour at each key."""
    tint = np.random.default_rng(seed).uniform(0.5, 1.5, motion.gaussians.mean.shape)
    parts = vars(motion.gaussians) | {"tint": jnp.asarray(tint, motion.gaussians.mean.dtype)}
    return replace(motion, gaussians=Gaussians(**parts))


def shot(lines, dtype=np.float32):
    """Rays for the tracer."""
    return Rays(*cast(lines, dtype))


def cast(tree, dtype=np.float32):
    """All arrays in another precision."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


def padded(matter, count=COUNT):
    """Gaussians in a structure of `count`, the rest of opacity 0."""
    missing = count - len(matter.opacity)

    def pad(x, value):
        return np.pad(x, [(0, missing)] + [(0, 0)] * (x.ndim - 1), constant_values=value)

    return Matter(*(pad(x, value) for x, value in zip(matter, (0, 1, 1, 0, 0), strict=True)))


def stacked(pixels):
    """Colour, transmittance and depth as one numpy array (rays x 5)."""
    if hasattr(pixels, "color"):
        pixels = (pixels.color, pixels.transmittance, pixels.depth)
    color, transmittance, depth = (np.asarray(x, np.float64) for x in pixels)
    return np.concatenate([color, transmittance[:, None], depth[:, None]], axis=1)


def natural(gradient, motion):
    """Gradients to motion and rays in units of each Gaussian's own size and quaternion length, so
    that Gaussians of all sizes count alike."""
    motion_gradient, rays_gradient = cast(gradient, np.float64)
    d, g = motion_gradient.gaussians, cast(motion.gaussians, np.float64)
    tint = {} if d.tint is None else {"tint": d.tint}
    if motion.transient is not None:
        tint |= natural_transients(motion_gradient.transient, cast(motion.transient, np.float64))
    return tint | {
        "mean": d.mean * np.min(g.scale, axis=-1, keepdims=True),
        "quat": d.quat * np.linalg.norm(g.quat, axis=-1, keepdims=True),
        "scale": d.scale * g.scale,
        "opacity": d.opacity,
        "harmonics": d.harmonics,
        "origin": rays_gradient.origin,
        "direction": rays_gradient.direction,
        "time": rays_gradient.time,
    }


def natural_transients(d, t):
    """Gradients to transient Gaussians in units of their own size, lifetime and speed."""
    size = np.min(t.scale, axis=-1, keepdims=True)
    return {
        "transient mean": d.mean * size,
        "transient velocity": d.velocity * size / t.lifetime[:, None],
        "transient quat": d.quat * np.linalg.norm(t.quat, axis=-1, keepdims=True),
        "transient scale": d.scale * t.scale,
        "transient opacity": d.opacity,
        "transient harmonics": d.harmonics,
        "transient instant": d.instant * t.lifetime,
        "transient lifetime": d.lifetime * t.lifetime,
        "transient plateau": d.plateau * t.lifetime,
    }


def relative_errors(actual, expected):
    """Largest error of every gradient, relative to its largest value."""
    return {
        key: float(np.max(np.abs(actual[key] - expected[key])) / max(np.max(np.abs(value)), 1e-30))
        for key, value in expected.items()
        if value.size
    }


def against_brute_force(motion, lines, options=OPTIONS, capacity=CAPACITY):
    """Errors of float32 colour (mean) and gradients (relative), and the report."""
    weight = weights(dtype=np.float32)
    pixels, report, gradient = pull(motion, shot(lines), weight, options=options, capacity=capacity)
    single = Lines(*(np.asarray(x, np.float32).astype(float) for x in lines))
    double = jax.tree.map(lambda x: x.astype(jnp.float64), motion)
    expected = stacked(reference.trace(double, single))
    slope = pull_dense(double, shot(single, np.float64), weight.astype(np.float64))
    color = np.mean(np.abs(stacked(pixels) - expected)[:, :3])
    errors = relative_errors(natural(gradient, motion), natural(slope, motion))
    assert int(report.dropped) == 0
    assert pixels.color.dtype == gradient[0].gaussians.mean.dtype == jnp.float32
    return color, errors, report
