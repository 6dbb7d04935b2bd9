"""Sweeps of how a ray meets Gaussians."""

import jax.numpy as jnp
import numpy as np

from experiments.extremes.matter import unit
from experiments.extremes.sweep import Sweep, decades
from gaussray import geometry
from gaussray.scene.gaussians import Gaussians, whitening_matrix
from gaussray.tracer.composite import composite
from gaussray.tracer.grid import ellipsoid_boxes
from gaussray.tracer.motion import Motion, control_points, control_weights
from gaussray.tracer.response import opacity_on_ray, reach_radius, response
from gaussray.tracer.table import gaussian_table, state_at


ALPHA_MIN = 1 / 255


class Meeting:
    """A Gaussian and a ray that passes it within `impact` standard deviations."""

    def __init__(self, *, size=1.0, distance=3.0, shape=None, impact=1.0, place=0.0):
        self.size, self.distance, self.shape = size, distance, shape
        self.impact, self.place = impact, place

    def __call__(self, place, dice):
        told = {k: v(place) if callable(v) else v for k, v in vars(self).items()}
        size = told["size"]
        shape = np.exp(dice.normal(0, 0.3, 3)) if told["shape"] is None else told["shape"]
        quat = unit(dice, 4)
        turn = np.asarray(geometry.rotation_matrix(jnp.asarray(quat)))
        direction = unit(dice)
        if told["shape"] is not None:
            # Thin things are seen at an angle: along them any ray is a different question.
            direction = turn @ (np.array([0.6, 0.48, 0.64]) * dice.choice([-1, 1], 3))
        mean = told["place"] * np.ones(3) + size * dice.normal(size=3)
        across = turn @ (size * shape * told["impact"] * unit(dice))
        origin = mean + across - told["distance"] * size * direction
        return quat, size * shape, mean, origin, direction


def _met(quat, scale, mean, origin, direction):
    rows = whitening_matrix(quat, scale).reshape(9)
    return response(list(rows), list(mean), origin, direction)


def kernel_of(*meeting):
    """exp(-q/2) of a ray and a Gaussian."""
    return opacity_on_ray(jnp.ones_like(meeting[0][0]), _met(*meeting)[1], alpha_max=2.0)


def distance_of(*meeting):
    """Where along the ray that is."""
    return _met(*meeting)[0]


def _between_keys(time, quat, scale, origin, direction):
    """exp(-q/2) of a Gaussian that turns and grows, between its keys."""
    g = Gaussians(
        jnp.zeros((3, 1, 3), scale.dtype), quat[:, None], scale[:, None],
        jnp.ones(1, scale.dtype), jnp.zeros((1, 1, 3), scale.dtype),
    )  # fmt: skip
    motion = Motion(jnp.linspace(0, 1, 3, dtype=time.dtype), g)
    row = gaussian_table(motion)[0]
    whiten, mean = state_at(list(row), control_weights(motion.time, time))
    return jnp.exp(-0.5 * response(whiten, mean, origin, direction)[1])


def _turning(place, dice):
    shape = np.array([1, place**-0.5, 1 / place])
    quat, scale, mean, origin, direction = Meeting(shape=shape)(place, dice)
    quat = np.stack([quat + x * unit(dice, 4) * 0.1 / place for x in range(3)])
    return np.asarray(0.3), quat, np.stack([scale] * 3), origin - mean, direction


def _hits(place, dice):
    """Sixteen hits that leave this transmittance."""
    share = 1 - place ** (1 / 16)
    alpha = np.clip(share * dice.uniform(0.9, 1.1, 16), 0, 0.99)
    return alpha, dice.permutation(16).astype(float), dice.uniform(size=(4, 16))


def _arc(share, mean):
    time = jnp.stack([jnp.zeros_like(share), share, jnp.ones_like(share)])
    quat = jnp.ones((3, 1, 4), mean.dtype)
    none = jnp.zeros((1, 1, 3), mean.dtype)
    g = Gaussians(mean[:, None], quat, jnp.ones_like(mean)[:, None], none[0, 0, :1], none)
    return control_points(Motion(time, g))[0]


def _boxed(mean, support):
    lower, upper = ellipsoid_boxes(mean, support)
    return upper - mean, lower - mean


def tracer_sweeps():
    """Response, bounds, motion between keys, compositing."""
    far, thin = decades(1, 1e8, 1), decades(1, 1e8, 1)
    for name, function in (("kernel", kernel_of), ("t", distance_of)):
        yield Sweep(
            "tracer", f"response: {name}", "distance / size", far,
            Meeting(distance=lambda p: p), function,
        )  # fmt: skip
    itself = lambda p: p  # noqa: E731
    yield Sweep("tracer", "response: kernel", "place / size", far, Meeting(place=itself), kernel_of)
    sizes = decades(1e-24, 1e24, 1)
    yield Sweep("tracer", "response: kernel", "size", sizes, Meeting(size=itself), kernel_of)
    slim = Meeting(shape=lambda p: np.array([1, p**-0.5, 1 / p]))
    yield Sweep("tracer", "response: kernel", "wide / thin", thin, slim, kernel_of)
    sigmas = np.append(decades(1e-6, 1, 1), [2, 3, 3.33])
    yield Sweep(
        "tracer", "response: kernel", "standard deviations aside", sigmas,
        Meeting(impact=itself), kernel_of,
    )  # fmt: skip
    yield Sweep("tracer", "between keys: kernel", "wide / thin", thin, _turning, _between_keys)
    above = np.append(decades(1e-6, 1, 1), [10, 254])
    yield Sweep(
        "tracer", "reach", "opacity / alpha_min - 1", above,
        lambda p, d: (np.asarray(np.float32(ALPHA_MIN) * (1 + p * d.uniform(0.9, 1))),),
        lambda x: reach_radius(x, float(np.float32(ALPHA_MIN))),
    )  # fmt: skip
    yield Sweep(
        "tracer", "around (boxes)", "place / size", far,
        lambda p, d: (p * unit(d)[None], d.normal(size=(1, 3, 3))), _boxed,
    )  # fmt: skip
    yield Sweep(
        "tracer", "controls", "where the middle key lies", decades(1e-6, 0.5, 1),
        lambda p, d: (np.asarray(p), d.normal(size=(3, 3)) * p + np.arange(3)[:, None]), _arc,
    )  # fmt: skip
    clear = 1 / decades(1.2, 1e31, 1)
    yield Sweep(
        "tracer", "composite: light", "transmittance", clear, _hits, lambda *x: composite(*x)[0]
    )
    yield Sweep(
        "tracer", "composite: what is left", "transmittance", clear, _hits,
        lambda *x: composite(*x)[1],
    )  # fmt: skip
