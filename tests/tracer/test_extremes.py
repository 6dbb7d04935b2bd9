"""The float32 tracer at the ends of what numbers can express, against float64."""

import extremes
import jax
import numpy as np
import pytest
import reference
from scenes import (
    cast,
    natural,
    pixels_and_gradients,
    pull_dense,
    relative_errors,
    resting,
    shot,
    stacked,
    weights,
)


# Mean absolute colour, and gradients relative to the largest: what is asked of ordinary scenes.
COLOR, GRADIENT = 1e-4, 1e-3
# Beyond them float32 may be wrong only as far as its inputs are: no further than the exact image
# moves when every input number moves by half a unit in the last place (measured: a tenth of that).
HALF_ULP, DRAWS = 2.0**-24, 4
# Scenes that must meet COLOR and GRADIENT in spite of such inputs.
EXACT = set(extremes.SCENES) - {"anisotropy", "upright"}


@jax.jit
def pull(motion, rays, weight):
    """Compiled here: without XLA's optimisations it rounds more than is allowed."""
    return pixels_and_gradients(motion, rays, weight)


def nudged(tree, seed):
    """Every number half a unit of float32 away."""
    r = np.random.default_rng(seed)
    return jax.tree.map(lambda x: x * (1 + HALF_ULP * r.choice([-1.0, 1.0], x.shape)), tree)


@pytest.mark.parametrize("name", extremes.SCENES)
def test_values_and_gradients_are_right(name):
    gaussians, rays = extremes.scene(name)
    motion, rays = resting(gaussians), shot(rays)
    weight = weights(dtype=np.float32)
    pixels, report, gradient = pull(motion, rays, weight)
    assert int(report.dropped) == int(report.skipped) == 0
    assert int(report.hits) > 0
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves((pixels, gradient)))

    exact = cast((motion, rays), np.float64)
    weight = weight.astype(np.float64)
    image = stacked(reference.trace(*exact))
    slope = natural(pull_dense(*exact, weight), motion)
    color_limit, slope_limit = COLOR, dict.fromkeys(slope, GRADIENT)
    if name not in EXACT:
        for seed in range(DRAWS):
            moved = nudged(exact, seed)
            change = np.mean(np.abs(stacked(reference.trace(*moved)) - image)[:, :3])
            color_limit = max(color_limit, change)
            changes = relative_errors(natural(pull_dense(*moved, weight), motion), slope)
            slope_limit = {key: max(slope_limit[key], changes[key]) for key in changes}
    assert np.mean(np.abs(stacked(pixels) - image)[:, :3]) < color_limit
    errors = relative_errors(natural(gradient, motion), slope)
    assert all(errors[key] < slope_limit[key] for key in errors), errors


def test_anisotropy_of_300_needs_no_such_excuse():
    gaussians, rays = extremes.scene("mild_anisotropy")
    motion, rays = resting(gaussians), shot(rays)
    weight = weights(dtype=np.float32)
    pixels, _, gradient = pull(motion, rays, weight)
    exact = cast((motion, rays), np.float64)
    assert np.mean(np.abs(stacked(pixels) - stacked(reference.trace(*exact)))[:, :3]) < COLOR
    slope = natural(pull_dense(*exact, weight.astype(np.float64)), motion)
    errors = relative_errors(natural(gradient, motion), slope)
    assert max(errors.values()) < GRADIENT, errors


def test_a_zero_quaternion_is_the_identity_and_has_no_gradient():
    gaussians, rays = extremes.scene("quaternions")
    zero = ~np.any(gaussians.quat, axis=-1)
    assert np.any(zero)
    _, _, (slope, _) = pull(resting(gaussians), shot(rays), weights(dtype=np.float32))
    assert not np.any(np.asarray(slope.gaussians.quat)[0][zero])
    assert np.any(np.asarray(slope.gaussians.mean)[0][zero])


def test_what_is_fully_clamped_has_no_gradient_to_opacity():
    gaussians, rays = extremes.scene("opacities")
    _, _, (slope, _) = pull(resting(gaussians), shot(rays), weights(dtype=np.float32))
    invisible = (gaussians.opacity == 0) | (gaussians.opacity == np.float32(1 / 255))
    assert not np.any(np.asarray(slope.gaussians.opacity)[invisible])
