"""The machine that runs a fit, and what it has the time for."""

import math
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from gaussray.reconstruct.optimize.learning_rates import OptimizerOptions


# Learning rates for the thousands of steps that a GPU takes in a minute.
_RATES_GPU = OptimizerOptions(
    quat=3e-3,
    scale=1e-2,
    color=7e-3,
    transient=2.0,
    velocity=1.25e-4,
    instant=5e-3,
    lifetime=1e-2,
)
# Those of stills on a CPU, whose steps draw few tiles (experiments/captures/log.md).
_RATES_CPU_STILL = OptimizerOptions(quat=1.6e-2, scale=3.2e-2, color=3.2e-2)
# Tiles of a step for each GPU, and on a CPU; there more where things move by transient Gaussians
# (experiments/captures/log.md).
_TILES_GPU, _TILES_CPU, _TILES_CPU_TRANSIENT = 64, 4, 8
# Training pixels beyond which a CPU fits smaller pictures: of stills, with rigid bodies (for which
# it was not measured), and with other motion (experiments/captures/log.md).
_PIXELS_STILL, _PIXELS_BODIES, _PIXELS_TRANSIENT = 3e6, 1e7, 4e6
# How many times as long as a small capture a large one is fitted: on a GPU; on a CPU, where larger
# pictures are scaled down, of stills and of what moves.
_LONGEST_GPU, _LONGEST_STILL, _LONGEST_MOVING = 4.0, 1.2, 2.2
# Bytes of a GPU's memory from which on two fits run at the same time: those of 675 pictures of
# 640 x 360 and up to 1,000,000 Gaussians took 9.2 GiB, of 260 pictures of 256 x 256 and 200,000
# Gaussians 1.8 GiB (experiments/captures/log.md).
_MEMORY_OF_TWO = 16 << 30
# Steps of the fine stage of a trial of what shows motion best. On a CPU those with control points
# take longer, and a fit that is given minutes takes fewer (experiments/captures/log.md).
_TRIAL_GPU, _TRIAL_CPU, _TRIAL_CPU_CONTROL = 2000, 500, 300
# The rates that rise with the number of rays in a step.
_WITH_RAYS = ("mean", "quat", "scale", "color", "harmonics")


class Machine(NamedTuple):
    """What decides how much work fits into the time: whether there is a GPU, how many GPUs share
    the rays of a step, and the memory that one of them gives, in bytes."""

    gpu: bool
    gpus: int = 1
    memory: int = 0

    @property
    def runs_two_fits(self) -> bool:
        """Whether two fits of a trial run at the same time: while one compiles programs or works on
        the host, the GPU works on the other. Several GPUs would wait for each other."""
        return self.gpu and self.gpus == 1 and self.memory >= _MEMORY_OF_TWO

    @property
    def tiles(self) -> int:
        """Tiles of 32 x 32 pixels in a step: as many for each GPU as keep one busy."""
        return _TILES_GPU * self.gpus if self.gpu else _TILES_CPU

    @property
    def tiles_transient(self) -> int:
        """Tiles of a step where transient Gaussians show what moves."""
        return self.tiles if self.gpu else _TILES_CPU_TRANSIENT

    @property
    def minutes(self) -> float:
        """Minutes for a capture of `pixels` or fewer."""
        return 3.0 if self.gpu else 4.0

    @property
    def pixels(self) -> float:
        """Training pixels from which on a capture is large."""
        return 2e7 if self.gpu else 2e6

    @property
    def instants(self) -> int:
        """Times at which transient Gaussians start, at most."""
        return 30 if self.gpu else 16

    def trial_steps(self, motion: str) -> int:
        """Steps of the fine stage of one of the fits of a trial of what shows motion best.

        Args:
            motion: what shows motion in it (`fit.motion`).
        """
        if self.gpu:
            return _TRIAL_GPU
        return _TRIAL_CPU_CONTROL if motion == "control_points" else _TRIAL_CPU

    def most_pixels(self, motion: str) -> float:
        """Training pixels beyond which pictures are scaled down.

        Args:
            motion: what shows motion (`fit.motion`); "none" where nothing moves.
        """
        if self.gpu:
            return 1e9
        return {"none": _PIXELS_STILL, "deformation": _PIXELS_BODIES}.get(motion, _PIXELS_TRANSIENT)

    def minutes_for(self, pixels: float, *, still: bool) -> float:
        """Minutes of steps for a capture, longer for larger ones.

        Args:
            pixels: its training pixels, as recorded.
            still: whether nothing moves.
        """
        longest = _LONGEST_GPU if self.gpu else _LONGEST_STILL if still else _LONGEST_MOVING
        return self.minutes * float(np.clip(math.sqrt(pixels / self.pixels), 1.0, longest))

    def rates(self, *, still: bool) -> OptimizerOptions:
        """The learning rates. Of n times as many rays (n GPUs) the gradient is less noisy, and Adam
        takes steps larger by the square root of n (Grendel, Zhao et al. 2024).

        Args:
            still: whether nothing moves.
        """
        if not self.gpu:
            return _RATES_CPU_STILL if still else OptimizerOptions()
        rates, factor = _RATES_GPU, math.sqrt(self.gpus)
        return replace(rates, **{name: getattr(rates, name) * factor for name in _WITH_RAYS})


def this_machine(devices: int | None = None) -> Machine:
    """The machine that runs this process, with its hosts.

    Args:
        devices: how many devices of every host are used; None for all.
    """
    if jax.default_backend() != "gpu":
        return Machine(gpu=False)
    gpus = (devices or jax.local_device_count()) * jax.process_count()
    known = jax.local_devices()[0].memory_stats() or {}
    return Machine(gpu=True, gpus=gpus, memory=known.get("bytes_limit", 0))
