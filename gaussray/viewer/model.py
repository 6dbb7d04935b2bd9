"""What the page shows, as a configuration: the same that `gaussray render` makes pictures of."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import numpy as np

from gaussray.capture.formats.paired import View
from gaussray.config.compose import Configuration, Variations
from gaussray.config.jobs import rig_options, shot_of
from gaussray.config.options import build_options
from gaussray.config.yaml_files import to_plain
from gaussray.render.randomize.generate import Shot
from gaussray.render.rig import physical_units as physical, rig as rigs
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.scene.store import load_scene
from gaussray.viewer.controls import GROUPS, Values, chosen, plain, settled
from gaussray.viewer.options import ViewOptions
from gaussray.viewer.viewpoint import Stance, field_of, path_of, stance_of, standing


# How the page's one camera is found among the views, which are one.
FREE = {"camera.split": "test", "camera.names": [], "camera.times": [], "trajectory.kind": "keep"}
# Width of the picture of a capture that is smaller, in pixels.
LEAST = 512
# What a control may not keep from the capture, and what it is instead.
KEEPS = {"lens.model": ("lens", "pinhole"), "shutter.kind": ("shutter", "global")}


# Values of controls, as keys of what was made of them.
Items = tuple[tuple[str, Any], ...]


class Studio:
    """A scene, the cameras that saw it, and shots from any stance with the controls at any values.

    `begin` are the values that the configuration gives the controls; `start` is the view that its
    `camera` chooses first, from where the page looks first.
    """

    def __init__(self, cfg: Configuration, words: Sequence[str]):
        self.options = build_options(ViewOptions, cfg.view)
        self.source, self.cameras, self.fps = cfg.scene, cfg.cameras, float(cfg.fps)
        self.physical = build_options(physical.PhysicalOptions, cfg.physical)
        wanted = physical.applied(rig_options(cfg), self.physical)
        self.scene: Scene | Clip = load_scene(cfg.scene)
        self.views: list[View] = rigs.cameras_of(cfg.scene, cfg.cameras)
        self.start = self._first(wanted.camera)
        self.field = field_of(self.start.camera)
        self.begin = self._begin(cfg, wanted)
        # The controls say in the scene's units what was given in millimetres and milliseconds.
        kept = [word for word in words if not word.startswith("physical")]
        self._variations = Variations("view", kept)
        self._made = functools.lru_cache(64)(self._configured)
        self._held = functools.lru_cache(256)(self._still)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a picture when nothing moves: the capture's, small ones enlarged,
        unless the options say. One side that is given keeps the shape."""
        w, h = self.start.width, self.start.height
        if w < LEAST:
            w, h = LEAST, max(round(LEAST * h / w), 1)
        width, height = self.options.width, self.options.height
        if width and not height:
            height = max(round(width * h / w), 1)
        if height and not width:
            width = max(round(height * w / h), 1)
        return width or w, height or h

    @functools.cached_property
    def stance(self) -> Stance:
        """Where the page looks from first."""
        return stance_of(self.start.camera)

    @property
    def times(self) -> tuple[float, float, float]:
        """First and last time of the scene, and the seconds that it plays for."""
        first, last = (float(t) for t in np.asarray(self.scene.time_range))
        instants = len({view.time for view in self.views})
        return first, last, max(instants - 1, 1) / self.fps

    def shot(self, values: Mapping[str, Any], stance: Stance, size: tuple[int, int]) -> Shot:
        """What is filmed from here; a ValueError, with key and rule, where no camera can do it."""
        still = self._held(_frozen(values), stance.time, size)
        (record,) = still.records
        # Nothing but the path depends on where the camera stands: a mouse changes that alone.
        camera = eqx.tree_at(lambda c: c.trajectory, record.camera, path_of(stance))
        return still._replace(records=[dataclasses.replace(record, camera=camera)])

    def sharp_shot(self, values: Mapping[str, Any], stance: Stance, size: tuple[int, int]) -> Shot:
        """The same through an ideal pinhole."""
        return self.shot(plain(values, self.field), stance, size)

    def configured(self, values: Mapping[str, Any]) -> Configuration:
        """The configuration with the controls at these values; not to be changed."""
        return self._made(_frozen(values))

    def _still(self, items: Items, time: float, size: tuple[int, int]) -> Shot:
        """A shot of a time from where the page looks first."""
        view = standing(self.start, self.stance._replace(time=time), size)
        return shot_of(self._made(items), lambda _: self.scene, lambda *_: [view])

    def _configured(self, items: Items) -> Configuration:
        told = {key: list(v) if isinstance(v, tuple) else v for key, v in items}
        return self._variations.with_values({**told, **FREE})

    def _first(self, wanted: rigs.CameraOptions) -> View:
        """The first view that is chosen, or the first there is."""
        fits = [
            view
            for view in self.views
            if (view.camera_name in wanted.names if wanted.names else view.split == wanted.split)
            and (not wanted.times or min(abs(t - view.time) for t in wanted.times) < 1e-6)
        ]
        return (fits or self.views)[0]

    def _begin(self, cfg: Configuration, wanted: rigs.RigOptions) -> Values:
        values: Values = {"render.samples": cfg.render.samples}
        for group in GROUPS:
            block: Any = to_plain(cfg[group])
            if group != "sensor":
                block = {key: getattr(getattr(wanted, group), key) for key in block}
            values |= {f"{group}.{key}": value for key, value in block.items()}
        for key, (group, choice) in KEEPS.items():
            if values[key] == "keep":
                moved = {k: v for k, v in values.items() if k.startswith("shutter.trig")}
                values |= chosen(group, choice) | moved
                if group == "lens":
                    values["lens.fov"] = self.field
        if values["aperture.radius"] == -1:
            values["aperture.radius"] = 0.0
        return values


def _frozen(values: Mapping[str, Any]) -> Items:
    told = settled(values).items()
    return tuple((key, tuple(v) if isinstance(v, list) else v) for key, v in told)
