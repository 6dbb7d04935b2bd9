"""What is known of every pixel beside its colour: geometry, motion, blur, identity."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.film import pixel_grid
from gaussray.camera.shutter import time_window
from gaussray.render.aov.trace import OF_RAYS, labelled
from gaussray.render.frame import joined
from gaussray.render.options import RenderOptions
from gaussray.render.plan import Pace, strip, strips, whole_picture
from gaussray.render.program import about_to_trace
from gaussray.scene.scene import Scene, key_count
from gaussray.tracer.trace import TraceOptions, enlarge, measure
from gaussray.tracer.traverse import Capacity


# Every label, with its unit. `sharp` is a picture, the others are numbers of a pixel's chief ray.
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
    "group": "0 nothing, 1 static, 2 moving by itself, 3 and on: bodies",
    "moving": "1 where what is seen belongs to what moves",
    "valid": "1 where a surface is seen: the lens forms a ray and alpha is at least 1/2",
    "sharp": "the picture of an ideal pinhole in an instant",
}
# Those that are whole numbers.
CODES = ("group", "moving", "valid")


def check_labels(names: Sequence[str]) -> None:
    """Raise a ValueError unless all are labels, each named once."""
    for name in names:
        if name not in LABELS:
            raise ValueError(f"labels must be among {', '.join(LABELS)}, got {name!r}.")
    if len(set(names)) < len(names):
        raise ValueError(f"labels must name each label once, got {', '.join(names)}.")


class Labeller:
    """Labels of frame after frame of one scene, on the first device.

    A label is that of the pixel's chief ray: through its centre and the middle of the opening, at
    the middle of its row's exposure, whatever a rim keeps of its light. Scene and rows are those of
    the picture, by key states also where `render.chunk_rows` asks for blocks of rows.
    """

    def __init__(self, scene: Scene, *, options: RenderOptions, trace: TraceOptions):
        self.scene, self.trace = jax.tree.map(jnp.asarray, scene), trace
        self.options = replace(options, samples=1, chunk_rows=0, error=0.0)
        self._capacity: dict[tuple, list[Capacity]] = {}

    def __call__(
        self,
        camera: Camera,
        names: Sequence[str],
        *,
        before: Camera | None = None,
        after: Camera | None = None,
    ) -> dict[str, np.ndarray]:
        """The labels of these names, [h, w] or [h, w, channels]: integers for `CODES`, else float.

        `before` and `after` are the cameras of the neighbouring frames; flow towards a frame that
        is not there is NaN everywhere.
        """
        check_labels(names)
        asked = tuple(name for name in LABELS if name in names and name != "sharp")
        if not asked:
            return {}
        camera = _geometric(camera)
        before, after = (one and _geometric(one) for one in (before, after))
        film = camera.film
        # The one that adds most is found by the arrays everywhere, which take more memory.
        rows, trace = strips(
            film, self.options, replace(self.trace, backend="array"), self.scene.count
        )
        strip_of = partial(self._strip, camera, (before, after), asked, rows)
        tops = (min(y, film.height - rows) for y in range(0, film.height, rows))
        found = [(top, strip_of(top, replace(trace, backend=self.trace.backend))) for top in tops]
        return {name: joined(film, [(top, seen[name]) for top, seen in found]) for name in asked}

    def _strip(
        self,
        camera: Camera,
        others: tuple[Camera | None, Camera | None],
        asked: tuple[str, ...],
        rows: int,
        top: int,
        trace: TraceOptions,
    ) -> dict[str, np.ndarray]:
        """The labels of so many rows from `top` on."""
        film = camera.film
        if rows == film.height:
            part, trace = whole_picture(film, trace)
        else:
            part, trace = strip(film, rows, trace, top)
        begin, end = time_window(jax.device_get(camera.shutter), (film.width, film.height))
        keys = (self.options.keys or key_count(self.scene, end - begin)) if end > begin else 1
        pace = Pace(Capacity((), 0, 0), keys, self.options, trace, None)
        arrays = replace(trace, backend="array")
        key = film.width, rows, keys, jax.tree.structure(camera)
        if key not in self._capacity and not set(asked) <= set(OF_RAYS):
            motion, rays = about_to_trace(self.scene, camera, part, pace=pace)
            self._capacity[key] = [
                measure(motion, rays, options=one, headroom=1.5) for one in (trace, arrays)
            ]
        pixel = pixel_grid(film)[top : top + rows].reshape(-1, 2)
        while True:
            held = self._capacity.get(key, [pace.capacity] * 2)
            sizes = held[0], held[1]
            values, reports = labelled(
                self.scene, camera, *others, part, pixel, pace=pace, sizes=sizes, asked=asked
            )
            short = [i for i, (_, dropped) in enumerate(reports) if int(dropped)]
            if not short:
                seen = jax.device_get(values)
                return {k: x.reshape(rows, film.width, *x.shape[1:]) for k, x in seen.items()}
            for i in short:
                needed = [int(n) for n in reports[i][0]]
                self._capacity[key][i] = enlarge(sizes[i], needed, headroom=1.5)


def _geometric(camera: Camera) -> Camera:
    """The camera without the rim, which changes light but no geometry."""
    return replace(camera, aperture=replace(camera.aperture, rim=None))
