"""The first transient Gaussians: on points that stereo finds in what moves, at many times."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.reconstruct.initialize.from_points import appearance_of, discs, inliers
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.scene.transient import Transients, interval_at


# Opacity of the first transient Gaussians, and their least thickness relative to their width.
_OPACITY, _FLAT = 0.5, 0.3
# Points of one time further from their neighbours than usual by more than this many standard
# deviations are left out (`fit.outliers` for what stands still): they would begin as large as that.
STRAY = 5.0
# Points of one time below which they are strays.
_FEWEST = 8


def starting_times(times: Float[np.ndarray, " times"], most: int) -> Float[np.ndarray, " starts"]:
    """Evenly spread times, with the first and the last.

    Args:
        times: all timestamps in their order.
        most: largest number of times to return.
    """
    if len(times) <= most:
        return times
    return times[np.linspace(0, len(times) - 1, most).round().astype(int)]


def initial_transients(
    clouds: Sequence[MovingPoints],
    times: Float[np.ndarray, " starts"],
    *,
    count: int,
    degree: int,
    seed: int,
) -> Transients:
    """Transient Gaussians on the moving points of several times, moving as stereo says.

    Each lives about as long as it takes to the next of the times, so that together they show what
    moves at every time.

    Args:
        clouds: the points that stereo finds in what moves, and their velocities, at each time.
        times: the times.
        count: the largest number of Gaussians; each time gets its share of the points.
        degree: of the spherical harmonics.
        seed: of the choice of points.

    Returns:
        The Gaussians; none if there are too few points.
    """
    total = sum(len(cloud.points.position) for cloud in clouds)
    dice = np.random.default_rng([seed, 2])
    share = min(1.0, count / max(total, 1))
    parts = [_on_cloud(cloud, share, dice) for cloud in clouds]
    position, color, velocity, instant, shape, axes = (
        np.concatenate(x).astype(np.float32) for x in zip(*parts, strict=True)
    )
    number = len(position)
    quat, harmonics = appearance_of(jnp.asarray(axes), jnp.asarray(color), degree)
    return Transients(
        mean=jnp.asarray(position),
        velocity=jnp.asarray(velocity),
        quat=quat,
        scale=jnp.asarray(shape),
        opacity=jnp.asarray(np.full(number, _OPACITY, np.float32)),
        harmonics=harmonics,
        instant=jnp.asarray(instant),
        lifetime=interval_at(jnp.asarray(times, jnp.float32), jnp.asarray(instant)),
        plateau=jnp.asarray(np.zeros(number, np.float32)),
    )


def _on_cloud(cloud: MovingPoints, share: float, dice: np.random.Generator) -> tuple:
    """Places, linear colours, velocities, instants, scales and axes on a share of the points of one
    time."""
    found = cloud.points
    kept = np.flatnonzero(inliers(found.position, STRAY))
    count = round(share * len(kept))
    # A few points have no neighbours that would tell their size.
    rows = np.sort(dice.permutation(kept)[: count if count > _FEWEST else 0])
    position = found.position[rows]
    believed = cloud.believed[rows][:, None]
    velocity = np.where(believed, cloud.velocity[rows], 0)
    shape, axes = discs(position, spread=1.0, flat=_FLAT)
    return position, found.light[rows], velocity, np.full(len(rows), cloud.time), shape, axes
