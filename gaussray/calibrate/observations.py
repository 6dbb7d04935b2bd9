"""Chooses and reads the pictures from which cameras are calibrated."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from gaussray.calibrate.options import CalibrateOptions
from gaussray.calibrate.parameters import Unknown
from gaussray.calibrate.solver import Observation
from gaussray.camera.lens import AbstractLens
from gaussray.camera.shutter import time_window
from gaussray.capture.capture import Capture, View
from gaussray.capture.frames import read_encoded, visible_pixels
from gaussray.capture.spread import evenly_spread
from gaussray.color import srgb_decode
from gaussray.scene.scene import Scene, key_count
from gaussray.scene.segmented import Clip, segment_edges, segments_of


def selected_views(capture: Capture, options: CalibrateOptions) -> tuple[str, list[View]]:
    """Choose the views of a capture for calibration.

    Args:
        capture: the capture.
        options: effect, cameras, split and number of frames.

    Returns:
        Name of the effect, and the views.

    Raises:
        ValueError: An effect or camera is unknown, or no picture is chosen.
    """
    groups = {name: views for name, views in capture.by_effect.items() if views}
    effect = options.effect or ("pinhole" if "pinhole" in groups else next(iter(groups)))
    if effect not in groups:
        raise ValueError(
            f"calibrate.effect must be among {', '.join(groups)} of {capture.folder}, "
            f"got {effect!r}."
        )
    cameras = dict.fromkeys(view.camera_name for view in groups[effect])
    for name in options.cameras:
        if name not in cameras:
            raise ValueError(f"calibrate.cameras must be among {', '.join(cameras)}, got {name!r}.")
    chosen: list[View] = []
    for name in options.cameras or cameras:
        views = [view for view in groups[effect] if view.camera_name == name]
        views = [view for view in views if options.split in ("all", view.split)]
        chosen += evenly_spread(views, options.frames) if options.frames else views
    if not chosen:
        raise ValueError(
            f"calibrate.split={options.split} and calibrate.cameras choose no picture of "
            f"{effect} in {capture.folder}."
        )
    return effect, chosen


def check_views(views: Sequence[View], unknowns: tuple[Unknown, ...]) -> None:
    """Check that cameras can be calibrated together.

    Args:
        views: the views.
        unknowns: the unknowns of each camera.

    Raises:
        ValueError: Films or lenses differ, or the recorded cameras leave an unknown undefined.
    """
    first = views[0]
    for view in views:
        if view.window is not None:
            raise ValueError(
                "capture.crop and capture.scale must be left alone: calibrate writes cameras of "
                "whole pictures. Use calibrate.frames to reduce the work."
            )
        one, other = (jax.tree.leaves((v.camera.lens, v.camera.film)) for v in (first, view))
        same = jax.tree.structure(first.camera.lens) == jax.tree.structure(view.camera.lens)
        if not same or first.camera.film != view.camera.film or not _equal(one, other):
            raise ValueError(
                f"calibrate.cameras must have one recorded film and lens, but those of "
                f"{first.camera_name} and {view.camera_name} differ. Calibrate them one by one."
            )
    steps = {float(view.camera.shutter.row_step) for view in views}
    if any(one.kind == "shutter" for one in unknowns) and (0.0 in steps or len(steps) > 1):
        raise ValueError(
            "calibrate.parameters=[shutter] must have one recorded readout for all cameras, got a "
            f"shutter.row_step of {', '.join(f'{x:g}' for x in sorted(steps))}. Write an estimate "
            "into the capture's manifest, or leave shutter out."
        )


def _equal(first: list[Any], other: list[Any]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def read_observation(
    scene: Scene | Clip, view: View, lens: AbstractLens, camera_index: int
) -> Observation:
    """Read a picture in linear light, with its camera and the segment of the scene that it shows.

    Args:
        scene: the scene.
        view: the view.
        lens: the lens to start from.
        camera_index: index of the camera.

    Raises:
        ValueError: The picture shows two segments of the scene.
    """
    film, shutter, edges = view.camera.film, view.camera.shutter, segment_edges(scene)
    first, last = time_window(shutter, (film.width, film.height))
    index = np.searchsorted(edges, [view.time + first, view.time + last], side="right")
    if index[0] != index[1]:
        raise ValueError(
            f"{view.image}: must show one segment of the scene, got a readout across the time "
            f"{edges[index[0]]:g}, where two segments meet. Leave the picture out "
            "(calibrate.frames, capture.frames), or reconstruct with fit.segment=0."
        )
    segment = segments_of(scene)[int(index[0])]
    stored = read_encoded(view)
    full = np.iinfo(stored.dtype).max if stored.dtype == np.uint8 else 1
    light = srgb_decode(stored.astype(np.float64) / full).astype(np.float32)
    mask = visible_pixels(view)
    camera = dataclasses.replace(view.camera, lens=lens)
    return Observation(light, mask, camera, camera_index, segment, key_count(segment, last - first))
