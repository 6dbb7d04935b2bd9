"""The pose of a rigid body at one time, searched for by the cross-entropy method.

Draw poses, keep those that cost least (`pose_cost`), draw again around these, first in blurred
pictures, then in sharp ones.
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from gaussray.geometry import normalize_quaternion
from gaussray.reconstruct.initialize.pose_cost import (
    Known,
    Others,
    Pictures,
    Pose,
    changed,
    cost_as_seen,
    none_found,
    pose_cost,
    visibility,
)
from gaussray.reconstruct.initialize.pose_draws import (
    change_from,
    distinct_poses,
    far_places,
    far_turns,
    least_costly,
    step_from,
)


class TrackOptions(eqx.Module):
    """How thoroughly poses of rigid bodies are searched for.

    Args:
        poses: poses that are tried in a round; 0: no tracking.
        points: points of a body that are compared with the pictures under each pose.
        elite: the best poses, around which the next round searches.
        rounds: rounds at each blur.
        blur: standard deviations of the blurs in pixels, one after another.
        side: pictures are shrunk to about this many pixels on their shorter side.

    Raises:
        ValueError: a value is out of its range.
    """

    poses: int = eqx.field(static=True, default=128)
    points: int = eqx.field(static=True, default=300)
    elite: int = eqx.field(static=True, default=12)
    rounds: int = eqx.field(static=True, default=4)
    blur: tuple[float, ...] = eqx.field(static=True, default=(2.0, 1.0, 0.5))
    side: int = eqx.field(static=True, default=128)

    def __check_init__(self):
        if self.poses < 0:
            raise ValueError(f"track.poses must be at least 0, got {self.poses}.")
        for name in ("points", "rounds", "side"):
            if getattr(self, name) < 1:
                raise ValueError(f"track.{name} must be at least 1, got {getattr(self, name)}.")
        if self.poses and not 1 < self.elite < self.poses:
            raise ValueError(
                f"track.elite must be between 1 and track.poses, got {self.elite} of {self.poses}."
            )
        if not self.blur or min(self.blur) < 0:
            raise ValueError(f"track.blur must hold numbers of at least 0, got {self.blur}.")


# Of poses that look alike, as those of a grey box do, the nearest is right: what a change by one
# radian or by the body's own size, since the start of the search, adds to the cost. That is a
# difference of colour, of which an 8-bit picture tells 0.004.
FARTHER = 0.003
# Standard deviations, in radians of turn and body sizes of path, with which the search at each blur
# begins, and the least with which it ends; the last pair holds for all further blurs.
WIDTHS = ((0.35, 0.05), (0.1, 0.02), (0.05, 0.005))
# A body that was hit may be anywhere: so many times the number of poses are tried, at places that
# are Cauchy distributed with this half width, in body sizes for every time since it was found. The
# best spots are looked at closer.
PLACE_DRAWS, FAR, SPOTS = 64, 0.6, 16
# Each third point tells the better of few poses; each tenth and twentieth, which of many turns and
# places are worth more points: so many times the number of poses.
ROUGH, TURNS_ROUGH, PLACES_ROUGH, WORTH_MORE = 3, 10, 20, 4
# And it may be turned by any angle: so many times the number of poses are tried as turns at each
# spot, each with a small step, in body sizes. Boxes look alike from several sides: sharper pictures
# decide between the best ones.
TURN_DRAWS, NUDGED, MODES, FINAL = 8, 0.1, 4, 2
# Where a body was found, so many times the number of poses are tried as any turns, and so many of
# those at which it looks alike are looked at closer.
ALL_TURNS, ALIKE = 16, 8


class Start(NamedTuple):
    """Where all bodies are expected, where each was last found for certain and how many times ago,
    and where the others are meanwhile."""

    expected: Pose
    certain: Pose
    since: Float[Array, " bodies"]
    others: Others


@eqx.filter_jit
def search_poses(
    keys: Key[Array, " bodies"],
    known: Known,
    start: Start,
    enough: Float[Array, " bodies"],
    pictures: Pictures,
    options: TrackOptions,
) -> tuple[Pose, Float[Array, " bodies"]]:
    """The best pose of every body, near where it is expected or, where no pose there costs little,
    anywhere around its last certain one; and its cost.

    Args:
        keys: random keys of the poses to try.
        known: the bodies at the first time.
        start: where to search.
        enough: a pose that costs no more is the right one.
        pictures: what the cameras show at the time of the poses.
        options: how thoroughly to search.
    """

    def one(at: tuple[PRNGKeyArray, Array]) -> tuple[Pose, Array]:
        key, body = at
        own = jax.tree.map(lambda x: x[body], known)
        search = _Search(body, own, known, start.expected, start.others, pictures, options)
        near = _narrowed(key, search, search.first, range(len(pictures.layers)))

        def far() -> tuple[Pose, Array]:
            found = _search_far(key, search._replace(begin=start.certain), start.since[body])
            return jax.tree.map(lambda *x: jnp.where(near[1] <= found[1], *x), near, found)

        return jax.lax.cond(near[1] <= enough[body], lambda: near, far)

    return jax.lax.map(one, (keys, jnp.arange(len(keys))))


@eqx.filter_jit
def turn_candidates(
    keys: Key[Array, " chosen"],
    chosen: Int[Array, " chosen"],
    likely: Float[Array, "chosen likely 4"],
    known: Known,
    pose: Pose,
    pictures: Pictures,
    options: TrackOptions,
) -> tuple[Pose, Float[Array, "chosen turns"]]:
    """The turns at which a body looks much as the pictures show it, where it was found: its pose
    first, then likely turns and the best of all turns that differ from one another, each looked at
    closer.

    Args:
        keys: random keys of the turns to try.
        chosen: numbers of the bodies that are looked at.
        likely: turns that are looked at in any case.
        known: all bodies at the first time.
        pose: where they were found.
        pictures: what the cameras show at that time.
        options: how thoroughly to search.

    Returns:
        Poses [chosen, turns], and their costs in the sharpest pictures.
    """
    layers, last = pictures.layers, len(pictures.layers) - 1
    second = min(1, last)

    def one(at: tuple[PRNGKeyArray, Array, Array]) -> tuple[Pose, Array]:
        key, body, turns = at
        own = jax.tree.map(lambda x: x[body], known)
        others = none_found(pose, known)

        def around(begin: Pose) -> _Search:
            every = jax.tree.map(lambda x, own: x.at[body].set(own), pose, begin)
            return _Search(body, own, known, every, others, pictures, options)

        first = jax.tree.map(lambda x: x[body], pose)
        rough = around(first).thinned(ROUGH)
        count = ALL_TURNS * options.poses
        turn = normalize_quaternion(jax.random.normal(key, (count, 4), first.turn.dtype))
        found = Pose(jnp.broadcast_to(first.path[None], (count, 3)), turn)
        found = least_costly(found, rough.seen_costs(found, layers[0]), WORTH_MORE * options.poses)
        cost = rough.seen_costs(found, layers[second])
        found = distinct_poses(found, cost, ALIKE, partial(change_from, size=own.size))

        also = Pose(jnp.broadcast_to(first.path[None], (len(turns), 3)), turns)
        found = jax.tree.map(lambda *x: jnp.concatenate(x), also, found)

        def closer(begin: Pose) -> Pose:
            search = around(begin).thinned(ROUGH)
            return _narrowed(key, search, begin, range(second, last + 1))[0]

        found = jax.lax.map(closer, found, batch_size=_together(None, 16))
        found = jax.tree.map(lambda x, others: jnp.concatenate([x[None], others]), first, found)
        return found, around(first).seen_costs(found, layers[last])

    return jax.lax.map(one, (keys, chosen, likely))


class _Search(NamedTuple):
    """The search for one body: its number, the points that are compared, and where all begin."""

    body: Array
    own: Known
    known: Known
    begin: Pose
    others: Others
    pictures: Pictures
    options: TrackOptions

    @property
    def first(self) -> Pose:
        """The pose around which it begins."""
        return jax.tree.map(lambda x: x[self.body], self.begin)

    def costs(
        self, draw: Float[Array, "draws 6"], pose: Pose, layer: Array
    ) -> Float[Array, " draws"]:
        """What changes of a pose cost: occlusion and slopes of pixels are those of the pose."""
        others, pictures = self.others, self.pictures
        visible = visibility(pose, self.own, self.body, self.known, others, pictures, layer)

        def cost(change: Array) -> Array:
            farther = change_from(self.first, changed(pose, change), self.own.size)
            return pose_cost(change, pose, self.own, visible, layer) + FARTHER * farther

        return jax.lax.map(cost, draw, batch_size=_together(32, 128))

    def costs_of(self, pose: Pose, layer: Array) -> Float[Array, " poses"]:
        """What poses cost that may be far from one another."""

        farther = jax.vmap(partial(change_from, self.first, size=self.own.size))(pose)
        return self.seen_costs(pose, layer) + FARTHER * farther

    def seen_costs(self, pose: Pose, layer: Array) -> Float[Array, " poses"]:
        """How much poses differ from the pictures, however far they are."""

        def cost(pose: Pose) -> Array:
            visible = visibility(
                pose, self.own, self.body, self.known, self.others, self.pictures, layer
            )
            return cost_as_seen(visible, self.own, layer)

        return jax.lax.map(cost, pose, batch_size=_together(None, 512))

    def thinned(self, each: int) -> "_Search":
        """The same with fewer points."""
        few = {name: getattr(self.own, name)[::each] for name in ("place", "normal", "look")}
        return self._replace(own=self.own._replace(**few))


def _together(on_cpu: int | None, on_gpu: int) -> int | None:
    """How many poses are compared at a time (None: one): a GPU would wait for many small kernels,
    and the values of many poses do not fit into the caches of a CPU."""
    return on_cpu if jax.default_backend() == "cpu" else on_gpu


def _search_far(key: PRNGKeyArray, search: _Search, since: Array) -> tuple[Pose, Array]:
    """The best pose anywhere, and its cost: spots first, then turns at them, then both closer."""
    layers, options, first = search.pictures.layers, search.options, search.first
    size, dtype, last = search.own.size, first.path.dtype, len(layers) - 1
    rough, second, kept = search.thinned(ROUGH), min(1, last), WORTH_MORE * options.poses
    keys = jax.random.split(jax.random.fold_in(key, len(layers)))
    draw = far_places(keys[0], PLACE_DRAWS * options.poses, FAR * size * since, dtype)
    pose = jax.vmap(partial(changed, first))(draw)
    pose = least_costly(pose, search.thinned(PLACES_ROUGH).costs_of(pose, layers[0]), kept)
    pose = distinct_poses(
        pose, rough.costs_of(pose, layers[0]), SPOTS, partial(step_from, size=size)
    )
    pose, _ = jax.vmap(lambda x: _narrowed(key, rough, x, range(second)))(pose)
    draw = far_turns(keys[1], TURN_DRAWS * options.poses, NUDGED * size, dtype)
    rougher = search.thinned(TURNS_ROUGH)
    cost = jax.vmap(lambda x: rougher.costs(draw, x, layers[second]))(pose)
    pose = jax.vmap(lambda x: jax.vmap(partial(changed, x))(draw))(pose)
    pose = least_costly(jax.tree.map(jnp.concatenate, pose), cost.reshape(-1), kept)
    cost = rough.costs_of(pose, layers[second])
    pose = distinct_poses(pose, cost, MODES, partial(change_from, size=size))
    pose, cost = jax.vmap(lambda x: _narrowed(key, rough, x, range(second, last)))(pose)
    pose = least_costly(pose, cost, FINAL)
    pose, cost = jax.vmap(lambda x: _narrowed(key, search, x, range(last, last + 1)))(pose)
    best = jnp.argmin(cost)
    return jax.tree.map(lambda x: x[best], pose), cost[best]


def _narrowed(key: PRNGKeyArray, search: _Search, pose: Pose, levels: range) -> tuple[Pose, Array]:
    """The pose around which the best draws gather, round after round, and the cost of the best."""
    options, dtype = search.options, pose.path.dtype
    unit = jnp.concatenate([jnp.ones(3, dtype), jnp.full(3, search.own.size)])

    def one_level(state, at):
        layer, width, keys = at

        def one_round(state, key):
            pose, spread, _ = state
            draw = spread[None] * jax.random.normal(key, (options.poses, 6), dtype)
            draw = draw.at[0].set(0) * unit[None]
            cost = search.costs(draw, pose, layer)
            order = jnp.argsort(cost)[: options.elite]
            best = draw[order]
            spread = jnp.maximum(jnp.std(best, axis=0) / unit, width[1])
            return (changed(pose, jnp.mean(best, axis=0)), spread, cost[order[0]]), None

        pose, spread, cost = state
        return jax.lax.scan(one_round, (pose, jnp.maximum(spread, width[0]), cost), keys)[0], None

    # In a loop all levels are compiled once.
    begin = pose, jnp.zeros(6, dtype), jnp.asarray(jnp.inf, dtype)
    if not levels:
        return pose, begin[2]
    layers = jnp.stack(search.pictures.layers[levels.start : levels.stop])
    widths = jnp.asarray([WIDTHS[min(level, len(WIDTHS) - 1)] for level in levels], dtype)
    keys = [jax.random.split(jax.random.fold_in(key, i), options.rounds) for i in levels]
    pose, _, cost = jax.lax.scan(one_level, begin, (layers, widths, jnp.stack(keys)))[0]
    return pose, cost
