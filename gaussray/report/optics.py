"""Drawings of one camera: its rays, its aperture, and the exposure times of its rows."""

import dataclasses

import jax
import numpy as np
from jaxtyping import Float

from gaussray.camera.aperture import focus_distance_at, focused, thin_lens
from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.shutter import SIDEWAYS, row_count, row_moments
from gaussray.report.markup import Markup, tag
from gaussray.report.plan import edge_directions, lens_directions
from gaussray.runtime.stored_programs import KeptProgram


_WIDTH, _HEIGHT = 340.0, 210.0
# Rays of a pinhole; with an aperture, points of the picture and rays through each of them.
_FAN, _BEAMS, _SPREAD = 17, 3, 5
# Aperture samples along each of the two sample coordinates.
_GRAIN = 26


def camera_drawings(name: str, camera: Camera, unit: str) -> list[Markup]:
    """Drawings of the rays, of the aperture unless it is a pinhole, and of the shutter unless it is
    instantaneous.

    Args:
        name: what the titles begin with, such as the name of an effect.
        camera: the camera, drawn at its frame's time.
        unit: name of the capture's unit of time.
    """
    figures = [ray_drawing(f"{name}: rays", camera)]
    if float(np.max(camera.aperture.radius)) > 0:
        figures.append(aperture_drawing(f"{name}: aperture", camera))
    film = camera.film
    moments = row_moments(camera.shutter, (film.width, film.height))
    if float(camera.shutter.exposure) > 0 or np.ptp(moments) > 0:
        figures.append(shutter_drawing(f"{name}: shutter", camera, unit))
    return figures


def lens_name(lens: AbstractLens) -> str:
    """The name of a lens model as `lens.model` and manifests have it; that of the class for a lens
    that manifests cannot store."""
    try:
        block = lens.record().keys.get("lens", {})
    except NotImplementedError:
        block = {}
    return str(block.get("model", type(lens).__name__)).replace("_", " ")


def field_of_view(camera: Camera) -> tuple[float, float]:
    """Horizontal and vertical field of view in degrees, through the middle of the picture."""
    left, top, right, bottom = edge_directions(camera)
    return _between(left, right), _between(top, bottom)


def _between(one: np.ndarray, other: np.ndarray) -> float:
    """Angle from one direction through the optical axis to the other; it may exceed 180 degrees."""
    axis = np.array([0.0, 0.0, 1.0])
    return float(np.degrees(sum(np.arccos(np.clip(x @ axis, -1, 1)) for x in (one, other))))


def ray_drawing(title: str, camera: Camera) -> Markup:
    """The rays of the picture's middle row, seen from above; rays through an aperture meet at the
    focus distance.

    Args:
        title: heading of the drawing.
        camera: the camera, whose focus at its frame's time is drawn. One that is focused at
            infinity is drawn as a pinhole.
    """
    focus, radius = _focus(camera)
    blurs = radius > 0 and np.isfinite(focus)
    length = 1.7 * focus if blurs else 1.0
    columns = np.linspace(0.04, 0.96, _BEAMS if blurs else _FAN)
    lens = np.linspace(0.02, 0.98, _SPREAD) if blurs else np.array([0.5])
    origin, direction = drawn_rays(camera, columns, lens)
    begin, end = origin[..., [0, 2]], (origin + length * direction)[..., [0, 2]]
    corners = np.concatenate([begin.reshape(-1, 2), end.reshape(-1, 2), [[0, 0]]])
    on_drawing = _fit_to_drawing(corners, _HEIGHT - 30)
    parts = []
    for a, b in zip(begin.reshape(-1, 2), end.reshape(-1, 2), strict=True):
        (x, y), (u, v) = on_drawing(a), on_drawing(b)
        path = f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}"
        parts.append(tag("path", d=path, stroke="var(--c0)", stroke_width=1, opacity=0.75))
    if blurs:
        sharp = _focus_surface(camera, focus)
        path = "M" + "L".join("{:.1f} {:.1f}".format(*on_drawing(x)) for x in sharp)
        parts.append(tag("path", d=path, class_="border"))
    x, y = on_drawing(np.zeros(2))
    parts.append(tag("circle", cx=round(x, 1), cy=round(y, 1), r=3, fill="var(--c1)"))
    name = lens_name(camera.lens)
    wide, high = field_of_view(camera)
    caption = f"{name}, {wide:.4g} x {high:.4g} degrees"
    caption += f", focus at {focus:.4g}, radius {radius:.4g} scene units" if blurs else ""
    return _figure(title, parts, caption)


def aperture_drawing(title: str, camera: Camera) -> Markup:
    """Where the rays of the picture's middle and of its corner pass the aperture, seen from the
    scene.

    Args:
        title: heading of the drawing.
        camera: the camera, whose aperture has a radius above 0.
    """
    u = (np.stack(np.meshgrid(*[np.arange(_GRAIN)] * 2), -1).reshape(-1, 2) + 0.5) / _GRAIN
    film, radius = camera.film, _focus(camera)[1]
    spots = {
        "middle": ((film.width / 2, film.height / 2), 0.0),
        "corner": ((0.03 * film.width, 0.03 * film.height), 2.6 * radius),
    }
    corners = np.array([[-1.2, -1.4], [3.8, 1.4]]) * radius
    parts, on_drawing = [], _fit_to_drawing(corners, _HEIGHT - 20)
    for ink, (name, (pixel, aside)) in enumerate(spots.items()):
        places = np.asarray(pixel, np.float32), u.astype(np.float32)
        dots = np.asarray(_passed(_at_one_instant(camera), *places))[:, :2]
        dots = dots[np.isfinite(dots).all(axis=1)] * (1, -1) + (aside, 0)
        path = "".join("M{:.1f} {:.1f}h0".format(*on_drawing(x)) for x in dots)
        parts.append(tag("path", d=path, class_="dots", stroke=f"var(--c{ink})", stroke_width=2))
        x, y = on_drawing(np.array([aside, -1.25 * radius]))
        parts.append(tag("text", name, x=round(x, 1), y=round(y + 8, 1), text_anchor="middle"))
    blades = camera.aperture.blades
    caption = f"{blades} blades" if blades >= 3 else "round"
    caption += f", radius {radius:.4g} scene units"
    return _figure(title, parts, caption)


def shutter_drawing(title: str, camera: Camera, unit: str) -> Markup:
    """The exposure time of every row, or column, as a bar over time.

    Args:
        title: heading of the drawing.
        camera: the camera, whose shutter and picture size are shown.
        unit: name of the capture's unit of time.
    """
    film, exposure = camera.film, float(camera.shutter.exposure)
    moments = row_moments(camera.shutter, (film.width, film.height))
    rows = row_count(camera.shutter.direction, (film.width, film.height))
    half = exposure / 2
    low, high = float(moments.min() - half), float(moments.max() + half)
    span, top, bottom = max(high - low, 1e-9), 12.0, _HEIGHT - 34

    def x(value: float) -> float:
        return 46 + (value - low) / span * (_WIDTH - 64)

    def y(row: float) -> float:
        return top + row / max(rows, 1) * (bottom - top)

    drawn_rows = np.unique(np.linspace(0, rows - 1, min(rows, 160)).astype(int))
    tall = max((bottom - top) / len(drawn_rows), 0.8)
    wide = max(exposure / span * (_WIDTH - 64), 2)
    bars = "".join(
        f"M{x(float(moments[i] - half)):.1f} {y(float(i)):.1f}h{wide:.1f}v{tall:.2f}h{-wide:.1f}z"
        for i in drawn_rows
    )
    word = "column" if camera.shutter.direction in SIDEWAYS else "row"
    parts = [
        tag("path", d=f"M46 {top}V{bottom}H{_WIDTH - 12}", class_="axis"),
        tag("path", d=bars, fill="var(--c0)", fill_opacity=0.75),
        tag("text", f"{word} 0", x=42, y=top + 9, text_anchor="end"),
        tag("text", str(rows - 1), x=42, y=bottom, text_anchor="end"),
        tag("text", f"{low:.4g}", x=46, y=bottom + 15),
        tag("text", f"{high:.4g}", x=_WIDTH - 18, y=bottom + 15, text_anchor="end"),
    ]
    caption = (
        f"{word}s over time: readout {np.ptp(moments):.4g}, exposure {exposure:.4g} ({unit}), "
    )
    caption += "relative to the frame's timestamp"
    return _figure(title, parts, caption)


def _focus(camera: Camera) -> tuple[float, float]:
    """Focus distance and aperture radius at the frame's time."""
    distance = focus_distance_at(camera.aperture, camera.time)
    return float(distance), float(camera.aperture.radius)


def _at_one_instant(camera: Camera) -> Camera:
    return dataclasses.replace(camera, aperture=focused(camera.aperture, camera.time))


def drawn_rays(
    camera: Camera, columns: np.ndarray, lens: np.ndarray
) -> tuple[Float[np.ndarray, "rays lens 3"], Float[np.ndarray, "rays lens 3"]]:
    """Origins and directions of rays of the picture's middle row, in camera axes; those that the
    lens does not form are left out.

    Args:
        camera: the camera, at its frame's time.
        columns: places in the row, as fractions of the picture's width.
        lens: places in the aperture, as fractions of its width.
    """
    film = camera.film
    pixel = np.stack([columns * film.width, np.full_like(columns, film.height / 2)], axis=-1)
    if not float(camera.aperture.radius):
        direction = lens_directions(camera.lens, pixel)[:, None].repeat(len(lens), axis=1)
        direction = direction[np.abs(direction).max(axis=(1, 2)) > 0]
        return np.zeros_like(direction), direction
    u = np.stack([lens, np.full_like(lens, 0.5)], axis=-1)
    places = pixel.astype(np.float32), u.astype(np.float32)
    origin, direction = jax.device_get(_traced(_at_one_instant(camera), *places))
    has_ray = np.abs(direction).max(axis=(1, 2)) > 0
    return np.asarray(origin)[has_ray], np.asarray(direction)[has_ray]


def _trace(camera, pixel, u):
    def one(xy, number):
        return thin_lens(camera.aperture, camera.lens.direction(xy), number)

    return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(pixel, u)


def _pass(camera, pixel, u):
    chief = camera.lens.direction(pixel)
    return jax.vmap(lambda number: thin_lens(camera.aperture, chief, number)[0])(u)


_traced, _passed = KeptProgram(_trace, ()), KeptProgram(_pass, ())


def _focus_surface(camera: Camera, focus: float) -> Float[np.ndarray, "points 2"]:
    """The points in focus, seen from above: a line or an arc."""
    _, direction = drawn_rays(camera, np.linspace(0.02, 0.98, 41), np.array([0.5]))
    direction = direction[:, 0]
    if camera.aperture.focus == "plane":
        return (focus * direction / np.maximum(direction[:, 2:], 1e-3))[:, [0, 2]]
    return (focus * direction)[:, [0, 2]]


def _fit_to_drawing(points: np.ndarray, tall: float):
    """A map from (right, forward) in scene units to a drawing of this height with all points."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    scale = min((_WIDTH - 30) / size[0], tall / size[1])
    middle, center = (low + high) / 2, np.array([_WIDTH / 2, 10 + tall / 2])

    def on_drawing(point: np.ndarray) -> np.ndarray:
        x, y = (np.asarray(point) - middle) * scale
        return np.array([center[0] + x, center[1] - y])

    return on_drawing


def _figure(title: str, parts: list[Markup], caption: str) -> Markup:
    drawing = tag("svg", parts, viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}", role="img", aria_label=title)
    return tag("figure", tag("h3", title), drawing, tag("figcaption", caption), class_="panel")
