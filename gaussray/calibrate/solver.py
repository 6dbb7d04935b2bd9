"""Cameras adjusted to pictures of a known scene: robust least squares, from coarse to fine."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from gaussray.calibrate.least_squares import huber, spread, step
from gaussray.calibrate.parameters import SHARED, Unknown
from gaussray.calibrate.residuals import Agreement, Aligner, Sight, sights
from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.scene.scene import Scene
from gaussray.tracer.trace import TraceOptions


# Least standard deviation of residuals: the rounding of 8 bits.
ROUNDING = 1 / 255 / math.sqrt(12)
# A level is done when a step gains less than this share of the cost: coarse ones, and the finest.
COARSE, FINE = 1e-2, 1e-4
# Damping of the first step, its factor after a good and a bad one, and where it is given up.
_DAMPING, _BETTER, _WORSE, _MOST = 1e-3, 0.2, 8.0, 1e8


class Shot(NamedTuple):
    """A picture in linear light, where it counts, the camera as recorded and its number, and the
    scene that it shows in so many key states."""

    light: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    camera: Camera
    owner: int
    scene: Scene
    keys: int


class Total(NamedTuple):
    """The agreement of all shots together: residuals that count, and sums in double precision."""

    residual: Float[np.ndarray, " n"]
    gradient: Float[np.ndarray, " unknowns"]
    curvature: Float[np.ndarray, "unknowns unknowns"]
    inner: Float[np.ndarray, "unknowns unknowns"]
    scatter: Float[np.ndarray, "2 unknowns unknowns"]

    def cost(self, bend: float) -> float:
        """Mean loss, so that it does not matter how much of a picture a lens reaches."""
        return huber(self.residual, bend) / len(self.residual)


class Found(NamedTuple):
    """What an adjustment found: a value of every unknown, the agreement there and before, the
    standard deviation of residuals, and (factor, steps, deviation) of every level."""

    value: Float[np.ndarray, " unknowns"]
    before: Total
    after: Total
    spread: float
    levels: list[tuple[int, int, float]]


def places(told: Sequence[Unknown], cameras: int) -> Int[np.ndarray, "cameras unknowns"]:
    """Where each camera's unknowns stand in the row of all: first those that are shared, then each
    camera's own."""
    shared = np.array([one.kind in SHARED for one in told], bool)
    own = int(np.sum(~shared))
    place = np.zeros((cameras, len(told)), int)
    place[:, shared] = np.arange(np.sum(shared))
    first = np.sum(shared) + own * np.arange(cameras)
    place[:, ~shared] = first[:, None] + np.arange(own)
    return place


def factors(shots: Sequence[Shot], coarsest: int) -> list[int]:
    """Sides of the blocks, in pixels, from coarse to fine: powers of two, such that the smaller
    side of every picture has at least `coarsest` blocks, or is whole."""
    least = min(min(shot.mask.shape) for shot in shots)
    return [2**i for i in range(max(int(math.log2(max(least / coarsest, 1))), 0), -1, -1)]


class Adjustment:
    """Shots of some cameras, and what is unknown of those."""

    def __init__(
        self,
        shots: Sequence[Shot],
        told: tuple[Unknown, ...],
        unit: CameraSet,
        *,
        samples: int,
        bend: float,
        trace: TraceOptions,
    ):
        self.shots, self.told, self.unit, self.bend = shots, told, unit, bend
        self.places = places(told, 1 + max(shot.owner for shot in shots))
        self._align = Aligner(told, samples=samples, trace=trace, bend=bend)

    @property
    def count(self) -> int:
        """How many unknowns there are in all."""
        return int(self.places.max()) + 1

    def level(self, factor: int) -> list[list[Sight]]:
        """What is compared of every shot, in blocks of so many pixels a side."""
        bundle = self._align.trace.bundle
        return [sights(shot.light, shot.mask, factor, bundle=bundle) for shot in self.shots]

    def begin(self, factor: int) -> Total:
        """The agreement of the cameras as recorded."""
        return self.total(np.zeros(self.count), self.level(factor), math.inf)

    def total(self, value: np.ndarray, seen: list[list[Sight]], spread: float) -> Total:
        """The agreement of all shots with these values, if residuals have this deviation."""
        n, residuals = self.count, []
        sums = np.zeros(n), np.zeros((n, n)), np.zeros((n, n)), np.zeros((2, n, n))
        for shot, parts in zip(self.shots, seen, strict=True):
            own = self.places[shot.owner]
            for sight in parts:
                how = shot.scene, shot.camera, self.unit, sight, value[own], spread
                found: Agreement = self._align(*how, keys=shot.keys)
                residuals.append(found.residual[found.counts > 0].ravel())
                sums[0][own] += found.gradient
                sums[1][np.ix_(own, own)] += found.curvature
                sums[2][np.ix_(own, own)] += found.inner
                for total, scatter in zip(sums[3], found.scatter, strict=True):
                    total[np.ix_(own, own)] += scatter
        residual = np.concatenate(residuals) if residuals else np.zeros(0)
        if not residual.size or not all(np.isfinite(x).all() for x in (residual, *sums)):
            raise ValueError(
                "the cameras see nothing that can be compared with their pictures (masks, rays "
                "that the lens does not form, or numbers that are not finite). Start from a nearer "
                "guess, or with fewer calibrate.parameters."
            )
        return Total(residual, *sums)

    def solve(
        self, levels: Sequence[int], *, steps: int, told: Callable[[int, int, float], None]
    ) -> Found:
        """The values that agree best, by Levenberg's and Marquardt's steps at one level after
        another, at most so many at each; `told` hears of every one (factor, step, deviation)."""
        value, deviation, course = np.zeros(self.count), math.inf, []
        seen = []
        for factor in levels:
            seen = self.level(factor)
            enough = FINE if factor == levels[-1] else COARSE
            value, deviation, taken = self._descend(
                value, seen, deviation, steps, enough, lambda i, s, f=factor: told(f, i, s)
            )
            course.append((factor, taken, deviation))
        before = self.total(np.zeros(self.count), seen, deviation)
        return Found(value, before, self.total(value, seen, deviation), deviation, course)

    def _descend(
        self,
        value: np.ndarray,
        seen: list[list[Sight]],
        deviation: float,
        steps: int,
        enough: float,
        told: Callable[[int, float], None],
    ) -> tuple[np.ndarray, float, int]:
        """The best values at a level, the deviation of residuals there, and the steps taken."""
        now, damping = self.total(value, seen, deviation), _DAMPING
        deviation, taken = spread(now.residual, ROUNDING), 0
        while taken < steps and damping < _MOST:
            taken += 1
            change = step(now.curvature, now.gradient, damping)
            trial, bend = self._tried(value + change, seen, deviation), self.bend * deviation
            held = max(now.cost(bend), np.finfo(float).tiny)
            gain = -1.0 if trial is None else 1 - trial.cost(bend) / held
            if trial is None or gain < 0:
                damping *= _WORSE
                continue
            value, now, damping = value + change, trial, damping * _BETTER
            deviation = spread(now.residual, ROUNDING)
            told(taken, deviation)
            if gain < enough:
                break
        return value, deviation, taken

    def _tried(self, value: np.ndarray, seen: list[list[Sight]], spread: float) -> Total | None:
        """The agreement, None where there is none."""
        try:
            return self.total(value, seen, spread)
        except ValueError:
            return None
