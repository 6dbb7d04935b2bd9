"""Camera unknowns from pictures of a known scene: robust Levenberg-Marquardt, coarse to fine."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from gaussray.calibrate.least_squares import huber, marquardt_step, robust_deviation
from gaussray.calibrate.parameters import SHARED, Unknown
from gaussray.calibrate.pixel_blocks import PixelBlocks, pixel_blocks
from gaussray.calibrate.residuals import CameraEstimate, NormalEquations, ResidualEvaluator
from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.scene.scene import Scene


# Least standard deviation of residuals: that of rounding to 8 bits.
QUANTISATION = 1 / 255 / math.sqrt(12)
# A level ends when a step lowers the cost by less than this share: coarse levels, the finest one.
COARSE, FINE = 1e-2, 1e-4
# Damping of the first step, its factor after a good and after a bad step, and where a level ends.
_DAMPING, _BETTER, _WORSE, _MOST = 1e-3, 0.2, 8.0, 1e8


class Observation(NamedTuple):
    """A picture in linear light with its mask, its camera as recorded, the index of that camera,
    and the scene that it shows with the number of key states to render it with."""

    light: Float[np.ndarray, "h w 3"]
    mask: Bool[np.ndarray, "h w"]
    camera: Camera
    camera_index: int
    scene: Scene
    keys: int


class Sums(NamedTuple):
    """Residuals of all blocks that count, and the normal equations over all observations, in
    double precision (see `residuals.NormalEquations`)."""

    residual: Float[np.ndarray, " n"]
    gradient: Float[np.ndarray, " unknowns"]
    curvature: Float[np.ndarray, "unknowns unknowns"]
    inlier_curvature: Float[np.ndarray, "unknowns unknowns"]
    scatter: Float[np.ndarray, "2 unknowns unknowns"]

    def cost(self, bend: float) -> float:
        """Mean loss; a mean, because the number of blocks that count changes with the lens."""
        return huber(self.residual, bend) / len(self.residual)


class Solution(NamedTuple):
    """Values of all unknowns, the sums before and after, and (block side, steps, deviation) of
    every level."""

    value: Float[np.ndarray, " unknowns"]
    before: Sums
    after: Sums
    levels: list[tuple[int, int, float]]


# Called after each step with the block side of the level, the step and the deviation.
StepCallback = Callable[[int, int, float], None]


def unknown_places(
    unknowns: Sequence[Unknown], cameras: int
) -> Int[np.ndarray, "cameras unknowns"]:
    """Index of each camera's unknowns among all: first the shared ones, then camera by camera.

    Args:
        unknowns: the unknowns of a camera, the same for all; those of a kind in `SHARED` have one
            index for all cameras.
        cameras: number of cameras.
    """
    shared = np.array([unknown.kind in SHARED for unknown in unknowns], bool)
    separate = int(np.sum(~shared))
    index = np.zeros((cameras, len(unknowns)), int)
    index[:, shared] = np.arange(np.sum(shared))
    first = np.sum(shared) + separate * np.arange(cameras)
    index[:, ~shared] = first[:, None] + np.arange(separate)
    return index


def block_sides(observations: Sequence[Observation], coarsest: int) -> list[int]:
    """Sides of the blocks of each level in pixels, coarse to fine: powers of two down to 1.

    Args:
        observations: the pictures.
        coarsest: least number of blocks along the smaller side of a picture at the first level.
    """
    least = min(min(observation.mask.shape) for observation in observations)
    return [2**i for i in range(max(int(math.log2(max(least / coarsest, 1))), 0), -1, -1)]


class CameraSolver:
    """Estimates the unknowns of some cameras from observations of a known scene.

    Args:
        observations: pictures with their recorded cameras.
        unknowns: the unknowns of each camera.
        unit: units of the unknowns (`parameters.unit_camera_set`).
        residuals: compares a camera estimate with a picture.
    """

    def __init__(
        self,
        observations: Sequence[Observation],
        unknowns: tuple[Unknown, ...],
        unit: CameraSet,
        residuals: ResidualEvaluator,
    ):
        self.observations, self.unknowns, self.unit = observations, unknowns, unit
        self.places = unknown_places(
            unknowns, 1 + max(observation.camera_index for observation in observations)
        )
        self._residuals = residuals

    @property
    def count(self) -> int:
        """Number of unknowns of all cameras together."""
        return int(self.places.max()) + 1

    def blocks(self, factor: int) -> list[list[PixelBlocks]]:
        """Every observation in blocks of `factor` x `factor` pixels."""
        bundle = self._residuals.trace.bundle
        return [
            pixel_blocks(observation.light, observation.mask, factor, bundle=bundle)
            for observation in self.observations
        ]

    def recorded_sums(self, factor: int) -> Sums:
        """The sums for the cameras as recorded, in blocks of `factor` x `factor` pixels."""
        return self.sums(np.zeros(self.count), self.blocks(factor), math.inf)

    def sums(self, value: np.ndarray, level: list[list[PixelBlocks]], deviation: float) -> Sums:
        """Sums of robust least squares over the blocks of a level.

        Args:
            value: values of the unknowns.
            level: blocks of each observation.
            deviation: standard deviation of the residuals.

        Raises:
            ValueError: no pixel can be compared, or values are not finite.
        """
        n, residuals = self.count, []
        gradient, scatter = np.zeros(n), np.zeros((2, n, n))
        curvature, inlier_curvature = np.zeros((n, n)), np.zeros((n, n))
        for observation, groups in zip(self.observations, level, strict=True):
            index = self.places[observation.camera_index]
            square = np.ix_(index, index)
            numbers = jnp.asarray(value[index], observation.camera.time.dtype)
            estimate = CameraEstimate(observation.camera, self.unit, self.unknowns, numbers)
            for blocks in groups:
                part: NormalEquations = self._residuals(
                    observation.scene, estimate, blocks, deviation, keys=observation.keys
                )
                residuals.append(part.residual[part.counts > 0].ravel())
                gradient[index] += part.gradient
                curvature[square] += part.curvature
                inlier_curvature[square] += part.inlier_curvature
                scatter[:, *square] += part.scatter
        residual = np.concatenate(residuals) if residuals else np.zeros(0)
        result = Sums(residual, gradient, curvature, inlier_curvature, scatter)
        if not residual.size or not all(np.isfinite(x).all() for x in result):
            raise ValueError(
                "calibrate must have pixels to compare, got none (all are masked or outside the "
                "lens's field of view), or values that are not finite. Start from better recorded "
                "cameras, or estimate fewer calibrate.parameters."
            )
        return result

    def solve(self, levels: Sequence[int], *, steps: int, report: StepCallback) -> Solution:
        """Minimise the robust cost level by level.

        Args:
            levels: block sides, coarse to fine (`block_sides`).
            steps: largest number of steps per level.
            report: called after each step with block side, step and deviation.
        """
        value, deviation, history = np.zeros(self.count), math.inf, []
        level = []
        for factor in levels:
            level = self.blocks(factor)
            minimiser = _Level(self, level, steps, FINE if factor == levels[-1] else COARSE)
            value, deviation, count = minimiser.run(
                value, deviation, lambda i, s, f=factor: report(f, i, s)
            )
            history.append((factor, count, deviation))
        before = self.sums(np.zeros(self.count), level, deviation)
        return Solution(value, before, self.sums(value, level, deviation), history)

    @property
    def bend(self) -> float:
        """Where Huber's loss turns linear, in standard deviations."""
        return self._residuals.bend


class _Level(NamedTuple):
    """Levenberg-Marquardt at one level: its blocks, the most steps, and the gain that ends it."""

    solver: CameraSolver
    blocks: list[list[PixelBlocks]]
    steps: int
    least_gain: float

    def run(
        self, value: np.ndarray, deviation: float, report: Callable[[int, float], None]
    ) -> tuple[np.ndarray, float, int]:
        """The best values, the deviation of residuals there, and the number of steps."""
        now, damping = self.solver.sums(value, self.blocks, deviation), _DAMPING
        deviation, count = robust_deviation(now.residual, QUANTISATION), 0
        while count < self.steps and damping < _MOST:
            count += 1
            change = marquardt_step(now.curvature, now.gradient, damping)
            trial, bend = self._trial(value + change, deviation), self.solver.bend * deviation
            cost = max(now.cost(bend), np.finfo(float).tiny)
            gain = -1.0 if trial is None else 1 - trial.cost(bend) / cost
            if trial is None or gain < 0:
                damping *= _WORSE
                continue
            value, now, damping = value + change, trial, damping * _BETTER
            deviation = robust_deviation(now.residual, QUANTISATION)
            report(count, deviation)
            if gain < self.least_gain:
                break
        return value, deviation, count

    def _trial(self, value: np.ndarray, deviation: float) -> Sums | None:
        """The sums at these values; None if nothing can be compared there."""
        try:
            return self.solver.sums(value, self.blocks, deviation)
        except ValueError:
            return None
