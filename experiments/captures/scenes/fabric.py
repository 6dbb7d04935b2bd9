"""Cloth and blobs: sheets that wave and balls that change their form, as functions of time."""

import numpy as np

from experiments.blender.shapes import ball
from experiments.blender.soft import sheet, soft


SECONDS = 2.0  # of a clip


def flag(name, corner, size, heading, pattern):
    """A flag on a pole: `corner` is its lower corner there, it blows towards `heading`."""
    across, faces = sheet(48, 28)
    u, v = across.T
    wide, high = size

    def shape(time):
        t = SECONDS * time
        wave = 0.24 * u**0.8 * np.sin(2 * np.pi * (1.15 * u - 1.25 * t) + 1.2 * v)
        wave += 0.07 * u * np.sin(2 * np.pi * (2.3 * u + 0.8 * v - 2.1 * t))
        gust = 0.06 * np.sin(2 * np.pi * 0.7 * t)
        x = wide * (u - 0.1 * u * np.sin(2 * np.pi * (1.15 * u - 1.25 * t)) ** 2)
        z = high * v - wide * u**2 * (0.12 + gust) + 0.05 * u * np.sin(2 * np.pi * (u - 1.6 * t))
        return _turned(x, wave, z, heading, corner)

    rest = np.stack([wide * u, 0 * u, high * v], axis=1)
    return soft(name, rest, faces, shape, pattern)


def curtain(name, corner, size, heading, pattern, gust=0.35, folds=7, beat=0.9):
    """A curtain that hangs from its upper edge in folds; a wind lifts it to its left."""
    across, faces = sheet(72, 32)
    u, v = across.T
    wide, high = size

    def shape(time):
        t, low = SECONDS * time, (1 - v) ** 1.3
        fold = 0.05 * (1 + 0.6 * low) * np.sin(2 * np.pi * folds * u + 2.0 * np.sin(1.7 * t) * low)
        push = gust * low * (0.55 + 0.45 * np.sin(2 * np.pi * (beat * t - 0.35 * v + 0.3 * u)))
        push += 0.25 * gust * low * np.sin(2 * np.pi * (1.9 * t + 0.9 * u))
        sway = 0.10 * low * np.sin(2 * np.pi * 0.6 * t + 2 * u)
        z = high * v + 0.4 * push**2
        return _turned(wide * u + sway, fold + push, z, heading, corner)

    rest = np.stack([wide * u, 0 * u, high * v], axis=1)
    return soft(name, rest, faces, shape, pattern)


def spread(name, middle, size, height, heading, pattern, flap=0.30):
    """A cloth over a table top, whose overhang flaps."""
    across, faces = sheet(48, 48)
    a, b = 2 * across.T - 1  # -1 .. 1
    top = 0.72  # share of the cloth that lies on the table

    def shape(time):
        t = SECONDS * time
        over = np.maximum(np.maximum(abs(a), abs(b)) - top, 0) / (1 - top)
        turn = np.arctan2(b, a)
        lift = 0.5 + 0.5 * np.sin(2 * np.pi * 1.1 * t + 2 * turn) + 0.3 * np.sin(9 * t - 3 * turn)
        angle = np.clip(1.35 - flap * 3.2 * lift * (0.4 + 0.6 * over), 0.1, 1.5)
        hang = np.where(over > 0, over * (1 - top), 0) * size[0] / 2
        shrink = np.where(over > 0, top + over * (1 - top) * np.cos(angle), 1.0)
        edge = np.maximum(np.maximum(abs(a), abs(b)), 1e-6)
        scale = np.where(over > 0, shrink / edge, 1.0)
        ripple = 0.03 * over * np.sin(14 * turn + 7 * t)
        z = height - hang * np.sin(angle) + ripple
        return _turned(size[0] / 2 * a * scale, size[1] / 2 * b * scale, z, heading, (*middle, 0.0))

    rest = np.stack([size[0] / 2 * a, size[1] / 2 * b, 0 * a], axis=1)
    return soft(name, rest, faces, shape, pattern)


def blob(name, middle, radius, pattern, seed=0, strength=0.32, beat=1.0, drift=None):
    """A ball whose form flows: waves of a few lengths run over it; `drift(time)` moves its middle
    and scales it: (offset, scale)."""
    corners, faces = ball(1.0, rings=40, sectors=64)
    out = np.array(corners)
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(7, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    lengths = np.array([1.2, 1.6, 2.0, 2.6, 3.2, 4.0, 4.8])
    speeds = beat * rng.uniform(2.0, 5.0, 7) * rng.choice([-1, 1], 7)
    phases = rng.uniform(0, 2 * np.pi, 7)

    def shape(time):
        t = SECONDS * time
        waves = np.sin(lengths * (out @ ways.T) * 2 + speeds * t + phases) / np.sqrt(lengths)
        grown = radius * np.exp(strength * waves.sum(1) / np.sqrt(3.5))
        offset, scale = drift(time) if drift else ((0, 0, 0), 1.0)
        return np.array(middle) + offset + scale * grown[:, None] * out

    return soft(name, (radius * out).tolist(), faces, shape, pattern)


def _turned(x, y, z, heading, corner):
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1) + corner
