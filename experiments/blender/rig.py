"""Where cameras stand: along the walls of a room, looking at what happens in it."""

import math

import numpy as np


def on_walls(turn, height, reach, share=1.0):
    """A place at `turn` of a full circle on a `share` of the rounded rectangle of half extents
    `reach` about the origin."""
    x, y = math.cos(2 * math.pi * turn), math.sin(2 * math.pi * turn)
    norm = (x**6 + y**6) ** (1 / 6)
    return reach[0] * share / norm * x, reach[1] * share / norm * y, height


def on_dome(count, held, target, radius, seed):
    """(name, split, world_from_camera) of cameras on a half sphere about the target, evenly spread
    by the golden angle; the `held` ones that are held out lie among the others."""
    places = []
    for k in range(count):
        height = 0.05 + 0.75 * (k + 0.5) / count
        around, turn = math.sqrt(1 - height**2), k * math.pi * (3 - math.sqrt(5))
        offset = np.array([around * math.cos(turn), around * math.sin(turn), height])
        places.append(tuple(np.array(target) + radius * offset))
    tests = {round((j + 0.5) * count / held) for j in range(held)}
    return aimed(places, ["test" if k in tests else "train" for k in range(count)], target, seed)


def aimed(places, splits, target, seed):
    """(name, split, world_from_camera) of cameras at the places that look near the target."""
    rng = np.random.default_rng(seed)
    views = []
    for k, (place, split) in enumerate(zip(places, splits, strict=True)):
        aim = np.array(target) + rng.uniform(-0.15, 0.15, 3)
        views.append((f"cam{k:02d}", split, _look_at(np.array(place), aim)))
    return views


def _look_at(place, aim):
    back = (place - aim) / np.linalg.norm(place - aim)
    right = np.cross((0, 0, 1), back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, place], axis=1)
    return pose
