"""What is filmed of a scene: presets, pictures, and the JSON files that list them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from experiments.blender.blocks import SENSOR_MM, row_times
from experiments.paired_benchmark.stage import FRAMES, READOUT, cameras


EFFECTS = ("pinhole", "fisheye", "depth_of_field", "rolling_shutter")
KIND = {"train": "jpg", "test": "png"}  # what is scored stays lossless
FISHEYE = {
    "model": "blender_fisheye_polynomial",
    "k": [0.0, -0.0745, -1.5e-4, -2.5e-5, 2.0e-7],
    "sensor_width_mm": SENSOR_MM,
    "sensor_height_mm": SENSOR_MM,
    "fov": 2.9,
}


@dataclass(frozen=True)
class Preset:
    """How much is filmed; `held_cameras` and `held_frames` are for scoring alone.

    `samples` are those of training pictures; what is scored gets `truth_samples`. Effects are
    filmed every `effect_step` frames, by the cameras held out or, if `paired`, by all. `depth` is
    of the pinhole pictures that are scored.
    """

    size: int
    cameras: int
    frames: int
    held_cameras: int
    held_frames: int
    samples: int
    truth_samples: int
    effect_step: int
    paired: bool
    depth: bool = True

    def problem(self):
        """What is wrong with it, None if nothing."""
        if self.frames < 4 or self.cameras - self.held_cameras < 4:
            return "--frames must be at least 4, and so many cameras must be left to learn from."
        if not 0 <= self.held_frames <= self.frames // 2:
            return "--held-frames must be at least 0 and at most half of --frames."
        return None


PRESETS = {
    "tiny": Preset(128, 14, 14, 3, 2, 16, truth_samples=32, effect_step=2, paired=False),
    "small": Preset(256, 24, 24, 4, 3, 32, truth_samples=64, effect_step=1, paired=False),
    "paper": Preset(512, 50, 50, 5, 5, 64, truth_samples=64, effect_step=1, paired=True),
}


class Image(NamedTuple):
    """One picture to render, and what its JSON file says of it. `time` runs from 0 to 1."""

    path: str
    blocks: dict
    samples: int
    camera: str
    split: str
    pose: np.ndarray
    time: float
    depth: str | None

    @property
    def frame(self):
        """Where Blender's clock stands."""
        return self.time * (FRAMES - 1)


def plan(preset, rig, effects, info, seed):
    """Every picture of a scene and the JSON files that list them."""
    size, focal = preset.size, rig.focal
    blocks = {
        "pinhole": {},
        "fisheye": {"lens": FISHEYE},
        "depth_of_field": {"aperture": aperture(rig)},
        "rolling_shutter": {"shutter": row_times(size, FRAMES, READOUT)},
    }
    common = {
        **{"w": size, "h": size, "fl_x": focal * size, "fl_y": focal * size},
        **{"cx": size / 2, "cy": size / 2, "camera_model": "PINHOLE"},
        **{"time_unit": "normalised", "color_space": "srgb"},
    }
    placed = cameras(rig, preset.cameras, preset.held_cameras, seed)
    images, files = [], {}
    for effect in effects:
        made = [
            picture(preset, effect, blocks[effect], index, *camera)
            for camera in placed
            for index in times(preset, effect)
            if effect == "pinhole" or preset.paired or camera[1] == "test"
        ]
        images += made
        head = {"ply_file_path": "points3d.ply", "info": info}
        if effect != "pinhole":
            head = {"effect": effect, **blocks[effect], "samples": preset.truth_samples}
        file = "transforms.json" if effect == "pinhole" else f"{effect}.json"
        files[file] = {**common, **head, "frames": [listed(image) for image in made]}
    return images, files


def times(preset, effect):
    """Indices of the frames that an effect is filmed at: all whose rows see within the clip."""
    every = range(0, preset.frames, 1 if effect == "pinhole" else preset.effect_step)
    if effect != "rolling_shutter":
        return every
    step = (FRAMES - 1) / (preset.frames - 1)
    return [i for i in every if READOUT / 2 <= i * step <= FRAMES - 1 - READOUT / 2]


def held(preset):
    """Indices of the frames that no camera learns from, evenly spread, ends excluded."""
    place = np.linspace(0, preset.frames - 1, preset.held_frames + 2)[1:-1]
    return set(np.round(place).astype(int).tolist())


def picture(preset, effect, blocks, index, camera, split, pose):
    split = "test" if index in held(preset) else split
    folder = "images" if effect == "pinhole" else effect
    scored = split == "test" or effect != "pinhole"
    measured = preset.depth and split == "test" and not blocks
    return Image(
        path=f"{folder}/{camera}/{index:04d}.{KIND['test' if scored else 'train']}",
        blocks=blocks,
        samples=preset.truth_samples if scored else preset.samples,
        camera=camera,
        split=split,
        pose=pose,
        time=index / (preset.frames - 1),
        depth=f"depth/{camera}/{index:04d}.png" if measured else None,
    )


def aperture(rig):
    return {
        **{"radius": rig.aperture_radius, "focus_distance": rig.focus_distance},
        **{"focus": "plane", "blades": 0, "rotation": 0.0, "ratio": 1.0},
    }


def listed(image):
    return {
        "file_path": image.path,
        "transform_matrix": image.pose.round(9).tolist(),
        "time": image.time,
        "camera": image.camera,
        "split": image.split,
        **({"depth_file_path": image.depth} if image.depth else {}),
    }
