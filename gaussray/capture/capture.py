"""What a reader of captures returns: views (pictures with their cameras) and starting points."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.points import Points
from gaussray.capture.stored_part import Window


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One picture of a capture and the camera that took it.

    Args:
        camera: film, lens, aperture, shutter, trajectory and time of the picture.
        image: the picture's file, or a frame of a video (`videos.frame_path`).
        mask: file of the mask, white where pixels count; None if all do.
        depth: file of a depth map, or None.
        camera_name: name of the physical camera. A camera that moves has one name and many poses;
            `viewpoints` tells its poses apart.
        split: `train` or `test`.
        time: time of the picture in the capture's own unit.
        effect: `pinhole`, or the effects that the picture shows (`fisheye+rolling_shutter`).
        samples: rays per pixel of a rendered picture, or None.
        color_space: of integer files, `srgb` or `linear`.
        background: how alpha is treated, one of `picture_file.BACKGROUNDS`.
        window: the part of the file that the camera's film shows; None if all of it.
        margin: columns on the left, rows at the top, columns on the right and rows at the bottom of
            the film that show nothing (`same_size`): the picture lies between them.
    """

    camera: Camera
    image: Path
    mask: Path | None
    depth: Path | None
    camera_name: str
    split: str
    time: float
    effect: str
    samples: int | None
    color_space: str
    background: str = "auto"
    window: Window | None = None
    margin: tuple[int, int, int, int] = (0, 0, 0, 0)

    @property
    def width(self) -> int:
        """Columns of pixels."""
        return self.camera.film.width

    @property
    def height(self) -> int:
        """Rows of pixels."""
        return self.camera.film.height


@dataclasses.dataclass(frozen=True, eq=False)
class Capture:
    """A capture folder, read: its views, those of each effect, and starting points.

    Args:
        folder: the capture's folder.
        views: the pinhole views, from which a scene is reconstructed.
        effects: further views by effect (`fisheye`, ...), which a reconstruction is scored on.
        points: coloured points in world space to start from, or None.
        time_range: first and last time of the pinhole views (of all views, if there are none).
        time_unit: unit of the times: `normalised` or `seconds`.
    """

    folder: Path
    views: list[View]
    effects: dict[str, list[View]]
    points: Points | None
    time_range: tuple[float, float]
    time_unit: str

    @property
    def by_effect(self) -> dict[str, list[View]]:
        """The views of each effect, those of `pinhole` first."""
        return {"pinhole": self.views, **self.effects}

    @property
    def all_views(self) -> list[View]:
        """The pinhole views, then those of all effects."""
        return [view for views in self.by_effect.values() for view in views]

    def with_views(self, change: Callable[[list[View]], list[View]]) -> "Capture":
        """The capture with other views.

        Args:
            change: makes the new views from the pinhole views, and from those of each effect. An
                effect that has none left is left out.
        """
        pinhole = change(self.views)
        effects = {name: change(views) for name, views in self.effects.items()}
        effects = {name: views for name, views in effects.items() if views}
        return dataclasses.replace(self, views=pinhole, effects=effects)


def viewpoints(views: Sequence[View]) -> list[int]:
    """Number of the fixed viewpoint of each view.

    Views share a viewpoint if camera name, lens, film and poses are equal: only then do their
    pixels show the same directions, so that a temporal median over them means something.
    """
    numbers: dict[tuple, int] = {}
    lenses: dict[int, tuple] = {}
    keys = []
    for view in views:
        lens, trajectory = view.camera.lens, view.camera.trajectory
        # Views share most of their lenses, which may hold large tables.
        if id(lens) not in lenses:
            lenses[id(lens)] = _content(lens)
        # A camera that moves during the capture is elsewhere at another time.
        time = view.time if trajectory.time.shape[0] > 1 else None
        film = view.camera.film, view.window
        keys.append((view.camera_name, film, lenses[id(lens)], _content(trajectory), time))
    return [numbers.setdefault(key, len(numbers)) for key in keys]


def _content(tree: AbstractLens | Trajectory) -> tuple:
    leaves, structure = jax.tree.flatten(tree)
    return structure, tuple(np.asarray(leaf).tobytes() for leaf in leaves)
