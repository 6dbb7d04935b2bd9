"""An inflatable man, as they stand in front of shops."""

import numpy as np

from experiments.blender.paint import stripes_of
from experiments.blender.soft import soft, tube, tube_faces
from experiments.captures.scenes.fabric import SECONDS


def inflatable(foot):
    """Soft things of an inflatable man: a tube of cloth over a blower at `foot` (x, y) that buckles
    and straightens, and two arms."""
    rings, share = 44, np.linspace(0, 1, 44)
    paint = stripes_of(["#e8833a", "#f0c541", "#d33f3a"], 0.14, (0, 0, 1))
    x, y = foot

    def spine(time):
        t = SECONDS * time
        bend = 0.75 * share * np.sin(2 * np.pi * (1.15 * t - 0.55 * share))
        turn = 0.5 * share * np.sin(2 * np.pi * (0.8 * t - 0.4 * share) + 1.0)
        steps = np.stack([np.sin(bend), np.sin(turn), np.cos(bend) * np.cos(turn)], axis=1)
        return np.cumsum(steps, axis=0) * (1.75 / rings) + (x, y, 0.24)

    def arm(time, side):
        t = SECONDS * time
        base = spine(time)[30]
        along = np.linspace(0, 1, 20)
        lift = 0.5 + 1.1 * np.sin(2 * np.pi * (1.4 * t - 0.6 * along) + 2.0 * side)
        steps = np.stack([0.25 * np.sin(5 * t + along), side * np.cos(lift), np.sin(lift)], axis=1)
        return base + np.cumsum(steps, axis=0) * (0.62 / 20)

    side = np.array([1.0, 0.0, 0.0])
    body = np.interp(share, [0, 0.1, 0.7, 0.95, 1], [0.15, 0.17, 0.15, 0.12, 0.03])
    body = np.repeat(body[:, None], 2, axis=1)
    thin = np.repeat(np.linspace(0.075, 0.05, 20)[:, None], 2, axis=1)
    straight = np.stack([0 * share, 0 * share, 1.75 * share], axis=1)
    rest = tube(straight, side, body, 20)
    made = [
        soft(
            "man",
            rest.tolist(),
            tube_faces(rings, 20),
            lambda time: tube(spine(time), side, body, 20),
            paint,
        )
    ]
    for sign in (1.0, -1.0):
        line = np.linspace(0, 0.62, 20)
        rest = tube(np.stack([0 * line, 0 * line, line], axis=1), side, thin, 12)

        def shape(time, sign=sign):
            return tube(arm(time, sign), side, thin, 12)

        made.append(soft(f"arm_{sign:.0f}", rest.tolist(), tube_faces(20, 12), shape, paint))
    return made
