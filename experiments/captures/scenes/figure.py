"""Figures like people: soft tubes about a skeleton whose joints bend, 1.75 m tall."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from experiments.blender.soft import soft, tube, tube_faces


THIGH, SHIN, FOOT = 0.43, 0.43, 0.22
UPPER, FORE = 0.29, 0.31
HIPS, SHOULDERS = 0.11, 0.19  # half widths
TRUNK, NECK = 0.50, 0.10  # from the pelvis to the shoulders, from these to the head
SOLE = 0.07  # height of an ankle
SIDES = {"left": 1.0, "right": -1.0}


class Pose(NamedTuple):
    """Where a figure stands and how its joints bend, in metres and radians; pairs are left, right.

    Angles: `hip` and `shoulder` forwards, `knee` and `elbow` folding, `lift` of an arm to the
    side, `wave` of a forearm beyond that, `twist` of the shoulders against the hips, `lean`
    forwards. `hop` is the height of the lower foot above the floor.
    """

    place: tuple[float, float]
    heading: float
    hip: tuple[float, float] = (0.0, 0.0)
    knee: tuple[float, float] = (0.05, 0.05)
    shoulder: tuple[float, float] = (0.0, 0.0)
    lift: tuple[float, float] = (0.08, 0.08)
    elbow: tuple[float, float] = (0.2, 0.2)
    wave: tuple[float, float] = (0.0, 0.0)
    twist: float = 0.0
    lean: float = 0.03
    hop: float = 0.0


class Clothes(NamedTuple):
    """Patterns of a figure's parts."""

    shirt: Callable
    trousers: Callable
    skin: Callable
    hair: Callable
    shoes: Callable


def figure(name, motion, clothes, stature=1.0):
    """Soft things of a figure whose pose at a time from 0 to 1 is `motion(time)`."""
    limb = [(0, 0.085), (0.45, 0.075), (0.5, 0.066), (0.62, 0.062), (1, 0.042)]
    arm = [(0, 0.062), (0.15, 0.06), (0.5, 0.045), (1, 0.034)]
    chest = [(0, 0.13), (0.1, 0.165), (0.5, 0.14), (0.85, 0.175), (0.97, 0.13), (1, 0.07)]
    parts = [("trunk", chest, 0.68, clothes.shirt, 20), ("neck", [(0, 0.06)], 1, clothes.skin, 8)]
    head = [(0, 0.03), (0.12, 0.075), (0.45, 0.098), (0.7, 0.1), (0.93, 0.06), (1, 0.02)]
    parts.append(("head", head, 1.1, clothes.skin, 20))
    cap = [(0, 0.1), (0.35, 0.112), (0.75, 0.08), (1, 0.02)]
    parts.append(("hair", cap, 1.1, clothes.hair, 12))
    for side in SIDES:
        parts += [
            (f"{side}_leg", limb, 1.1, clothes.trousers, 28),
            (
                f"{side}_foot",
                [(0, 0.035), (0.3, 0.05), (0.8, 0.045), (1, 0.03)],
                0.8,
                clothes.shoes,
                8,
            ),
            (f"{side}_arm", arm, 1.0, clothes.shirt, 24),
            (
                f"{side}_hand",
                [(0, 0.026), (0.4, 0.05), (0.8, 0.045), (1, 0.015)],
                0.6,
                clothes.skin,
                8,
            ),
        ]
    return [_part(name, motion, *part, stature) for part in parts]


def _part(name, motion, part, profile, flat, pattern, rings, stature):
    """One soft tube; `profile` is its (share of the length, radius), `flat` the ratio of its depth
    to its width."""
    share = np.linspace(0, 1, rings)
    radius = np.interp(share, *np.transpose(profile)) * stature
    radii = np.stack([radius, flat * radius], axis=1)
    sectors = 20 if part in ("trunk", "head") else 14

    def shape(time):
        pose = motion(time)
        joints, sideways = skeleton(pose)[part]
        turn = _about_z(pose.heading)
        centres = _along(joints * stature, share, round=0.05 * stature) @ turn.T
        centres += (*pose.place, 0.0)
        return tube(centres, turn @ sideways, radii, sectors)

    length = np.linalg.norm(np.diff(skeleton(motion(0.0))[part][0], axis=0), axis=1).sum()
    straight = np.stack([0 * share, 0 * share, share * length * stature], axis=1)
    rest = tube(straight, np.array([0.0, 1.0, 0.0]), radii, sectors)
    return soft(f"{name}_{part}", rest, tube_faces(rings, sectors), shape, pattern)


def skeleton(pose):
    """The joints (n, 3) of each part and the direction across it, before heading and place: x is
    forwards, y to the left, z up; the lower foot stands on the floor."""
    left, up = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    parts = {}
    for k, (side, sign) in enumerate(SIDES.items()):
        hip = sign * HIPS * left
        thigh = _down(pose.hip[k])
        shin = _down(pose.hip[k] - pose.knee[k])
        knee = hip + THIGH * thigh
        ankle = knee + SHIN * shin
        forwards = np.array([-shin[2], 0.0, shin[0]])
        heel = ankle - 0.06 * forwards + 0.045 * shin
        parts[f"{side}_leg"] = np.stack([hip + 0.06 * up, hip, knee, ankle]), left
        parts[f"{side}_foot"] = np.stack([heel, heel + FOOT * forwards]), left
    trunk = np.array([np.sin(pose.lean), 0.0, np.cos(pose.lean)])
    across = _about_z(pose.twist) @ left
    top = TRUNK * trunk
    parts["trunk"] = np.stack([-0.05 * trunk, 0.5 * top, top]), left + 0.7 * across
    parts["neck"] = np.stack([0.95 * top, top + NECK * trunk]), left
    chin = top + 0.06 * trunk
    parts["head"] = np.stack([chin, chin + 0.25 * up]), left
    parts["hair"] = np.stack([chin + 0.15 * up, chin + 0.275 * up]) - (0.02, 0, 0), left
    for k, (side, sign) in enumerate(SIDES.items()):
        shoulder = 0.95 * top + sign * SHOULDERS * across
        turn = _about_z(pose.twist)
        upper = turn @ _arm(pose.shoulder[k], sign * pose.lift[k])
        fore = turn @ _arm(pose.shoulder[k] + pose.elbow[k], sign * (pose.lift[k] + pose.wave[k]))
        elbow = shoulder + UPPER * upper
        wrist = elbow + FORE * fore
        parts[f"{side}_arm"] = np.stack([shoulder, elbow, wrist]), across
        parts[f"{side}_hand"] = np.stack([wrist - 0.02 * fore, wrist + 0.16 * fore]), across
    sole = min(parts[f"{side}_leg"][0][3][2] for side in SIDES) - SOLE - pose.hop
    return {part: (joints - sole * up, across) for part, (joints, across) in parts.items()}


def _down(forwards):
    return np.array([np.sin(forwards), 0.0, -np.cos(forwards)])


def _arm(forwards, outwards):
    """Downwards, swung forwards, then lifted to the side about the x axis."""
    x, _, z = _down(forwards)
    return np.array([x, -z * np.sin(outwards), z * np.cos(outwards)])


def _about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _along(joints, share, round):
    """Points at shares of the length of a polyline whose corners are rounded over +- `round`."""
    steps = np.linalg.norm(np.diff(joints, axis=0), axis=1)
    reach = np.concatenate([[0.0], np.cumsum(steps)])
    first, last = joints[0] - joints[1], joints[-1] - joints[-2]
    joints = np.concatenate(
        [[joints[0] + first / steps[0]], joints, [joints[-1] + last / steps[-1]]]
    )
    reach = np.concatenate([[-1.0], reach, [reach[-1] + 1.0]])
    place = share[:, None] * reach[-2] + np.linspace(-round, round, 9)
    points = [np.interp(place, reach, joints[:, axis]).mean(axis=1) for axis in range(3)]
    return np.stack(points, axis=1)


def walk(start, heading, pace, cycles, phase=0.0, bend=0.0):
    """The motion of a walk that goes on from `start` for `pace` metres, turning by `bend`."""

    def motion(time):
        way = heading + bend * (time - 0.5)
        middle = heading + bend * (time / 2 - 0.5)
        swing = 2 * np.pi * (cycles * time + phase)
        c, s = np.cos(swing), np.sin(swing)
        return Pose(
            place=(
                start[0] + pace * time * np.cos(middle),
                start[1] + pace * time * np.sin(middle),
            ),
            heading=way,
            hip=(0.46 * c, -0.46 * c),
            knee=(0.12 + 0.95 * max(0.0, -s), 0.12 + 0.95 * max(0.0, s)),
            shoulder=(-0.6 * c, 0.6 * c),
            elbow=(0.35 - 0.3 * c, 0.35 + 0.3 * c),
            twist=0.16 * c,
            lean=0.06,
        )

    return motion
