"""What is known of every pixel beside its colour: geometry, motion, blur, identity."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from gaussray.camera.camera import Camera
from gaussray.camera.chromatic import achromatic
from gaussray.camera.confusion import circle_of_confusion
from gaussray.camera.film import Film, pixel_grid
from gaussray.camera.landing import landing, place_at
from gaussray.camera.rays import Rays
from gaussray.camera.shutter import time_window
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import normalize, safe_norm
from gaussray.parts import Pace, Part, RenderOptions, strip, strips, whole_picture
from gaussray.picture import about_to_trace
from gaussray.scene.facing import normals
from gaussray.scene.material import STATIC, carried, group_of
from gaussray.scene.scene import Scene, key_count
from gaussray.tracer.dominant import dominant
from gaussray.tracer.motion import Motion
from gaussray.tracer.paint import blended, painted
from gaussray.tracer.trace import TraceOptions, enlarge, measure, trace
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
# What is of a surface, and NaN where none is seen.
_SURFACE = ("depth", "z", "normal", "flow_forward", "flow_backward", "confusion", "blur")
_OF_ONE = ("flow_forward", "flow_backward", "blur", "gaussian", "group", "moving")
_OF_RAYS = ("time", "origin", "direction", "sharp")
# A surface is seen where it covers at least so much.
COVERED = 0.5
# Pixels whose motion is worked out at once.
_PIXELS = 1 << 16


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
        count = self.scene.static.count + self.scene.moving.count
        # The one that adds most is found by the arrays everywhere, which take more memory.
        rows, trace = strips(film, self.options, replace(self.trace, backend="array"), count)
        strip_of = partial(self._strip, camera, (before, after), asked, rows)
        tops = (min(y, film.height - rows) for y in range(0, film.height, rows))
        found = [(top, strip_of(top, replace(trace, backend=self.trace.backend))) for top in tops]
        return {name: _joined(film, [(top, seen[name]) for top, seen in found]) for name in asked}

    def _strip(
        self,
        camera: Camera,
        others: tuple[Camera | None, Camera | None],
        asked: tuple[str, ...],
        rows: int,
        top: int,
        trace: TraceOptions,
    ) -> dict[str, np.ndarray]:
        """The labels of so many rows from `top` on, pixel by pixel."""
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
        if key not in self._capacity and not set(asked) <= set(_OF_RAYS):
            motion, rays = about_to_trace(self.scene, camera, part, pace=pace)
            self._capacity[key] = [
                measure(motion, rays, options=one, headroom=1.5) for one in (trace, arrays)
            ]
        pixel = pixel_grid(film)[top : top + rows].reshape(-1, 2)
        while True:
            held = self._capacity.get(key, [pace.capacity] * 2)
            sizes = held[0], held[1]
            values, reports = _labels(
                self.scene, camera, *others, part, pixel, pace=pace, sizes=sizes, asked=asked
            )
            short = [i for i, (_, dropped) in enumerate(reports) if int(dropped)]
            if not short:
                return jax.device_get(values)
            for i in short:
                needed = [int(n) for n in reports[i][0]]
                self._capacity[key][i] = enlarge(sizes[i], needed, headroom=1.5)


def _joined(film: Film, pieces: Sequence[tuple[int, np.ndarray]]) -> np.ndarray:
    """A label's picture from strips of rows, each with its first row, which may overlap."""
    first = pieces[0][1]
    whole = np.empty((film.height, film.width, *first.shape[1:]), first.dtype)
    for top, piece in pieces:
        rows = piece.reshape(-1, *whole.shape[1:])
        whole[top : top + len(rows)] = rows
    return whole


def _geometric(camera: Camera) -> Camera:
    """The camera without what only takes light or spreads colours."""
    camera = achromatic(camera)
    return replace(camera, aperture=replace(camera.aperture, rim=None))


@eqx.filter_jit
def _labels(
    scene: Scene,
    camera: Camera,
    before: Camera | None,
    after: Camera | None,
    part: Part,
    pixel: Array,
    *,
    pace: Pace,
    sizes: tuple[Capacity, Capacity],
    asked: tuple[str, ...],
) -> tuple[dict[str, Array], list[tuple[Array, Array]]]:
    """The labels asked for, pixel by pixel, and what list sizes each trace needed and dropped."""
    motion, rays = about_to_trace(scene, camera, part, pace=pace)
    rays = jax.tree.map(lambda x: x[0], rays)
    chief: Rays = jax.tree.map(lambda x: x[part.slot], rays)
    found: dict[str, Array] = {
        "time": chief.time,
        "origin": chief.origin,
        "direction": chief.direction,
    }
    reports: list[tuple[Array, Array]] = []
    if not set(asked) <= set(_OF_RAYS):
        seen, report = _surface(motion, rays, part, camera, pace.trace, sizes[0])
        found |= seen
        reports.append(report)
        if set(asked) & set(_OF_ONE):
            best = dominant(
                motion, rays, options=replace(pace.trace, backend="array"), capacity=sizes[1]
            )
            reports.append((best.needed, best.dropped))
            index = best.index[part.slot]
            found |= _identity(scene, index, seen["valid"])
        else:
            index = jnp.zeros(chief.time.shape, jnp.int32)
        tasks = _tasks(scene, camera, before, after, asked)
        pixel = pixel.astype(chief.time.dtype)
        pixels = pixel, chief, index, jnp.where(seen["valid"] > 0, seen["depth"], 1)

        def one(pixel: tuple) -> dict[str, Array]:
            return {name: task(*pixel) for name, task in tasks.items()}

        found |= jax.lax.map(one, pixels, batch_size=min(_PIXELS, pixel.shape[0]))
        hidden = seen["valid"] == 0
        for name in set(_SURFACE) & set(found):
            blank = hidden.reshape(-1, *(1,) * (found[name].ndim - 1))
            found[name] = jnp.where(blank, jnp.nan, found[name])
    return {name: found[name] for name in asked}, reports


def _surface(
    motion: Motion, rays: Rays, part: Part, camera: Camera, options: TraceOptions, size: Capacity
) -> tuple[dict[str, Array], tuple[Array, Array]]:
    """What one trace tells: coverage, mean distance and mean normal of what the rays meet."""
    eye = pose_at(camera.trajectory, camera.time).translation
    facing = painted(motion, partial(normals, eye=eye), 1.0)
    pixels, report = trace(facing, rays, options=options, capacity=size)
    pixels = jax.tree.map(lambda x: x[part.slot], pixels)
    alpha = 1 - pixels.transmittance
    found = {
        "alpha": alpha,
        "depth": pixels.depth / jnp.maximum(alpha, COVERED),
        "normal": normalize(blended(pixels, 1.0)),
        "valid": (alpha >= COVERED).astype(jnp.uint8),
    }
    return found, (report.needed, report.dropped)


def _identity(scene: Scene, index: Int[Array, " n"], valid: Array) -> dict[str, Array]:
    """Whose the pixels are; nothing's where no surface is seen."""
    there = (index >= 0) & (valid > 0)
    group = jnp.where(there, group_of(scene)[jnp.maximum(index, 0)], 0)
    return {
        "gaussian": jnp.where(there, index, -1),
        "group": group,
        "moving": (group > STATIC).astype(jnp.uint8),
    }


def _tasks(
    scene: Scene,
    camera: Camera,
    before: Camera | None,
    after: Camera | None,
    asked: tuple[str, ...],
) -> dict[str, Callable[..., Array]]:
    """What is worked out pixel by pixel: functions of (pixel, ray, index, t).

    The point of a pixel is where its `depth` says, and moves with the Gaussian that adds most: a
    mean over all Gaussians would mix the motions of what is in front and what is behind, where
    either is solid. Where nothing moves, flow is that of the depth alone, whoever adds most.
    """

    def way(ray: Rays, index: Array, t: Array) -> Callable[[Array], Array]:
        return carried(scene, index, ray.origin + t * ray.direction, ray.time)

    def flow(other: Camera | None) -> Callable[..., Array]:
        def towards(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
            if other is None:
                return jnp.full_like(pixel, jnp.nan)
            guess = other.time + (ray.time - camera.time)
            place, _, met = landing(other, way(ray, index, t), guess)
            return jnp.where(met, place - (pixel + 0.5), jnp.nan)

        return towards

    def blur(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        path, half = way(ray, index, t), camera.shutter.exposure / 2
        moments = ray.time + half * jnp.asarray([-1, 1], t.dtype)
        ends = jax.vmap(lambda time: place_at(camera, path(time), time))(moments)
        return jnp.sum(safe_norm(ends - (pixel + 0.5)[None]))

    def z(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        return t * camera.lens.direction(pixel + 0.5)[2]

    def confusion(pixel: Array, ray: Rays, index: Array, t: Array) -> Array:
        return circle_of_confusion(camera, pixel, t, ray.time)

    tasks: dict[str, Any] = {"z": z, "confusion": confusion, "blur": blur}
    tasks |= {"flow_forward": flow(after), "flow_backward": flow(before)}
    return {name: task for name, task in tasks.items() if name in asked}
