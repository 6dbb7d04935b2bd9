"""Control points on soft surfaces, followed from one time's stereo points to the next.

Some points of the first time become control points. Their motion to each later time is found by
non-rigid registration: the points around them move along, are matched with the points of that time
by place and colour, and the control points move to where the matches want them, as rigidly as
possible among neighbours (Sorkine and Alexa 2007). Matches are wide and the surface is stiff at
first. What is matched is always the first time's points, so errors do not add up.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.spatial import KDTree

from gaussray.geometry import product, rotation_matrix
from gaussray.reconstruct.initialize.from_points import inliers
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.reconstruct.initialize.stereo.velocity import best_rotation, typical_gap
from gaussray.scene.control_points import ControlPoints


# Control points that a moved point hangs on, and neighbours that a control point holds on to.
_HELD_BY, _NEIGHBOURS = 4, 8
# Width of a control point's weights, in distances to its third neighbour.
_WIDTH = 0.7
# Points further from their neighbours than usual by so many standard deviations are left out, and
# those with fewer points than _AROUND within four gaps are no place for a control point.
_STRAY, _AROUND = 5.0, 8
# Points of the first time below which nothing is followed, and what stands for missing rows.
_FEWEST, _NOWHERE = 64, 1e4


class SurfaceOptions(eqx.Module):
    """Settings of surface tracking, chosen on one synthetic capture with known motion.

    Args:
        control: number of control points.
        source: number of points of the first time that are matched.
        target: number of points of the other time that they are matched with.
        rounds: rounds of matching at every time.
        solves: in each round, how often places and rotations are solved for in turn.
        stiff: weight of rigidity in the first and the last round.
        width: gaps between points that count as far as `color`, in the first and the last round.
        color: difference of colours that counts as far as one width.
    """

    control: int = eqx.field(static=True, default=1200)
    source: int = eqx.field(static=True, default=6000)
    target: int = eqx.field(static=True, default=12000)
    rounds: int = eqx.field(static=True, default=12)
    solves: int = eqx.field(static=True, default=3)
    stiff: tuple[float, float] = eqx.field(static=True, default=(30.0, 1.0))
    width: tuple[float, float] = eqx.field(static=True, default=(16.0, 2.0))
    color: float = eqx.field(static=True, default=0.15)


def surface_options(platform: str) -> SurfaceOptions:
    """Settings with which a device (cpu, gpu) needs about a second for a time.

    Args:
        platform: kind of the device, as JAX names it; all but cpu are GPUs.
    """
    return (
        SurfaceOptions(control=600, source=3000, target=6000)
        if platform == "cpu"
        else SurfaceOptions()
    )


class _Surface(NamedTuple):
    """The points of the first time, in gaps, and how they hang on the control points.

    Args:
        position: the points.
        color: their colours.
        near: the control points that hold each.
        weight: their weights.
        pivot: the control points.
        edge: pairs of neighbouring control points: each and one of its neighbours.
        strength: weight of each pair.
    """

    position: Float[Array, "points 3"]
    color: Float[Array, "points 3"]
    near: Int[Array, "points held"]
    weight: Float[Array, "points held"]
    pivot: Float[Array, "control 3"]
    edge: tuple[Int[Array, " pairs"], Int[Array, " pairs"]]
    strength: Float[Array, " pairs"]


class _Cloud(NamedTuple):
    """Points of another time, in gaps, padded."""

    position: Float[Array, "rows 3"]
    color: Float[Array, "rows 3"]


def tracked_surface(
    clouds: Sequence[MovingPoints],
    *,
    options: SurfaceOptions | None = None,
    seed: int = 0,
    report: Callable[[int, int], object] = lambda done, total: None,
) -> ControlPoints | None:
    """Control points on the moving surfaces of the first time, with their poses at all times.

    Args:
        clouds: the moving points of each time, the earliest first.
        options: how carefully to follow; None chooses by device.
        seed: of the choice of points.
        report: called with the number of times done and their total.

    Returns:
        The control points; None where the first time has too few points to follow, or there is no
        other time.
    """
    options = options or surface_options(jax.default_backend())
    dice = np.random.default_rng([seed, 3])
    position, color = _kept(clouds[0])
    if len(position) < _FEWEST or len(clouds) < 2:
        return None
    gap = typical_gap(position)
    dense = _dense(position, gap)
    if dense.sum() < _FEWEST:
        return None
    position, color = position[dense], color[dense]
    middle = position.mean(axis=0)
    surface, radius = _surface((position - middle) / gap, color, options, dice)
    place, turn = surface.pivot, jnp.zeros((len(radius), 4), surface.pivot.dtype).at[:, 0].set(1)
    places, turns = [np.asarray(place)], [np.asarray(turn)]
    for k, cloud in enumerate(clouds[1:], 1):
        there, shade = _kept(cloud)
        # At constant speed so far, unless the points say otherwise.
        start = places[-1] if k < 2 else 2 * places[-1] - places[-2]
        if len(there) < _FEWEST:
            # Nothing to follow: as before.
            places.append(places[-1])
            turns.append(turns[-1])
        else:
            target = _cloud((there - middle) / gap, shade, options.target, dice)
            motion = _registered(surface, target, jnp.asarray(start), turn, options)
            moved, turned = (np.asarray(x) for x in motion)
            found = np.isfinite(moved).all() and np.isfinite(turned).all()
            places.append(moved if found else places[-1])
            turned = turned if found else turns[-1]
            flip = np.sum(turned * turns[-1], axis=1, keepdims=True) < 0
            turns.append(np.where(flip, -turned, turned))
        turn = jnp.asarray(turns[-1])
        report(k, len(clouds) - 1)
    path = gap * (np.stack(places, axis=1) - places[0][:, None])
    return ControlPoints(
        pivot=jnp.asarray(gap * places[0] + middle, jnp.float32),
        radius=jnp.asarray(gap * radius, jnp.float32),
        time=jnp.asarray([cloud.time for cloud in clouds], jnp.float32),
        path=jnp.asarray(path, jnp.float32),
        turn=jnp.asarray(np.stack(turns, axis=1), jnp.float32),
    )


def with_surface_velocities(
    clouds: Sequence[MovingPoints], control: ControlPoints
) -> list[MovingPoints]:
    """The same points; those near a control point have its velocity until the next time (at the
    last time, since the one before).

    Args:
        clouds: the moving points of each time.
        control: the control points, with a pose for each of these times.
    """
    pivot, path, radius = (np.asarray(x) for x in (control.pivot, control.path, control.radius))
    result = []
    for k, cloud in enumerate(clouds):
        other = k + 1 if k + 1 < len(clouds) else k - 1
        if not len(cloud.points.position):
            result.append(cloud)
            continue
        away, nearest = KDTree(pivot + path[:, k]).query(cloud.points.position)
        near = away < 2 * radius[nearest]
        step = (path[:, other] - path[:, k]) / (clouds[other].time - cloud.time)
        velocity = np.where(near[:, None], step[nearest], cloud.velocity)
        residual = np.where(near, 0.0, cloud.residual).astype(cloud.residual.dtype)
        result.append(cloud._replace(velocity=velocity.astype(np.float32), residual=residual))
    return result


def _kept(cloud: MovingPoints) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Places and colours of the points of a time without strays."""
    found = cloud.points
    kept = np.flatnonzero(inliers(found.position, _STRAY)) if len(found.scale) > 1 else []
    return found.position[kept], found.color[kept]


def _dense(position: Float[np.ndarray, "n 3"], gap: float) -> Bool[np.ndarray, " n"]:
    """Which points have others around them."""
    tree = KDTree(position)
    return tree.query_ball_point(position, 4 * gap, return_length=True) >= _AROUND


def _surface(
    position: Float[np.ndarray, "n 3"],
    color: Float[np.ndarray, "n 3"],
    options: SurfaceOptions,
    dice: np.random.Generator,
) -> tuple[_Surface, Float[np.ndarray, " control"]]:
    """The points with their control points, and the widths of these."""
    pivot = position[_spread_out(position, options.control)]
    tree = KDTree(pivot)
    away, beside = (np.asarray(x) for x in tree.query(pivot, k=_NEIGHBOURS + 1))
    # In gaps: points at one place must not make it 0.
    radius = np.maximum(_WIDTH * away[:, 3], 0.1)
    each = np.repeat(np.arange(len(pivot)), _NEIGHBOURS)
    distance, other = away[:, 1:].ravel(), beside[:, 1:].ravel()
    strength = np.exp(-0.5 * (distance / (2 * radius[each])) ** 2)
    chosen = np.sort(dice.permutation(len(position))[: options.source])
    away, near = tree.query(position[chosen], k=_HELD_BY)
    weight = np.exp(-0.5 * (away / radius[near]) ** 2) + 1e-9
    weight /= weight.sum(axis=1, keepdims=True)
    surface = _Surface(
        jnp.asarray(position[chosen], jnp.float32),
        jnp.asarray(color[chosen], jnp.float32),
        jnp.asarray(near),
        jnp.asarray(weight, jnp.float32),
        jnp.asarray(pivot, jnp.float32),
        (jnp.asarray(each), jnp.asarray(other)),
        jnp.asarray(strength, jnp.float32),
    )
    return surface, radius


def _spread_out(position: Float[np.ndarray, "n 3"], count: int) -> Int[np.ndarray, " count"]:
    """Some of the points, each as far as possible from those before it."""
    chosen, away = [len(position) // 2], np.full(len(position), np.inf)
    for _ in range(min(count, len(position) // 2) - 1):
        step = position - position[chosen[-1]]
        away = np.minimum(away, np.einsum("ni,ni->n", step, step))
        chosen.append(int(away.argmax()))
    return np.array(chosen)


def _cloud(position, color, rows: int, dice: np.random.Generator) -> _Cloud:
    """So many of the points, or all and rows far away."""
    chosen = dice.permutation(len(position))[:rows]
    lack = ((0, rows - len(chosen)), (0, 0))
    far = np.pad(position[chosen], lack, constant_values=_NOWHERE)
    shade = np.pad(color[chosen], lack)
    return _Cloud(jnp.asarray(far, jnp.float32), jnp.asarray(shade, jnp.float32))


@partial(jax.jit, static_argnames="options")
def _registered(
    surface: _Surface,
    there: _Cloud,
    place: Float[Array, "control 3"],
    turn: Float[Array, "control 4"],
    options: SurfaceOptions,
) -> tuple[Float[Array, "control 3"], Float[Array, "control 4"]]:
    """Places and rotations of the control points at another time, from a guess of both."""
    count, (a, b), dtype = len(surface.pivot), surface.edge, surface.pivot.dtype
    rows = jnp.arange(len(surface.position))[:, None]
    hold = jnp.zeros((len(rows), count), dtype).at[rows, surface.near].add(surface.weight)
    stiffness = jnp.zeros((count, count), dtype)
    for x, y, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
        stiffness = stiffness.at[x, y].add(sign * surface.strength)
    rest = surface.pivot[b] - surface.pivot[a]
    lever = surface.position[:, None] - surface.pivot[surface.near]

    def arms(turn):
        turned = product("nkij,nkj->nki", rotation_matrix(turn)[surface.near], lever)
        return jnp.sum(surface.weight[..., None] * turned, axis=1)

    def matched(place, turn, width):
        """Weight and goal of each point: the mean of the point it is nearest to and of those that
        are nearest to it, by place and colour."""
        now = product("nc,ci->ni", hold, place) + arms(turn)
        ours = _features(now, surface.color, width, options.color)
        theirs = _features(there.position, there.color, width, options.color)
        square = jnp.sum(ours**2, axis=1)[:, None] + jnp.sum(theirs**2, axis=1)[None]
        square = square - 2 * product("nd,md->nm", ours, theirs)
        best, back = jnp.argmin(square, axis=1), jnp.argmin(square, axis=0)
        sure = _likeness(ours, theirs[best]) + 1e-6
        agree = _likeness(ours[back], theirs)
        total = sure.at[back].add(agree)
        goal = sure[:, None] * there.position[best]
        goal = goal.at[back].add(agree[:, None] * there.position)
        return total, goal / total[:, None]

    def solved(place, turn, weight, goal, stiff):
        rotation = rotation_matrix(turn)
        push = surface.strength[:, None] * product(
            "eij,ej->ei", 0.5 * (rotation[a] + rotation[b]), rest
        )
        pull = jnp.zeros_like(place).at[b].add(push).at[a].add(-push)
        heavy = hold * weight[:, None]
        matrix = product("nc,nd->cd", heavy, hold) + stiff * stiffness
        # Control points that nothing pulls at stay; single precision needs so much of it.
        stay = 1e-4 * (1 + stiff)
        matrix = matrix + stay * jnp.eye(count, dtype=dtype)
        side = product("nc,ni->ci", heavy, goal - arms(turn)) + stiff * pull + stay * place
        place = jax.scipy.linalg.solve(matrix, side, assume_a="pos")
        spans = surface.strength[:, None, None] * rest[:, :, None] * (place[b] - place[a])[:, None]
        return place, best_rotation(jnp.zeros((count, 3, 3), dtype).at[a].add(spans))

    def one_round(motion, sizes):
        width, stiff = sizes
        place, turn = motion
        weight, goal = matched(place, turn, width)
        for _ in range(options.solves):
            place, turn = solved(place, turn, weight, goal, stiff)
        return (place, turn), None

    sizes = [jnp.geomspace(*x, options.rounds, dtype=dtype) for x in (options.width, options.stiff)]
    motion, _ = jax.lax.scan(one_round, (place, turn), tuple(sizes))
    return motion


def _features(position, color, width, shade):
    return jnp.concatenate([position / width, color / shade], axis=-1)


def _likeness(a, b):
    return jnp.exp(-0.5 * jnp.sum((a - b) ** 2, axis=-1))
