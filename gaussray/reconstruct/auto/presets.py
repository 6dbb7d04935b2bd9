"""The options that suit a kind of motion on a machine, for fit=auto (`auto_choice`)."""

import math
from dataclasses import replace

import numpy as np

from gaussray.reconstruct.auto.machine import Machine
from gaussray.reconstruct.initialize.body_tracking import TrackOptions
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.optimize.loss import LossOptions
from gaussray.reconstruct.options import FitOptions, ReconstructOptions
from gaussray.tracer.options import TraceOptions


# Steps of each stage of rigid bodies on a GPU (fit=full); on a CPU those of fit=default.
_BODIES_GPU = FitOptions(
    coarse=600, fine=16000, tiles=512, initial_opacity=0.6, motion="deformation"
)
# On stereo's points: twice as many rays in half as many steps, in tiles that SSIM can look at.
_BODIES_STEREO = FitOptions(
    coarse=600,
    fine=8000,
    tiles=256,
    tile_side=16,
    degree=2,
    degree_interval=1000,
    initial_opacity=0.5,
    motion="deformation",
)
# The largest number of Gaussians with bodies, unless more points are there from the start.
_MOST_BODIES = 200_000
# loss.time_smoothness on stereo's points. Rigid bodies move without the field, so it may be smooth
# in time.
_SMOOTH_FIELD = 0.03
# Cost of opacity times number of viewpoints; its maximum, and that of transient Gaussians
# (experiments/captures/log.md).
_COST_OF_OPACITY, _MOST_COST, _MOST_TRANSIENT = 2.0, 0.2, 1.0
# With fewer viewpoints than this it costs so much.
_FEW, _COST_OF_FEW = 5, 0.1


def still_preset(pixels: float, minutes: float, machine: Machine) -> ReconstructOptions:
    """For pictures of one time: relocation under a budget, SSIM, harmonics by degrees.

    Args:
        pixels: number of training pixels.
        minutes: time of the steps.
        machine: what the steps will run on.
    """
    larger = float(np.clip(math.sqrt(pixels / machine.pixels), 1.0, 4.0))
    # Beyond, a step takes so much longer that the same time shows less
    # (experiments/captures/log.md).
    share = 25 if machine.gpu else 50
    low, high = (50_000, 250_000 * larger) if machine.gpu else (10_000, 40_000)
    gaussians = int(np.clip(pixels / share, low, high))
    return ReconstructOptions(
        fit=FitOptions(
            minutes=minutes,
            tiles=machine.tiles,
            tile_side=32,
            validate=0.015,
            # Much of a picture may be plain: a wall, the sky, what an object stands before.
            error_share=0.5,
            degree=3 if machine.gpu else 1,
            degree_interval=1000 if machine.gpu else 300,
            initial_opacity=0.5,
            # Few at first: large Gaussians find the shapes, copies of them the details.
            points=gaussians // 4,
        ),
        loss=LossOptions(l1=0.8, dssim=0.2),
        optimizer=machine.rates(still=True),
        density=_relocation(gaussians, 0.03 if machine.gpu else 0.01, machine),
        trace=_trace(machine),
    )


def transient_preset(
    pixels: float, minutes: float, machine: Machine, motion: str
) -> ReconstructOptions:
    """For motion of any kind: transient Gaussians (fit.motion), with relocation and SSIM.

    Args:
        pixels: number of training pixels.
        minutes: time of the steps.
        machine: what the steps will run on.
        motion: the choice of fit.motion.
    """
    low, high = (100_000, 1_000_000) if machine.gpu else (30_000, 60_000)
    gaussians = int(np.clip(pixels / 85, low, high))
    return ReconstructOptions(
        fit=FitOptions(
            minutes=minutes,
            tiles=machine.tiles_transient,
            tile_side=32,
            validate=0.015,
            degree=2 if machine.gpu else 0,
            degree_interval=1000 if machine.gpu else 0,
            initial_opacity=0.5,
            motion=motion,
            points=gaussians // 4,
            instants=machine.instants,
        ),
        loss=LossOptions(l1=0.8, dssim=0.2),
        optimizer=machine.rates(still=False),
        density=replace(
            _relocation(gaussians, 0.02 if machine.gpu else 0.01, machine),
            transient_cost=10.0 if machine.gpu else 1.0,
        ),
        trace=_trace(machine),
    )


def _relocation(gaussians: int, cost: float, machine: Machine) -> DensityOptions:
    """Relocation under a budget, with a cost of opacity and of scale."""
    return DensityOptions(
        kind="relocate",
        interval=100 if machine.gpu else 25,
        start=0.04,
        stop=0.85,
        opacity=0.005,
        gaussians=gaussians,
        opacity_cost=cost,
        scale_cost=cost,
    )


def _trace(machine: Machine) -> TraceOptions:
    """How the rays of a step are traced. Their hits are many: with k of 32 instead of 16 an H100
    takes three quarters of the time (experiments/captures/log.md)."""
    return TraceOptions(k=32 if machine.gpu else 16, levels=0, transmittance_min=1e-3)


def body_preset(
    pixels: float, machine: Machine, track: TrackOptions, *, given: bool
) -> ReconstructOptions:
    """For rigid bodies and a field: the defaults on a CPU; on a GPU more steps and Gaussians, and a
    search of more poses unless the user set one of its options, which belong together. On stereo's
    points, relocation, SSIM and harmonics better all of it; on given ones what moves gets worse
    (experiments/captures/log.md).

    Args:
        pixels: number of training pixels.
        machine: what the steps will run on.
        track: the options of tracking as set.
        given: whether the fit begins on given points.
    """
    if not machine.gpu:
        return ReconstructOptions(fit=FitOptions(motion="deformation"))
    chosen = ReconstructOptions(
        fit=_BODIES_GPU,
        density=DensityOptions(interval=100, growth=8.0, gaussians=_MOST_BODIES),
        trace=_trace(machine),
        track=TrackOptions(poses=512, elite=40) if track == TrackOptions() else track,
    )
    if given:
        return chosen
    transient = transient_preset(pixels, 0.0, machine, "deformation")
    return replace(
        chosen,
        fit=_BODIES_STEREO,
        loss=replace(transient.loss, time_smoothness=_SMOOTH_FIELD),
        density=replace(transient.density, gaussians=_MOST_BODIES),
    )


def for_few_viewpoints(
    chosen: ReconstructOptions, viewpoints: int, machine: Machine
) -> ReconstructOptions:
    """The options with a higher cost of opacity where few viewpoints show a scene.

    The fewer viewpoints, the more Gaussians hang in the air that make single training pictures
    right and that other cameras see as fog. The loss is a mean over pixels, whatever their number,
    so the cost is divided by the number of viewpoints. With two to four it is lower again: many
    things are seen by one camera alone, and with four what a higher cost gains in other views it
    takes from the views of these cameras at other times. On a CPU, with few steps, it did not pay.

    Args:
        chosen: the options of a preset.
        viewpoints: number of different viewpoints of the training pictures.
        machine: what the steps will run on.
    """
    density = chosen.density
    if not machine.gpu or not density.relocates or viewpoints < 2:
        return chosen
    raised = min(_COST_OF_OPACITY / viewpoints, _MOST_COST) if viewpoints >= _FEW else _COST_OF_FEW
    cost = max(density.opacity_cost, raised)
    factor = min(density.transient_cost, _MOST_TRANSIENT / cost)
    return replace(chosen, density=replace(density, opacity_cost=cost, transient_cost=factor))


def from_rest_preset(pixels: float, minutes: float, machine: Machine) -> ReconstructOptions:
    """For pictures each of which has a time of its own: Gaussians that all times share, on control
    points that begin at rest.

    Args:
        pixels: number of training pixels.
        minutes: time of the steps.
        machine: what the steps will run on.
    """
    transient = transient_preset(pixels, minutes, machine, "from_rest")
    # All times share them, and all follow control points.
    low, high = (50_000, 150_000) if machine.gpu else (10_000, 20_000)
    gaussians = int(np.clip(pixels / 300, low, high))
    return replace(
        transient,
        fit=replace(
            transient.fit,
            coarse=1500 if machine.gpu else 300,
            tiles=machine.tiles,
            points=gaussians // 2,
        ),
        density=replace(transient.density, gaussians=gaussians),
    )
