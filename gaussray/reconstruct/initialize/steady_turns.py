"""Of turns at which a body looks alike, those that a steady spin explains best.

Tracking finds one pose after another. A ball with stripes looks nearly the same at several turns:
once it is taken for one of its likenesses, the spin that is expected next is wrong as well. The
pictures of all times tell them apart, because a body spins at an even rate but where it is hit.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation


# What a change of the spin by one radian between two pictures adds to the cost, which is a
# difference of colour, and the largest change that counts: a body that was hit may spin anyhow.
# From 0.005 to 0.02 the balls of the capture that chose it get the same turns.
STEADY, HIT = 0.01, 1.0
# The mean spin between two pictures lies between the spins before and after, also if a body is hit
# there; one that is taken for its likeness leaps by far more. What a radian beyond adds; in the
# first and the last interval, beyond the one spin next to it. Set on one ball that rolls.
LEAP = 0.02
# Of turns that explain the pictures alike, the nearest: what each radian between pictures adds.
NEARER = 0.003
# A body tumbles, so that other turns are looked at, if its spin changes by more radians than this
# between two pictures.
TUMBLES = 0.35


def tumbling(
    turn: Float[np.ndarray, "bodies times 4"], times: Float[np.ndarray, " times"]
) -> Bool[np.ndarray, " bodies"]:
    """Which bodies change their spin by more than TUMBLES between two pictures.

    Args:
        turn: quaternions at all times, scalar first.
        times: the times.
    """
    if len(times) < 3:
        return np.zeros(len(turn), bool)
    return np.array([_changes([own[None] for own in body], times) for body in turn])


def steadiest(
    turn: list[Float[np.ndarray, "_ 4"]],
    cost: list[Float[np.ndarray, " _"]],
    times: Float[np.ndarray, " times"],
) -> Int[np.ndarray, " times"]:
    """The candidates, one at each time, of least costs, changes of spin and leaps together
    (Viterbi's algorithm over triples of neighbouring times).

    Args:
        turn: quaternions of the candidates at each time, scalar first; the first time has one.
        cost: how much each differs from the pictures.
        times: the times, at least three.

    Returns:
        The index of the candidate at each time.
    """
    spins = _spins(turn, times)
    step = np.diff(times.astype(np.float64))
    # By the candidates at the last three times.
    total = (cost[1][None] + _turn(spins[0], step[0]))[:, :, None]
    total = total + _change(spins[0], spins[1], step[:2]) + cost[2] + _turn(spins[1], step[1])
    total = total + LEAP * _radians(spins[0], spins[1], step[[0, 0]])
    origin = []
    for i in range(3, len(times)):
        change = _change(spins[i - 2], spins[i - 1], step[i - 2 : i])
        leap = _leap(spins[i - 3], spins[i - 2], spins[i - 1], step[i - 2])
        whole = total[..., None] + change + leap
        origin.append(np.argmin(whole, axis=0))
        total = np.min(whole, axis=0) + cost[i] + _turn(spins[i - 1], step[i - 1])
    if len(times) > 3:
        total = total + LEAP * _radians(spins[-2], spins[-1], step[[-1, -1]])
    chosen = [int(x) for x in np.unravel_index(np.argmin(total), total.shape)]
    for back in origin[::-1]:
        chosen.insert(0, int(back[tuple(chosen[:3])]))
    return np.array(chosen)


def expected_turns(
    turn: Float[np.ndarray, "times 4"], times: Float[np.ndarray, " times"], i: int
) -> Float[np.ndarray, "2 4"]:
    """Where the spin before a time, and the one after it, lead at that time; the turn itself where
    there are no two turns on that side.

    Args:
        turn: quaternions at all times, scalar first.
        times: the times.
        i: index of the time.
    """
    rotation, found = rotations(turn), []
    for near, far in ((i - 1, i - 2), (i + 1, i + 2)):
        known = min(near, far) >= 0 and max(near, far) < len(times)
        onward = spun_on(rotation, times, (near, far), float(times[i])) if known else None
        found.append(turn[i] if onward is None else scalar_first(onward))
    return np.stack(found)


def spun_on(
    rotation: Rotation, times: Float[np.ndarray, " times"], pair: tuple[int, int], time: float
) -> Rotation:
    """The turn to which a steady spin leads.

    Args:
        rotation: turns at all times.
        times: the times.
        pair: the time from which the body spins on, and the one which tells, with it, how fast.
        time: when it is asked for.
    """
    near, far = pair
    spin = (rotation[near] * rotation[far].inv()).as_rotvec() / (times[near] - times[far])
    return Rotation.from_rotvec(spin * (time - times[near])) * rotation[near]


def rotations(turn: Float[np.ndarray, "*turns 4"]) -> Rotation:
    """SciPy's rotations of quaternions, scalar first."""
    return Rotation.from_quat(np.roll(turn, -1, axis=-1))


def scalar_first(rotation: Rotation) -> Float[np.ndarray, "*turns 4"]:
    """The quaternions of SciPy's rotations, scalar first."""
    return np.roll(rotation.as_quat(), 1, axis=-1)


def continuous(turn: Float[np.ndarray, "times 4"]) -> Float[np.ndarray, "times 4"]:
    """The same turns, each by that of its two quaternions that is nearer to the one before, so that
    sums of neighbours are turns between them."""
    flips = np.sum(turn[1:] * turn[:-1], axis=1) < 0
    signs = np.where(np.cumsum(flips) % 2 == 1, -1, 1).astype(turn.dtype)
    return np.concatenate([turn[:1], signs[:, None] * turn[1:]])


def _changes(turn: list[Float[np.ndarray, "_ 4"]], times: Float[np.ndarray, " times"]) -> bool:
    spins, step = _spins(turn, times), np.diff(times)
    pairs = range(1, len(spins))
    return any(float(_radians(spins[i - 1], spins[i], step[i - 1 : i + 1]).max()) > TUMBLES
               for i in pairs)  # fmt: skip


def _spins(
    turn: list[Float[np.ndarray, "_ 4"]], times: Float[np.ndarray, " times"]
) -> list[Float[np.ndarray, "_ _ 3"]]:
    """Angular velocities between all candidates of neighbouring times."""
    rotation = [rotations(own) for own in turn]
    spins = []
    for i, step in enumerate(np.diff(times)):
        rows = [(rotation[i + 1] * one.inv()).as_rotvec() for one in rotation[i]]
        spins.append(np.stack(rows) / step)
    return spins


def _radians(
    before: Float[np.ndarray, "a b 3"],
    after: Float[np.ndarray, "b c 3"],
    step: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "a b c"]:
    """Radians by which the spin changes between two pictures."""
    difference = after[None] - before[:, :, None]
    return np.linalg.norm(difference, axis=-1) * np.min(step)


def _turn(spin: Float[np.ndarray, "a b 3"], step: float) -> Float[np.ndarray, "a b"]:
    """What turns between two pictures cost."""
    return NEARER * step * np.linalg.norm(spin, axis=-1)


def _change(
    before: Float[np.ndarray, "a b 3"],
    after: Float[np.ndarray, "b c 3"],
    step: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "a b c"]:
    """What a change of the spin costs."""
    return STEADY * np.minimum(_radians(before, after, step), HIT)


def _leap(
    before: Float[np.ndarray, "a b 3"],
    here: Float[np.ndarray, "b c 3"],
    after: Float[np.ndarray, "c d 3"],
    step: float,
) -> Float[np.ndarray, "a b c d"]:
    """What it costs that a turn is none to which the spins before and after lead, whenever between
    the two pictures the one becomes the other."""
    along = after[None, None] - before[:, :, None, None]
    offset = here[None, :, :, None] - before[:, :, None, None]
    square = np.sum(along * along, axis=-1, keepdims=True)
    share = np.sum(offset * along, axis=-1, keepdims=True) / np.maximum(square, 1e-30)
    away = offset - np.clip(share, 0, 1) * along
    return LEAP * step * np.linalg.norm(away, axis=-1)
