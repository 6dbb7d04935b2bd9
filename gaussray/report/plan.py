"""Drawings of cameras and Gaussians from above and from the side."""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.capture.capture import View
from gaussray.color import srgb_encode
from gaussray.dataset.manifest import rotation_and_position
from gaussray.report.chart import color
from gaussray.report.markup import Markup, escape, tag
from gaussray.runtime.program_cache import quick_compilation
from gaussray.runtime.stored_programs import KeptProgram
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip, segments_of


_WIDTH, _HEIGHT, _EDGE = 480.0, 340.0, 16.0
# Pixels whose directions one call of a program finds.
_BLOCK = 32
# Gaussians drawn per drawing, at most.
DOTS = 2500
# Frusta drawn of one moving camera, and of all cameras, at most.
FRUSTA_PER_CAMERA, MAX_FRUSTA = 6, 120


def camera_views(
    views: Sequence[View], scene: Scene | Clip | None, names: dict[str, str]
) -> list[Markup]:
    """The views' cameras over the scene's Gaussians, from above and from the side.

    Args:
        views: pictures with their cameras; those of a split that is not in `names` are left out.
        scene: the scene whose Gaussians are drawn as dots, at rest (of a segmented scene, those of
            the first segment); None draws cameras only.
        names: name of each split in the legend, in the order of the colours.
    """
    selected = [view for view in views if view.split in names]
    if not selected:
        return []
    poses = [_pose(view.camera) for view in selected]
    eye = np.array([place for place, _ in poses])
    turn = np.array([axes for _, axes in poses])
    right, up, toward = drawing_axes(turn)
    points, tone = _dots(scene)
    drawings = []
    for title, across, upward in (
        ("from above", right, toward),
        ("from the side", right, up),
    ):
        onto = np.stack([across, -upward])
        drawings.append(_drawing(title, onto, selected, eye, turn, points, tone, list(names)))
    keys = [
        tag("li", tag("i", style=f"background:{color(i)}"), name)
        for i, name in enumerate(names.values())
        if list(names)[i] in {view.split for view in selected}
    ]
    return [tag("div", drawings, class_="grid"), tag("ul", keys, class_="legend")]


def _pose(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Position and axes (columns right, down, forward) at the frame's time."""
    turn, position = rotation_and_position(camera)
    return np.asarray(position, float), np.asarray(turn, float)


def drawing_axes(turn: Float[np.ndarray, "views 3 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, up and forward axes of the drawing; up is the mean up direction of the cameras."""
    up = -turn[:, :, 1].mean(axis=0)
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-3 else np.array([0.0, 0.0, 1.0])
    forward = turn[:, :, 2].mean(axis=0)
    forward = forward - up * (forward @ up)
    if np.linalg.norm(forward) < 1e-3:
        # The cameras look in all directions.
        forward = np.cross(np.eye(3)[np.argmin(np.abs(up))], up)
    forward = forward / np.linalg.norm(forward)
    return np.cross(forward, up), up, forward


def _dots(scene: Scene | Clip | None) -> tuple[np.ndarray, np.ndarray]:
    """Centres and linear colours of a random subset of the Gaussians."""
    if scene is None:
        return np.zeros((0, 3)), np.zeros((0, 3))
    parts = [part for one in segments_of(scene)[:1] for part in (one.static, one.moving)]
    mean = np.concatenate([np.asarray(part.mean, float) for part in parts])
    light = np.concatenate([np.asarray(part.harmonics[:, 0]) * C0 + 0.5 for part in parts])
    subset = np.random.default_rng(0).permutation(len(mean))[:DOTS]
    return mean[subset], np.clip(light[subset], 0, 1)


def _bounds(eye: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle around the projected cameras and nearly all points."""
    low, high = eye.min(axis=0), eye.max(axis=0)
    if len(points):
        inner = np.quantile(points, (0.02, 0.98), axis=0)
        low, high = np.minimum(low, inner[0]), np.maximum(high, inner[1])
    room = 0.06 * max(float((high - low).max()), 1e-6)
    return low - room, high + room


def _drawing(
    title: str,
    onto: Float[np.ndarray, "2 3"],
    views: Sequence[View],
    eye: np.ndarray,
    turn: np.ndarray,
    points: np.ndarray,
    tone: np.ndarray,
    splits: list[str],
) -> Markup:
    low, high = _bounds(eye @ onto.T, points @ onto.T)
    scale = min(
        (_WIDTH - 2 * _EDGE) / (high[0] - low[0]), (_HEIGHT - 2 * _EDGE) / (high[1] - low[1])
    )
    middle = np.array([_WIDTH, _HEIGHT]) / 2

    def on_drawing(x: np.ndarray) -> np.ndarray:
        return (np.asarray(x) @ onto.T - (low + high) / 2) * scale + middle

    length = 34.0 / scale
    parts: list[Any] = _cloud(on_drawing(points), tone)
    for ink, split in enumerate(splits):
        indices = [i for i, view in enumerate(views) if view.split == split]
        names = dict.fromkeys(views[i].camera_name for i in indices)
        each = max(1, min(FRUSTA_PER_CAMERA, MAX_FRUSTA // max(len(names), 1)))
        for name in list(names)[:MAX_FRUSTA]:
            own = [i for i in indices if views[i].camera_name == name]
            parts += _camera_path(name, on_drawing(eye[own]), color(ink))
            count = each if np.ptp(eye[own], axis=0).max() * scale > 2 else 1
            for i in {own[k] for k in np.linspace(0, len(own) - 1, count).astype(int)}:
                rim = edge_directions(views[i].camera)
                frustum = on_drawing(eye[i] + length * rim @ turn[i].T)
                parts.append(_frustum(name, on_drawing(eye[i]), frustum, color(ink)))
    parts += _scale_bar(scale)
    drawing = tag("svg", parts, viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}", role="img", aria_label=title)
    return tag("figure", tag("h3", title), drawing, class_="panel")


def edge_directions(camera: Camera) -> Float[np.ndarray, "4 3"]:
    """Unit directions in camera axes through the middles of the picture's left, top, right and
    bottom edge. Where the lens forms no ray there, the nearest point towards the middle counts."""
    film, directions = camera.film, []
    middle = np.array([film.width, film.height]) / 2
    for side in ((-1, 0), (0, -1), (1, 0), (0, 1)):
        share = np.linspace(1, 0, 21)[:, None]
        direction = lens_directions(camera.lens, middle + share * middle * np.array(side))
        has_ray = np.any(direction != 0, axis=-1) & np.isfinite(direction).all(axis=-1)
        direction = direction[np.argmax(has_ray)] if has_ray.any() else np.array([0, 0, 1.0])
        directions.append(direction / np.linalg.norm(direction))
    return np.array(directions)


def lens_directions(
    lens: AbstractLens, pixel: Float[np.ndarray, "pixels 2"]
) -> Float[np.ndarray, "pixels 3"]:
    """Unit directions of points of the picture, on the host; zero where the lens forms no ray.

    Args:
        lens: the lens; directions are in its camera's axes (right, down, forward).
        pixel: points (x, y) of the picture in pixels; the centre of the first pixel is (.5, .5).
    """
    count = len(pixel)
    # In whole blocks, so that one program serves all drawings.
    padded = np.pad(pixel.astype(np.float32), ((0, -count % _BLOCK), (0, 0)), mode="edge")
    return np.asarray(_directions()(lens, padded))[:count]


@functools.cache
def _directions() -> KeptProgram:
    return KeptProgram(_directions_of, (), quick_compilation())


def _directions_of(lens, pixel):
    return jax.vmap(lens.direction)(pixel)


def _cloud(position: np.ndarray, tone: np.ndarray) -> list[Markup]:
    """The Gaussians as dots, one SVG path per colour."""
    if not len(position):
        return []
    inside = (position > 0).all(axis=1) & (position < (_WIDTH, _HEIGHT)).all(axis=1)
    position, tone = position[inside], srgb_encode(tone[inside])
    code = (np.round(tone * 5) * 51).astype(int)
    parts = []
    for level in np.unique(code, axis=0):
        dots = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in position[(code == level).all(axis=1)])
        ink = f"rgb({level[0]},{level[1]},{level[2]})"
        parts.append(tag("path", d=dots, class_="dots", stroke=ink, stroke_width=2.2))
    return parts


def _camera_path(name: str, position: np.ndarray, ink: str) -> list[Markup]:
    """The path of a moving camera."""
    if len(position) < 2 or np.ptp(position, axis=0).max() < 2:
        return []
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in position)
    return [tag("path", tag("title", name), d=path, class_="curve", stroke=ink, opacity=0.6)]


def _frustum(name: str, eye: np.ndarray, rim: np.ndarray, ink: str) -> Markup:
    """A camera as its centre and rays through the edges of its picture."""
    x, y = eye
    rays = "".join(f"M{x:.1f} {y:.1f}L{a:.1f} {b:.1f}" for a, b in rim)
    around = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in rim) + "Z"
    return tag(
        "g",
        tag("title", name),
        tag("path", d=around, fill=ink, fill_opacity=0.16, stroke=ink, stroke_width=1),
        tag("path", d=rays, stroke=ink, stroke_width=1, fill="none"),
        tag("circle", cx=round(float(x), 1), cy=round(float(y), 1), r=2.6, fill=ink),
    )


def _scale_bar(scale: float) -> list[Markup]:
    """A scale bar of 1, 2 or 5 times a power of ten scene units."""
    wanted = 90 / scale
    power = 10.0 ** np.floor(np.log10(wanted))
    length = float(next(power * m for m in (5, 2, 1) if power * m <= wanted))
    end, y = _WIDTH - _EDGE, _HEIGHT - 8
    return [
        tag("path", d=f"M{end - length * scale:.1f} {y}H{end}", stroke="var(--soft)",
            stroke_width=2),
        tag("text", f"{escape(length)} scene units", x=end, y=y - 6, text_anchor="end"),
    ]  # fmt: skip
