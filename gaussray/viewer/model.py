"""The viewer's model: scene, cameras, and the render jobs that control values describe."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from gaussray.capture.capture import View
from gaussray.config.compose import Configuration, Variations
from gaussray.config.jobs import chosen_views, has_cameras, render_job, rig_options
from gaussray.config.options import build_options
from gaussray.config.yaml_files import to_plain
from gaussray.render.focus import FocusMeter
from gaussray.render.job import RenderJob
from gaussray.render.rig import physical_units as physical, rig as rigs
from gaussray.render.rig.aperture import resolve_aperture
from gaussray.render.rig.view_files import load_views
from gaussray.scene.formats.any_file import load
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.options import TraceOptions
from gaussray.viewer.controls import (
    GROUPS,
    ControlValues,
    choice_values,
    consistent_values,
    pinhole_values,
)
from gaussray.viewer.options import ViewOptions
from gaussray.viewer.viewpoint import (
    Viewpoint,
    horizontal_fov,
    subject_distance,
    trajectory_at,
    view_at,
    viewpoint_of,
)


# Configuration of the viewer's single camera, which the mouse moves.
FREE_CAMERA = {
    "camera.kind": "capture",
    "camera.split": "test",
    "camera.names": [],
    "camera.times": [],
    "camera.eye": [],
    "camera.target": [],
    "camera.up": [],
    "camera.frames": 1,
    "camera.turns": 1.0,
    "camera.file": "",
    "trajectory.kind": "keep",
    "trajectory.file": "",
    "film.size": [],
}
# Pictures of smaller captures are enlarged to this width, in pixels.
MIN_WIDTH = 512
# Widths of the final picture that the viewer offers beside the capture's, in pixels.
FINAL_WIDTHS = (256, 512, 768, 1024, 1920, 3840)
# Values that controls cannot keep from the capture, and the choices that replace them.
KEEP_DEFAULTS = {"lens.model": ("lens", "pinhole"), "shutter.kind": ("shutter", "global")}


# Control values as a hashable key.
FrozenValues = tuple[tuple[str, Any], ...]


class ViewerModel:
    """A scene, its capture's cameras, and render jobs for any viewpoint and control values.

    `initial_values` are the control values of the configuration, `first_view` is the first view
    that its `camera` group chooses, `fov` that view's horizontal field of view in degrees.
    """

    def __init__(self, cfg: Configuration, words: Sequence[str]):
        self.options = build_options(ViewOptions, cfg.view)
        self.source, self.cameras, self.fps = cfg.scene, cfg.cameras, float(cfg.fps)
        self.physical = build_options(physical.PhysicalOptions, cfg.physical)
        options = physical.apply_units(rig_options(cfg), self.physical)
        self.scene: Scene | Clip = load(cfg.scene)
        camera = options.camera
        if camera.kind == "capture" and not has_cameras(cfg):
            camera = rigs.CameraOptions("look_at")
        self.views: list[View] = chosen_views(cfg, self.scene, camera, load_views)
        self.first_view = self._first_view(options.camera)
        self.fov = horizontal_fov(self.first_view.camera)
        self.initial_values = self._initial_values(cfg, options)
        # Controls use scene units; `options` has converted millimetres and milliseconds.
        other_words = [word for word in words if not word.startswith("physical")]
        self._variations = Variations("view", other_words)
        self._configuration_for = functools.lru_cache(64)(self._compose)
        self._job_at_time = functools.lru_cache(256)(self._initial_job)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the final picture: those of the options, or of the capture, at
        least 512 pixels wide. If the options give one side, the other keeps the aspect."""
        w, h = self.first_view.width, self.first_view.height
        if w < MIN_WIDTH:
            w, h = MIN_WIDTH, max(round(MIN_WIDTH * h / w), 1)
        width, height = self.options.width, self.options.height
        if width and not height:
            height = max(round(width * h / w), 1)
        if height and not width:
            width = max(round(height * w / h), 1)
        return width or w, height or h

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Sizes of the final picture that the viewer offers: the first one is `size`, the others
        have its aspect and usual widths."""
        width, height = self.size
        others = [w for w in FINAL_WIDTHS if w != width]
        return [self.size, *((w, max(round(w * height / width), 1)) for w in others)]

    @functools.cached_property
    def initial_viewpoint(self) -> Viewpoint:
        """The viewpoint at which the viewer starts."""
        return viewpoint_of(self.first_view.camera)

    @property
    def times(self) -> tuple[float, float, float]:
        """First and last time of the scene, and the seconds that playing it takes."""
        first, last = (float(t) for t in np.asarray(self.scene.time_range))
        instants = len({view.time for view in self.views})
        return first, last, max(instants - 1, 1) / self.fps

    def job(
        self, values: Mapping[str, Any], viewpoint: Viewpoint, size: tuple[int, int]
    ) -> RenderJob:
        """The render job of a viewpoint.

        Args:
            values: control values by configuration key.
            viewpoint: pose and time of the camera.
            size: width and height of the picture in pixels.

        Raises:
            ValueError: No camera can have these values.
        """
        job = self._job_at_time(_frozen(values), viewpoint.time, size)
        (record,) = job.records
        # Only the trajectory depends on the pose, which the mouse changes all the time.
        camera = eqx.tree_at(lambda c: c.trajectory, record.camera, trajectory_at(viewpoint))
        return job._replace(records=[dataclasses.replace(record, camera=camera)])

    def pinhole_job(
        self, values: Mapping[str, Any], viewpoint: Viewpoint, size: tuple[int, int]
    ) -> RenderJob:
        """The render job of a viewpoint for an ideal pinhole camera without a sensor model.

        Args:
            values: control values by configuration key; those of lens, aperture, shutter and sensor
                are replaced (`pinhole_values`).
            viewpoint: pose and time of the camera.
            size: width and height of the picture in pixels.
        """
        return self.job(pinhole_values(values, self.fov), viewpoint, size)

    def configuration(self, values: Mapping[str, Any]) -> Configuration:
        """The configuration with these control values; it is shared, so do not change it."""
        return self._configuration_for(_frozen(values))

    def _initial_job(self, items: FrozenValues, time: float, size: tuple[int, int]) -> RenderJob:
        """The render job at a time from the initial viewpoint."""
        view = view_at(self.first_view, self.initial_viewpoint._replace(time=time), size)
        return render_job(self._configuration_for(items), lambda _: self.scene, lambda *_: [view])

    def _compose(self, items: FrozenValues) -> Configuration:
        values = {key: list(v) if isinstance(v, tuple) else v for key, v in items}
        return self._variations.with_values({**values, **FREE_CAMERA})

    def _first_view(self, options: rigs.CameraOptions) -> View:
        """The first view that the camera options choose, or the capture's first."""
        fits = [
            view
            for view in self.views
            if (view.camera_name in options.names if options.names else view.split == options.split)
            and (not options.times or min(abs(t - view.time) for t in options.times) < 1e-6)
        ]
        return (fits or self.views)[0]

    def _numeric_aperture(
        self, options: rigs.ApertureOptions, trace: TraceOptions
    ) -> rigs.ApertureOptions:
        """The aperture with a focus distance in scene units, which is measured if it is open."""
        if options.has_shares:
            meter, camera = FocusMeter(self.scene, trace), self.first_view.camera
            measure = functools.partial(meter.subject_distance, camera, options.focus)
            return resolve_aperture(options, measure)
        if isinstance(options.focus_distance, str):
            distance = subject_distance(self.scene, self.initial_viewpoint)
            return dataclasses.replace(options, focus_distance=distance)
        return options

    def _initial_values(self, cfg: Configuration, options: rigs.RigOptions) -> ControlValues:
        aperture = self._numeric_aperture(options.aperture, build_options(TraceOptions, cfg.trace))
        options = dataclasses.replace(options, aperture=aperture)
        values: ControlValues = {"render.samples": cfg.render.samples}
        for group in GROUPS:
            block: Any = to_plain(cfg[group])
            if group != "sensor":
                block = {key: getattr(getattr(options, group), key) for key in block}
            values |= {f"{group}.{key}": value for key, value in block.items()}
        for key, (group, choice) in KEEP_DEFAULTS.items():
            if values[key] == "keep":
                trigger = {k: v for k, v in values.items() if k.startswith("shutter.trig")}
                values |= choice_values(group, choice) | trigger
                if group == "lens":
                    values["lens.fov"] = self.fov
        if values["aperture.radius"] is None:
            values["aperture.radius"] = 0.0
        return values


def _frozen(values: Mapping[str, Any]) -> FrozenValues:
    items = consistent_values(values).items()
    return tuple((key, tuple(v) if isinstance(v, list) else v) for key, v in items)
