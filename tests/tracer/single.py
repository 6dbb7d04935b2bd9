"""What the tests of the kernels on a GPU and on a CPU share."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reference
from scenes import (
    COUNT,
    OPTIONS,
    gaussians,
    moving,
    natural,
    pull,
    pull_dense,
    rays,
    relative_errors,
    resting,
    shot,
    stacked,
    tinted,
    wandering,
    weights,
)

from gaussray.camera.rays import Rays
from gaussray.scene.gaussians import Gaussians
from gaussray.tracer.motion import Motion, merge_rest
from gaussray.tracer.traverse import Capacity


# Asked of single precision: mean absolute colour, and gradients relative to the largest. Where
# nothing is extreme it reaches a hundred roundings (measured: 3e-7 and 7e-6).
COLOR, GRADIENT, SINGLE = 1e-4, 1e-3, 2e-5


def samples_of(lines):
    aside = jnp.asarray([0.1, 0, 0], lines.origin.dtype)
    return Rays(
        jnp.stack([lines.origin, lines.origin + aside[None]]),
        jnp.stack([lines.direction] * 2),
        jnp.stack([lines.time] * 2),
    )


def mixed(keys=3):
    """Gaussians that move, with tints, and others that rest."""
    still = resting(gaussians(40, seed=9, size=(0.1, 0.5))).gaussians
    rest = Gaussians(still.mean[0], still.quat[0], still.scale[0], still.opacity, still.harmonics)
    motion = tinted(wandering(*moving(COUNT, keys, size=(0.1, 0.5), amount=0.02)))
    return Motion(motion.time, motion.gaussians, rest)


def roomy(options):
    """Room for every list, coarse levels as the options want."""
    return Capacity((512,) * (options.levels + 1), 8192, 4 * COUNT, COUNT)


def on_host(tree):
    return jax.device_put(tree, jax.devices("cpu")[0])


def errors_on_device(motion, lines, options=OPTIONS):
    """Mean error of the colour and largest relative ones of the gradients; the brute force runs on
    the host in double precision."""
    weight = weights(dtype=np.float32)
    capacity = roomy(options)
    pixels, report, gradient = pull(motion, shot(lines), weight, options=options, capacity=capacity)
    assert int(report.dropped) == 0 and int(report.hits) > 0
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves((pixels, gradient)))
    repeated, pull_back = jax.vjp(merge_rest, motion)
    host = on_host(jax.tree.map(lambda x: np.asarray(x, np.float64), (repeated, shot(lines))))
    slope = pull_dense(*host, on_host(weight.astype(np.float64)))
    expected = stacked(reference.trace(*host))
    color = np.mean(np.abs(stacked(pixels) - expected)[:, :3])
    if motion.rest is None:
        errors = relative_errors(natural(gradient, motion), natural(slope, motion))
    else:
        single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), slope[0])
        (wanted,) = pull_back(single)
        # The kernels take the limits of time as fixed; the brute force does not.
        gradient, wanted = (replace(x, time_range=None) for x in (gradient[0], wanted))
        errors = {
            str(i): float(np.max(np.abs(a - b)) / max(np.max(np.abs(b)), 1e-30))
            for i, (a, b) in enumerate(
                zip(jax.tree.leaves(gradient), jax.tree.leaves(wanted), strict=True)
            )
        }
    return color, errors


def invisible():
    """A motion of one Gaussian that no ray meets."""
    none = jnp.zeros(1, jnp.float32)
    return eqx.tree_at(lambda m: m.gaussians.opacity, resting(gaussians(1)), none)


def pile(count):
    """Faint Gaussians behind one another, and rays that meet nearly all of them."""
    dice = np.random.default_rng(0)
    crowd = gaussians(count, seed=1, size=(0.5, 2.0), degree=0)
    mean = [0.1 * dice.normal(size=(count, 2)), dice.uniform(1, 9, (count, 1))]
    crowd = crowd._replace(
        mean=np.concatenate(mean, axis=1), opacity=dice.uniform(0.006, 0.01, count)
    )
    return resting(crowd), shot(rays(place=(0, 0, -8), jitter=0.02, spread=0.01))


def sheet(count):
    """Equal discs in one plane, of all colours: any other order is another colour."""
    discs = gaussians(count, seed=3, degree=0)
    return discs._replace(
        mean=np.zeros((count, 3)),
        quat=np.tile([1.0, 0, 0, 0], (count, 1)),
        scale=np.tile([1.0, 1.0, 0.01], (count, 1)),
        opacity=np.full(count, 0.5),
    )
