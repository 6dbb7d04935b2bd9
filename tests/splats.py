"""Random Gaussians of a static model, and how far others are turned from them."""

import jax.numpy as jnp
import numpy as np

from gaussray.scene.gaussians import Gaussians


def gaussians(count=60, coefficients=16, seed=0):
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(count, 4))
    parts = (
        *(rng.normal(size=(count, 3)), quat / np.linalg.norm(quat, axis=1, keepdims=True)),
        *(np.exp(rng.normal(size=(count, 3)) - 3), rng.uniform(0.05, 0.95, count)),
        rng.normal(size=(count, coefficients, 3)) * 0.2,
    )
    return Gaussians(*(jnp.asarray(part, jnp.float32) for part in parts))


def turned(a, b):
    return float(np.max(1 - np.abs(np.sum(np.asarray(a.quat) * np.asarray(b.quat), axis=1))))
