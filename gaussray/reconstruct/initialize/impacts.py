"""Where rigid bodies are hit between two pictures, as balls that bounce are.

Poses are known at the times of the pictures, and between them bodies move smoothly
(`scene.bodies.poses_at`). A body that is hit between two pictures changes its velocity at once. As
it moves evenly before and after, both parts of its path can be followed until they meet (subcell
resolution, Harten 1989); that time gets poses of its own. So does the middle of two pictures
between which a body is turned at once while its spin stays: it is taken for a likeness from there
on, and looks right on either side.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from gaussray.reconstruct.initialize.steady_turns import (
    continuous,
    rotations,
    scalar_first,
    spun_on,
)
from gaussray.scene.bodies import Bodies, poses_at


# A body is hit if the paths before and after miss the other side's pose by more than this share of
# its radius, and by more than so many times the usual miss; and they meet within this share of it.
MISSED, TIMES_USUAL, MEET = 0.25, 4.0, 0.35
# All these are set once, on the three balls of one capture (experiments/captures/log.md).
# Radians by which the turns before and after may differ at the hit, and which a spin that stays may
# change between two pictures; and from which on a body is turned at once.
TURNED, AT_ONCE = 0.3, 0.6
# Times between two pictures at which both paths are compared, and how far from the hit, in
# intervals, the path gets poses on either side, so that it is bent there alone.
_STEPS, _BESIDE = 41, 0.05


class Impact(NamedTuple):
    """A hit: the body, the time, and the last picture before and the first one after it, which are
    one if the body is hit when that is taken."""

    body: int
    time: float
    last: int
    first: int


class _Paths(NamedTuple):
    """The poses of one body: times, places and turns, and its acceleration in free flight."""

    time: Float[np.ndarray, " times"]
    place: Float[np.ndarray, "times 3"]
    turn: Rotation
    pull: Float[np.ndarray, "3"]

    def onward(
        self, from_: int, other: int, time: Float[np.ndarray, " t"]
    ) -> Float[np.ndarray, "t 3"]:
        """Places beyond a picture, by its own and its neighbour's pose at steady acceleration."""
        step = self.time[from_] - self.time[other]
        speed = (self.place[from_] - self.place[other]) / step + self.pull * step / 2
        after = (time - self.time[from_])[:, None]
        return self.place[from_] + speed * after + self.pull * after**2 / 2

    def misses(self, last: int, first: int) -> float:
        """How far the paths from before a hit, and from after it, miss the next picture on the
        other side: the lesser of both, because a hit elsewhere leads one of them astray."""
        beyond, back = max(first, last + 1), min(last, first - 1)
        ahead = self.onward(last, last - 1, self.time[[beyond]])[0] - self.place[beyond]
        behind = self.onward(first, first + 1, self.time[[back]])[0] - self.place[back]
        return float(min(np.linalg.norm(ahead), np.linalg.norm(behind)))

    def between(self, time: float) -> Rotation:
        """The turn on the nearest way between the pictures before and after a time."""
        return Slerp(self.time, self.turn)(time)

    def turned(self, from_: int, other: int, time: float) -> Rotation:
        """The turn beyond a picture, at a steady spin."""
        return spun_on(self.turn, self.time, (from_, other), time)


def impacts(bodies: Bodies) -> list[Impact]:
    """Where the poses of bodies say that they are hit.

    Args:
        bodies: poses at the times of the pictures; of fewer than four times nothing is known.
    """
    found = []
    for body, radius in enumerate(np.asarray(bodies.radius, np.float64)):
        own = _paths(bodies, body)
        between = [(i, i + 1) for i in range(1, len(own.time) - 2)]
        if not between:
            continue
        misses = [own.misses(*pair) for pair in between]
        least = max(MISSED * radius, TIMES_USUAL * float(np.median(misses)))
        hits = [
            Impact(body, time, *pair)
            for pair, missed in zip(between, misses, strict=True)
            if missed > least and (time := _meet(own, *pair, MEET * missed)) is not None
        ]
        near = {i for hit in hits for i in (hit.last, hit.first)}
        for i in range(1, len(own.time) - 1):
            if i not in near and own.misses(i, i) > least:
                hits.append(Impact(body, float(own.time[i]), i, i))
        found += hits
    return found


def with_impacts(bodies: Bodies) -> Bodies:
    """The bodies with poses at the times at which they are hit, and just before and after.

    Args:
        bodies: poses at the times of the pictures.
    """
    hits = impacts(bodies)
    # Each body is bent at its own hits, and then followed at the times of all.
    bent = [_bent(bodies, body, hits) for body in range(len(bodies.pivot))]
    if all(len(time) == len(bodies.time) for time, _, _ in bent):
        return bodies
    times = np.unique(np.concatenate([time for time, _, _ in bent]))
    at = jnp.asarray(times, bodies.time.dtype)
    parts = []
    for known, path, turn in bent:
        own = (jnp.asarray(x, bodies.path.dtype) for x in (known, path[None], turn[None]))
        parts.append([x[:, 0] for x in _poses_at_all(*own, at)])
    path, turn = (jnp.stack(x) for x in zip(*parts, strict=True))
    return eqx.tree_at(lambda b: (b.time, b.path, b.turn), bodies, (at, path, turn))


_poses_at_all = jax.jit(jax.vmap(poses_at, (None, None, None, 0)))


def _bent(
    bodies: Bodies, body: int, hits: Sequence[Impact]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, places and turns of a body, with those around its own hits."""
    own = _paths(bodies, body)
    times, places, turns = list(own.time), list(own.place), list(scalar_first(own.turn))

    def add(time: float, place: np.ndarray, turned: Rotation) -> None:
        times.append(time)
        places.append(place)
        turns.append(scalar_first(turned))

    hits = [hit for hit in hits if hit.body == body]
    for hit in hits:
        begin, end = _span(hit, own.time)
        before, after = (hit.last, hit.last - 1), (hit.first, hit.first + 1)
        ends = own.turned(*before, hit.time), own.turned(*after, hit.time)
        # A hit does not turn a body at once: if the spins lead elsewhere, they are not known.
        known = (ends[0] * ends[1].inv()).magnitude() < TURNED
        for time in hit.time + _BESIDE * (end - begin) * np.array([-1, 0, 1]):
            if time not in own.time:
                side = before if time <= hit.time else after
                turned = own.turned(*side, time) if known else own.between(time)
                add(time, own.onward(*side, np.array([time]))[0], turned)
    for i in set(_turned_at_once(own)) - {hit.last for hit in hits}:
        middle, width = (own.time[i] + own.time[i + 1]) / 2, own.time[i + 1] - own.time[i]
        # Two on either side: the slope at the inner ones is that of the leap.
        for time in middle + _BESIDE * width * np.array([-1, -0.5, 0.5, 1]):
            sides = (i, i - 1), (i + 1, i + 2)
            place = np.mean([own.onward(*side, np.array([time]))[0] for side in sides], axis=0)
            side = sides[int(time > middle)]
            add(time, place, own.turned(*side, time))
    order = np.argsort(times, kind="stable")
    return np.array(times)[order], np.array(places)[order], continuous(np.array(turns)[order])


def _turned_at_once(own: _Paths) -> list[int]:
    """The pictures after which a body is turned at once while its spin before and after is one."""
    step = np.diff(own.time)
    if len(step) < 3:
        return []
    spin = (own.turn[1:] * own.turn[:-1].inv()).as_rotvec() / step[:, None]
    here, before, after = spin[1:-1], spin[:-2], spin[2:]
    width = step[1:-1, None]
    leaps = [np.linalg.norm((here - x) * width, axis=1) > AT_ONCE for x in (before, after)]
    stays = np.linalg.norm((before - after) * width, axis=1) < TURNED
    return (1 + np.flatnonzero(leaps[0] & leaps[1] & stays)).tolist()


def _span(hit: Impact, time: Float[np.ndarray, " times"]) -> tuple[float, float]:
    """The time between the pictures around a hit."""
    same = hit.last == hit.first
    return float(time[hit.last - same]), float(time[hit.first + same])


def _meet(own: _Paths, last: int, first: int, least: float) -> float | None:
    """When the paths before and after a hit between two pictures come closest, if they come as
    close as that."""
    time = np.linspace(own.time[last], own.time[first], _STEPS)[1:-1]
    before, after = own.onward(last, last - 1, time), own.onward(first, first + 1, time)
    apart = np.linalg.norm(before - after, axis=1)
    nearest = int(np.argmin(apart))
    inside = 0 < nearest < len(time) - 1
    return float(time[nearest]) if inside and apart[nearest] < least else None


def _paths(bodies: Bodies, body: int) -> _Paths:
    time = np.asarray(bodies.time, np.float64)
    place = np.asarray(bodies.path[body], np.float64)
    turn = rotations(np.asarray(bodies.turn[body], np.float64))
    step = np.diff(time)
    if len(step) < 2:
        return _Paths(time, place, turn, np.zeros(3))
    speed = np.diff(place, axis=0) / step[:, None]
    # Most pictures show free flight, or rest.
    pull = np.median(2 * np.diff(speed, axis=0) / (step[1:] + step[:-1])[:, None], axis=0)
    return _Paths(time, place, turn, pull)
