"""Labels of pixels besides their colour: geometry, motion, identity."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.film import pixel_grid
from gaussray.camera.shutter import time_window
from gaussray.render.aov.trace import FlatScene, FrameCameras, LabelSettings, trace_labels
from gaussray.render.frame import join_rows
from gaussray.render.list_sizes import default_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import strip_part, strip_plan, strip_tops, whole_picture
from gaussray.scene.scene import Scene, key_count
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.traverse import Capacity


# Every label with its meaning and unit, as manifests have it: pictures (`PICTURE_LABELS`), and
# numbers of each pixel's chief ray.
LABELS = {
    "depth": "distance along the ray, scene units",
    "z": "depth along the camera's axis, scene units",
    "alpha": "coverage, 0 to 1",
    "normal": "unit vector towards the camera, world axes",
    "flow_forward": "pixels (column, row) to where the next frame sees the point",
    "flow_backward": "pixels (column, row) to where the frame before saw the point",
    "time": "middle of the pixel's exposure, the capture's unit",
    "origin": "where the chief ray starts, world axes, scene units",
    "direction": "unit vector of the chief ray, world axes",
    "confusion": "diameter of the circle of confusion, pixels",
    "blur": "way of the point on the picture during the exposure, pixels",
    "gaussian": "index of the Gaussian that adds most, -1 for none",
    "group": "0 nothing, 1 static, 2 moves but belongs to no rigid body, 3 and up: rigid bodies",
    "moving": "1 where the surface moves: `group` above 1",
    "valid": "1 where a surface is seen: the lens forms a ray and alpha is at least 1/2",
    "sharp": "the picture of an ideal pinhole in an instant",
    "global_first": "the picture of a global shutter at the earliest moment of a row",
    "global_middle": "the picture of a global shutter at the median moment of the rows",
}
# Labels that are pictures of another camera, the ground truth of a frame.
PICTURE_LABELS = ("sharp", "global_first", "global_middle")
# Labels that are whole numbers.
INTEGER_LABELS = ("group", "moving", "valid")


def check_labels(names: Sequence[str]) -> None:
    """Raise a ValueError unless all are labels, each named once."""
    for name in names:
        if name not in LABELS:
            raise ValueError(f"labels must be among {', '.join(LABELS)}, got {name!r}.")
    if len(set(names)) < len(names):
        raise ValueError(f"labels must name each label once, got {', '.join(names)}.")


class Labeller:
    """Computes labels of frames of one scene, on the first device.

    The labels of a pixel are those of its chief ray: through the centre of the pixel and of the
    aperture, in the middle of its row's exposure. Optical vignetting does not affect them. The
    scene moves by key states, also with `render.chunk_rows`.

    Args:
        scene: the scene; clips of several segments have no labels.
        options: only `keys` and `memory` have an effect; labels have one ray per pixel.
        trace: options of the tracer.
    """

    def __init__(self, scene: Scene, *, options: RenderOptions, trace: TraceOptions):
        self.scene, self.trace = jax.tree.map(jnp.asarray, scene), trace
        self.options = replace(options, samples=1, chunk_rows=0, error=0.0)
        self._flat = FlatScene(*jax.tree.flatten(self.scene))
        self._capacity: dict[tuple, Capacity] = {}

    def __call__(
        self,
        camera: Camera,
        names: Sequence[str],
        *,
        before: Camera | None = None,
        after: Camera | None = None,
    ) -> dict[str, np.ndarray]:
        """Compute the labels of one frame.

        Args:
            camera: the camera of the frame.
            names: names of `LABELS`; `PICTURE_LABELS` are ignored, because they are pictures.
            before: the camera of the previous frame, for backward flow.
            after: the camera of the next frame, for forward flow.

        Returns:
            An array [h, w] or [h, w, channels] for each name: integers for `INTEGER_LABELS`,
            otherwise float. Flow towards a missing frame is NaN everywhere.

        Raises:
            ValueError: A name is no label or is given twice.
        """
        check_labels(names)
        names = tuple(name for name in LABELS if name in names and name not in PICTURE_LABELS)
        if not names:
            return {}
        camera = _without_effects(camera)
        before, after = (one and _without_effects(one) for one in (before, after))
        film = camera.film
        # The search for the largest weight uses arrays on every device, which need more memory.
        arrays = replace(self.trace, backend="array")
        rows, trace = strip_plan(film, self.options, arrays, self.scene.count)
        strip_of = partial(self._strip, FrameCameras(camera, before, after), names, rows)
        tops = strip_tops(film.height, rows)
        pieces = [(top, strip_of(top, replace(trace, backend=self.trace.backend))) for top in tops]
        return {
            name: join_rows(film, [(top, strip_labels[name]) for top, strip_labels in pieces])
            for name in names
        }

    def _strip(
        self,
        cameras: FrameCameras,
        names: tuple[str, ...],
        rows: int,
        top: int,
        trace: TraceOptions,
    ) -> dict[str, np.ndarray]:
        """The labels of a strip of rows from `top` on."""
        camera = cameras.camera
        film = camera.film
        if rows == film.height:
            part, trace = whole_picture(film, trace)
        else:
            part, trace = strip_part(film, rows, trace, top)
        begin, end = time_window(jax.device_get(camera.shutter), (film.width, film.height))
        keys = (self.options.keys or key_count(self.scene, end - begin)) if end > begin else 1
        key = film.width, rows, keys
        if key not in self._capacity:
            stacked = jax.tree.map(lambda x: np.asarray(x)[None], part)
            self._capacity[key] = default_capacity(stacked, trace, self.scene, camera.time.dtype)
        settings = LabelSettings(trace, keys, self._capacity[key])
        pixel = np.asarray(pixel_grid(film))[top : top + rows].reshape(-1, 2)
        strip_labels, self._capacity[key] = trace_labels(
            self._flat, cameras, part, pixel, names, settings=settings
        )
        return {k: x.reshape(rows, film.width, *x.shape[1:]) for k, x in strip_labels.items()}


def _without_effects(camera: Camera) -> Camera:
    """The camera without the rim, which changes light but no geometry, and for the lens itself, of
    no single colour."""
    return replace(camera, aperture=replace(camera.aperture, rim=None), chromatic=None)
