"""Where reconstruction starts: points, known or drawn, and Gaussians on them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from gaussray.geometry import quaternion
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics


# Neighbours by which a point is judged, and the least spread of the logarithm of their distance: in
# a regular grid all distances but those at the border are equal.
_AROUND, _SPREAD = 16, 0.2


def merged(
    position: Float[np.ndarray, "points 3"], color: Float[np.ndarray, "points 3"]
) -> tuple[Float[np.ndarray, "merged 3"], Float[np.ndarray, "merged 3"]]:
    """The points in their order, those of the same place as one of their mean colour.

    Args:
        position: places in the world; only equal ones are the same.
        color: linear light of each point.
    """
    _, first, same = np.unique(position, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(position):
        return position, color
    total = np.zeros((len(first), 3))
    np.add.at(total, same.reshape(-1), color)
    mean = (total / np.bincount(same.reshape(-1))[:, None]).astype(color.dtype)
    order = np.argsort(first)
    return position[first[order]], mean[order]


def typical_gap(position: Float[np.ndarray, "points 3"]) -> float:
    """Median distance of a point to its nearest neighbour, of at most 2,000 points."""
    some = position[:: max(1, len(position) // 2000)]
    distance = KDTree(position).query(some, k=2, workers=-1)[0][:, 1]
    return float(np.median(distance)) or 1e-6 * float(np.ptp(position)) or 1.0


def inliers(position: Float[np.ndarray, "points 3"], limit: float) -> Bool[np.ndarray, " points"]:
    """Which points are not much further from their neighbours than usual.

    Statistical outlier removal (Rusu and Cousins 2011, as in PCL and Open3D) on a robust scale: the
    logarithm of the mean distance to the 16 nearest neighbours is compared with its median, and the
    standard deviation is estimated by the median absolute deviation (at least 0.2). Mean and
    deviation themselves are spoilt by the outliers, and without any they always cut some. A far
    group of more than 16 points stays. Clouds of up to 32 points are kept.

    Args:
        position: places in the world, in any unit.
        limit: standard deviations above the median from which on a point is left out.
    """
    if len(position) <= 2 * _AROUND:
        return np.ones(len(position), bool)
    distance, _ = KDTree(position).query(position, k=_AROUND + 1, workers=-1)
    gap = np.log(np.maximum(distance[:, 1:].mean(axis=1), 1e-30))
    usual = np.median(gap)
    spread = max(1.4826 * float(np.median(np.abs(gap - usual))), _SPREAD)
    return gap <= usual + limit * spread


def on_points(
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    *,
    degree: int,
    opacity: float,
    spread: float = 1.0,
    flat: float = 0.15,
) -> Gaussians:
    """Discs on the surface that a point cloud samples, as large as the gaps between its points.

    Along the surface the standard deviation is `spread` times the root mean square distance to the
    three nearest neighbours (3DGS starts with balls of that size). Across it, it is smaller by the
    ratio of the spreads of the eight nearest neighbours (their principal axes). Opaque discs from
    the start: a ray ends at the first surface instead of passing through dozens of balls.

    Args:
        position: centres of the discs in the world.
        color: linear light, the same in every direction.
        degree: degree of the spherical harmonics, 0 to 3; those above 0 begin at 0.
        opacity: opacity of every disc, in 0..1.
        spread: standard deviation along the surface, in gaps between points.
        flat: least thickness relative to the width; 1 makes balls.
    """
    shape, axes = discs(position, spread=spread, flat=flat)
    quat, harmonics = appearance_of(
        jnp.asarray(axes, jnp.float32), jnp.asarray(color, jnp.float32), degree
    )
    return Gaussians(
        mean=jnp.asarray(position, jnp.float32),
        quat=quat,
        scale=jnp.asarray(shape, jnp.float32),
        opacity=jnp.asarray(np.full(len(position), opacity, np.float32)),
        harmonics=harmonics,
    )


@partial(jax.jit, static_argnames="degree")
def appearance_of(
    axes: Float[Array, "points 3 3"], color: Float[Array, "points 3"], degree: int
) -> tuple[Float[Array, "points 4"], Float[Array, "points coefficients 3"]]:
    """Rotations (quaternions) and harmonics of discs of one colour in every direction; one program.

    Args:
        axes: principal axes of each disc in the world, as columns of a rotation.
        color: linear light.
        degree: degree of the spherical harmonics, 0 to 3.
    """
    return jax.vmap(quaternion)(axes), constant_harmonics(color, degree)


def discs(
    position: Float[np.ndarray, "points 3"], *, spread: float, flat: float
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, "points 3 3"]]:
    """Scales and axes (as columns) of the discs of `on_points`.

    Args:
        position: centres of the discs in the world; of up to three points the gap is taken to be 1.
        spread: standard deviation along the surface, in gaps between points.
        flat: least thickness relative to the width; 1 makes balls.
    """
    count = len(position)
    near = min(8, count - 1)
    if near < 3:
        gap, axes, thin = np.ones(count), np.tile(np.eye(3), (count, 1, 1)), np.ones(count)
    else:
        distance, index = KDTree(position).query(position, k=near + 1, workers=-1)
        gap = np.sqrt(np.mean(np.square(distance[:, 1:4]), axis=1))
        around = position[index].astype(np.float64)
        around -= around.mean(axis=1, keepdims=True)
        spreads, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
        thin = np.sqrt(np.clip(spreads[:, 0] / np.maximum(spreads[:, 1], 1e-30), flat**2, 1))
        axes = axes[:, :, ::-1].copy()
        axes[:, :, 2] *= np.sign(np.linalg.det(axes))[:, None]
    # Points at one place have no gap; the floor is of the cloud's own size, whatever its unit.
    size = float(np.ptp(position, axis=0).max()) if count else 0.0
    gap = spread * np.maximum(gap, 1e-7 * (size or 1.0))
    return np.stack([gap, gap, gap * thin], axis=1), axes


def between(
    position: Float[np.ndarray, "points 3"],
    color: Float[np.ndarray, "points 3"],
    *,
    count: int,
    seed: int,
) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 3"]]:
    """Random points on the surface that a sparse cloud samples, with interpolated colours.

    They lie in triangles of a point and two of its eight nearest neighbours.

    Args:
        position: places of the cloud in the world; of one or two points copies are drawn.
        color: linear light of the cloud.
        count: number of points to draw.
        seed: of the choice of triangles and of places in them.
    """
    dice, near = np.random.default_rng(seed), min(8, len(position) - 1)
    if near < 2 or not count:
        at = dice.integers(len(position), size=count)
        return position[at], color[at]
    index = np.asarray(KDTree(position).query(position, k=near + 1, workers=-1)[1])
    own = dice.integers(len(position), size=count)
    pair = np.argsort(dice.random((count, near)), axis=1)[:, :2] + 1
    corner = np.concatenate([own[:, None], index[own[:, None], pair]], axis=1)
    share = dice.dirichlet(np.ones(3), size=count).astype(np.float32)
    place, tone = (np.einsum("nk,nkc->nc", share, x[corner]) for x in (position, color))
    return place.astype(np.float32), tone.astype(np.float32)


def thinned(total: int, *, count: int, seed: int) -> Int[np.ndarray, " chosen"]:
    """Rows of at most `count` of `total` points, drawn at random, in their order.

    Args:
        total: number of points.
        count: largest number to keep; all are kept if there are no more.
        seed: of the choice.
    """
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(seed).permutation(total)[:count])


def surrounding(
    position: Float[np.ndarray, "points 3"], *, count: int, seed: int
) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 3"]]:
    """Random points and grey colours in the six boxes that adjoin, face to face, the box of the
    points, each as large as it.

    Every ray that leaves the box passes one of them. They take up what is far, and what mirrors
    show: the image of a lamp in a floor is where the lamp would be below it.

    Args:
        position: places in the world; on each axis the lowest and the highest 0.5 % are strays,
            which do not stretch the box.
        count: number of points to draw.
        seed: of the places.
    """
    lower, upper = np.quantile(position, (0.005, 0.995), axis=0)
    size = upper - lower
    size = np.maximum(size, 1e-6 * (size.max() or 1.0))
    dice = np.random.default_rng(seed)
    unit = dice.random((count, 3))
    axis = dice.integers(3, size=count)
    unit[np.arange(count), axis] += np.where(dice.random(count) < 0.5, -1, 1)
    return (lower + size * unit).astype(np.float32), np.full((count, 3), 0.2, np.float32)


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

    Args:
        origin: positions of the cameras in the world.
        direction: unit optical axes of the cameras in the world.
        count: number of points to draw.
        seed: of the places.
    """
    projector = np.eye(3)[None] - direction[:, :, None] * direction[:, None, :]
    system = projector.sum(0) + 1e-6 * np.eye(3)
    center = np.linalg.solve(system, np.einsum("nij,nj->i", projector, origin))
    # Cameras at one place have no distance; the floor is of their own size, whatever the unit.
    least = 1e-3 * float(np.abs(origin).max()) or 1.0
    radius = max(float(np.median(np.linalg.norm(origin - center, axis=1))), least)
    dice = np.random.default_rng(seed)
    point = dice.normal(size=(count, 3))
    point *= (
        radius * dice.random((count, 1)) ** (1 / 3) / np.linalg.norm(point, axis=1, keepdims=True)
    )
    return (center + point).astype(np.float32), np.full((count, 3), 0.2, np.float32)
