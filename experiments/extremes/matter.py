"""Sweeps of what a scene is made of and what a fit minimises."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from experiments.extremes.sweep import Sweep, decades
from gaussray import geometry
from gaussray.color import srgb_decode, srgb_encode
from gaussray.reconstruct.optimize import loss, regularizer
from gaussray.scene.bodies import bodies_at_rest
from gaussray.scene.deformation import Layer, deform, initial_deformation
from gaussray.scene.gaussians import Gaussians, Unconstrained, constrain, unconstrain
from gaussray.scene.harmonics import C0, radiance
from gaussray.scene.planes import Planes, features, initial_planes


TINY_TO_HUGE = decades(1e-36, 1e36, 1)


def unit(dice, size=3):
    """A random direction."""
    x = dice.normal(size=size)
    return x / np.linalg.norm(x)


def _turned(place, dice):
    half = place / 2
    return np.append(np.cos(half), np.sin(half) * unit(dice))


def _vectors(name, function, size=3):
    def draw(place, dice):
        return (place * unit(dice, size),)

    return Sweep("geometry", name, "length", TINY_TO_HUGE, draw, function)


def _angles(name, function, places=None, swept="angle"):
    places = decades(1e-8, 3) if places is None else places
    return Sweep("geometry", name, swept, places, lambda p, d: (p * unit(d),), function)


def _slerped(a, b, fraction):
    """In double precision, by another program."""
    ends = Rotation.from_quat(np.roll(np.stack([a, b]), -1, axis=-1))
    found = np.roll(Slerp([0, 1], ends)(fraction).as_quat(), 1)
    return found if found @ (a + b) > 0 else -found


def _between(place, dice):
    a = unit(dice, 4)
    b = np.asarray(geometry.multiply(*map(jnp.asarray, (a, _turned(place, dice)))))
    return a, b, dice.uniform(0.1, 0.9)


def geometry_sweeps():
    """Vectors, quaternions, rotations."""
    near_half = np.pi - decades(1e-6, 1)
    yield _vectors("safe_norm", geometry.safe_norm)
    yield _vectors("normalize", geometry.normalize)
    yield _vectors("rotation_matrix", geometry.rotation_matrix, 4)
    yield _angles("turning", geometry.turning)
    back = lambda v: geometry.rotation_vector(geometry.turning(v))  # noqa: E731
    yield _angles("rotation_vector", back)
    yield _angles("rotation_vector, near pi", back, near_half, "angle near pi")
    matrix = lambda v: geometry.quaternion(geometry.rotation_matrix(geometry.turning(v)))  # noqa: E731
    yield _angles("quaternion", matrix)
    places = np.append(decades(1e-6, 1, 4), 3)
    slerped = geometry.slerp
    yield Sweep("geometry", "slerp", "angle between", places, _between, slerped, _slerped)


def _light(place, dice):
    rest = 0.1 * place * dice.normal(size=(16, 3))
    rest[0] = (place * dice.uniform(0.5, 1, 3) - 0.5) / C0
    return rest, unit(dice)


def _field(side):
    """Reads a plane grid of this side; its box, of size 1, lies somewhere far away."""
    dice = np.random.default_rng(2)
    parts = [dice.uniform(0.7, 1.3, (3, n, side, 2)) for n in (side, 4)]

    def draw(place, dice):
        lower = np.full(3, place)
        return lower, (lower + dice.uniform(0.05, 0.95, 3))[None], np.asarray(dice.uniform())

    def read(lower, position, time):
        space, moments = (jnp.asarray(part, lower.dtype) for part in parts)
        zero, one = jnp.zeros_like(time), jnp.ones_like(time)
        return features(Planes((space,), (moments,), lower, lower + 1, zero, one), position, time)

    return draw, read


@functools.cache
def _deformed(unit_of_length):
    """A moving Gaussian in a scene of this unit."""
    lower = jnp.asarray(np.full(3, -unit_of_length))
    planes = initial_planes(
        jax.random.key(0), lower, -lower, (0.0, 1.0), sides=(8,), instants=4, channels=4
    )
    bodies = bodies_at_rest(
        jnp.zeros((1, 3)), jnp.full(1, 10 * unit_of_length), jnp.linspace(0, 1, 4)
    )
    field = initial_deformation(jax.random.key(1), planes, bodies, width=8)
    dice = np.random.default_rng(3)
    heads = {"mean": 0.1 * unit_of_length, "rotation": 0.1, "scale": 0.1, "tint": 0.1}
    parts = dict(vars(field))
    for name, size in heads.items():
        first, last = parts[name]
        weight = jnp.asarray(size * dice.normal(size=last.weight.shape))
        parts[name] = first, Layer(weight, last.bias)
    return jax.tree.map(lambda x: np.asarray(x, float), type(field)(**parts))


def _moving(place, dice):
    g = Gaussians(
        place * dice.uniform(-0.9, 0.9, (1, 3)), unit(dice, 4)[None],
        place * np.exp(dice.normal(size=(1, 3))) / 50, np.ones(1) / 2, np.zeros((1, 1, 3)),
    )  # fmt: skip
    return g, _deformed(place), np.asarray(dice.uniform(0.1, 0.9))


def _through_opacity(x):
    free = unconstrain(Gaussians(*_still(x)))
    return constrain(Unconstrained(**vars(free))).opacity


def _still(opacity):
    one = jnp.ones((1, 3), opacity.dtype)
    return one, jnp.ones((1, 4), opacity.dtype), one, opacity[None], one[None]


def scene_sweeps():
    """Colour, planes, deformation, bridges to the optimiser."""
    yield Sweep("scene", "radiance, degree 3", "light", decades(1e-6, 1e6, 1), _light, radiance)
    for side in (32, 1024):
        yield Sweep(
            "scene", f"planes of {side}", "distance of the box / its size",
            np.append(0, decades(1, 1e6, 1)), *_field(side),
        )  # fmt: skip
    yield Sweep("scene", "deform", "unit of length", decades(1e-12, 1e12, 1), _moving, deform)
    opacity = np.concatenate([decades(1e-7, 0.1, 1), 1 - decades(1e-6, 0.5, 1)[::-1]])
    yield Sweep(
        "scene", "unconstrain, constrain", "opacity", opacity,
        lambda p, d: (np.asarray(p),), _through_opacity,
    )  # fmt: skip
    for name, function in (("srgb_encode", srgb_encode), ("srgb_decode", srgb_decode)):
        yield Sweep(
            "scene", name, "light", decades(1e-8, 1e4, 1),
            lambda p, d: (p * d.uniform(0.5, 1, 3),), function,
        )  # fmt: skip


def _pair(place, dice):
    truth = dice.uniform(0.3, 0.7, (64, 3))
    return truth + place * dice.normal(size=truth.shape), truth


def _rough(place, dice):
    rough = lambda *s: 1 + place * dice.normal(size=s)  # noqa: E731
    zero, one = np.zeros(()), np.ones(())
    return (
        Planes(
            (rough(3, 8, 8, 2),),
            (rough(3, 4, 8, 2),),
            zero + np.zeros(3),
            one + np.zeros(3),
            zero,
            one,
        ),
    )  # noqa: E501


def loss_sweeps():
    """What a fit minimises."""
    apart = decades(1e-7, 1, 1)
    yield Sweep("fit", "l1", "difference", apart, _pair, loss.l1)
    yield Sweep("fit", "dssim", "difference", apart, _pair, lambda a, b: loss.dssim(a, b, side=8))

    def flat(place, dice):
        return 0.5 + place * dice.normal(size=(64, 3)), 0.5 + place * dice.normal(size=(64, 3))

    yield Sweep("fit", "dssim", "contrast", apart, flat, lambda a, b: loss.dssim(a, b, side=8))
    yield Sweep("fit", "regularizer", "roughness", apart, _rough, regularizer.plane_terms)
