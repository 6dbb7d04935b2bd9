"""Where reconstruction starts: Gaussians on known points, and which of them may move."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant


def on_points(
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    *,
    degree: int,
    opacity: float,
) -> Gaussians:
    """Round Gaussians on a point cloud, as large as the gaps between its points.

    The standard deviation is the root mean square distance to the three nearest neighbours (3DGS).
    """
    count = len(position)
    neighbours = min(3, max(count - 1, 1))
    distance, _ = cKDTree(position).query(position, k=neighbours + 1)
    gap = np.sqrt(np.mean(np.square(distance[:, 1:]), axis=1)) if count > 1 else np.ones(count)
    gap = np.clip(gap, 1e-7, None)
    quat = np.zeros((count, 4), np.float32)
    quat[:, 0] = 1
    return Gaussians(
        mean=jnp.asarray(position, jnp.float32),
        quat=jnp.asarray(quat),
        scale=jnp.asarray(np.repeat(gap[:, None], 3, axis=1), jnp.float32),
        opacity=jnp.full(count, opacity, jnp.float32),
        harmonics=constant(jnp.asarray(color, jnp.float32), degree),
    )


def in_common_view(
    origin: Float[np.ndarray, "cameras 3"],
    direction: Float[np.ndarray, "cameras 3"],
    *,
    count: int,
    seed: int,
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3"]]:
    """Random points and grey colours for captures without a point cloud.

    Uniform in a ball around the point nearest to all optical axes (least squares), as wide as the
    median distance of the cameras to it.
    """
    projector = np.eye(3)[None] - direction[:, :, None] * direction[:, None, :]
    system = projector.sum(0) + 1e-6 * np.eye(3)
    center = np.linalg.solve(system, np.einsum("nij,nj->i", projector, origin))
    radius = max(float(np.median(np.linalg.norm(origin - center, axis=1))), 1e-3)
    dice = np.random.default_rng(seed)
    point = dice.normal(size=(count, 3))
    point *= (
        radius * dice.random((count, 1)) ** (1 / 3) / np.linalg.norm(point, axis=1, keepdims=True)
    )
    return (center + point).astype(np.float32), np.full((count, 3), 0.2, np.float32)
