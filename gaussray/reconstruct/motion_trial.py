"""A trial of what shows what moves best: short fits without some pictures, which then decide.

Rigid bodies with a field are better at rigid things of which surface points are known, transient
Gaussians, with control points or without, at all others. What a capture holds is not known before.
So both are fitted for a short time without some pictures, and what shows the moving pixels of these
better is taken. Still pixels do not count: the two choices differ in how they fit what stands
still, too.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from gaussray.camera.array import camera_set
from gaussray.capture.capture import Capture, View
from gaussray.reconstruct.data.motion_mask import activity, moved_in_tiles
from gaussray.reconstruct.data.pictures import Footage, footage
from gaussray.reconstruct.data.segments import training_views
from gaussray.reconstruct.failed_fit import FailedFit
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.simplify.candidate import whole_candidate
from gaussray.reconstruct.simplify.measure import (
    CandidateMeter,
    Tracing,
    TrainingViews,
    tile_views,
)
from gaussray.runtime.devices import leads, wait
from gaussray.scene.scene import Scene, key_count
from gaussray.scene.segmented import Clip
from gaussray.tracer.shard import mesh


# Steps of the fine stage of a trial.
_STEPS = 2000
# Cameras from which on one of them is held out at each time, so many of them in turn; else times
# from which on every fourth is.
CAMERAS, _IN_TURN, _TIMES = 5, 4, 8
# Ray bundles on which a trial is measured, at each of so many times.
_TILES, _INSTANTS = 1024, 16

# Reconstructs a capture in a folder.
Fit = Callable[[Capture, Path, ReconstructOptions], Scene | Clip]


def held_out_capture(capture: Capture) -> Capture | None:
    """The training views of a capture, some of them as test views: at each time those of another of
    four cameras, or every fourth time of few cameras; None if these are too few as well."""
    views = training_views(capture)
    names = sorted({view.camera_name for view in views})
    times = sorted({view.time for view in views})
    if len(names) >= CAMERAS:
        chosen = [names[int((k + 0.5) * len(names) / _IN_TURN)] for k in range(_IN_TURN)]
        turn = {time: chosen[i % _IN_TURN] for i, time in enumerate(times)}
        held = {id(view) for view in views if view.camera_name == turn[view.time]}
    elif len(times) >= _TIMES:
        missing = set(times[2:-1:4])
        held = {id(view) for view in views if view.time in missing}
    else:
        return None
    split = [replace(v, split="test" if id(v) in held else "train") for v in views]
    return replace(capture, views=split, effects={})


def trial(
    capture: Capture,
    out: Path,
    rivals: Mapping[str, ReconstructOptions],
    fit: Fit,
    devices: int | None,
) -> dict[str, float]:
    """PSNR in dB of the pixels that move in what is held out (of all where none does; 0 of a fit
    that failed), for every choice of `fit.motion` and its options.

    Args:
        capture: the capture with held-out views (`held_out_capture`).
        out: the folder of the run; the trial's own is removed.
        rivals: the options of each choice of fit.motion.
        fit: reconstructs a capture in a folder.
        devices: how many devices share the rays (None: all).
    """
    folder, scores = out / "trial", {}
    for name, options in rivals.items():
        _remove(folder)
        short = replace(options.fit, auto=False, minutes=0.0, fine=_STEPS, refine=())
        options = replace(options, fit=short, need=replace(options.need, loss=0.0))
        try:
            scene = fit(capture, folder, options)
        except FailedFit:
            scores[name] = 0.0
            continue
        scores[name] = _psnr(scene, capture.views, options, devices)
    _remove(folder)
    return scores


def trial_sentence(scores: Mapping[str, float], nouns: Mapping[str, str]) -> str:
    """A line that tells how a trial ended.

    Args:
        scores: PSNR in dB of every choice of fit.motion (`trial`), at least one.
        nouns: what to call each choice.
    """
    best = max(scores, key=lambda name: scores[name])
    others = [f"{nouns[name]} {scores[name]:.1f} dB" for name in scores if name != best]
    return (
        f"Trial on moving pixels that were held out: {nouns[best]} {scores[best]:.1f} dB, "
        f"{', '.join(others)}; fit.motion={best}."
    )


def _remove(folder: Path) -> None:
    if leads():
        shutil.rmtree(folder, ignore_errors=True)
    wait("trial")


def _psnr(
    scene: Scene | Clip, views: Sequence[View], options: ReconstructOptions, devices: int | None
) -> float:
    """PSNR of a scene on the moving pixels of tiles of those views that are held out."""
    assert isinstance(scene, Scene)
    names = {view.camera_name for view in views if view.split == "test"}
    # The other pictures of these cameras tell what moves, too.
    own = [view for view in views if view.camera_name in names]
    held = np.flatnonzero([view.split == "test" for view in own])
    every = footage(own, side=options.trace.bundle, bundle=options.trace.bundle)
    plain = _frames(every, held)
    tracing = Tracing(options.trace, mesh(devices), _keys(scene, plain))

    def meter(seen: Footage) -> CandidateMeter:
        views = TrainingViews(seen, seen.camera)
        chosen = tile_views(views, tiles=_TILES, instants=_INSTANTS, weigh=1, seed=0)
        return CandidateMeter(chosen.measured, tracing)

    moving = meter(_frames(moving_alone(every), held))
    return (moving if moving.weight else meter(plain)).psnr(whole_candidate(scene))


def _frames(seen: Footage, rows: Int[np.ndarray, " rows"]) -> Footage:
    """Some of the pictures."""
    return replace(
        seen,
        pixel=seen.pixel[rows],
        mask=None if seen.mask is None else seen.mask[rows],
        camera=jax.tree.map(lambda x: x[rows], seen.camera),
        name=seen.name[rows],
        viewpoint=seen.viewpoints[rows],
    )


def moving_alone(seen: Footage) -> Footage:
    """The same pictures, of which only the pixels count that differ from the temporal median."""
    counts = moved_in_tiles(seen, activity(seen), np.arange(len(seen.pixel)))
    visible = seen.visible(slice(None), slice(None))
    if visible is not None:
        counts &= visible
    return replace(seen, mask=np.packbits(counts, axis=-1))


def _keys(scene: Scene, seen: Footage) -> int:
    """The number of key states of the scene across the times of one picture."""
    cameras = camera_set(np.zeros(len(seen.name), int), seen.camera, extent=1.0, refine=())
    span = float(jnp.asarray(cameras.earlier + cameras.later))
    return key_count(scene, span) if span > 0 else 1
