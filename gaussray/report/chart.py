"""Line charts as SVG."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gaussray.capture.spread import spread_indices
from gaussray.report.markup import Markup, tag


# Size of the drawing and of its margins for labels, in pixels.
_WIDTH, _HEIGHT, _LEFT, _TOP, _RIGHT, _BOTTOM = 350.0, 200.0, 44.0, 10.0, 10.0, 34.0
PALETTE = 8
# Points drawn per curve, at most.
MAX_CURVE_POINTS = 600


class Curve(NamedTuple):
    """A series of points with its name in the legend; points that are not finite are left out."""

    name: str
    x: np.ndarray
    y: np.ndarray


def color(i: int) -> str:
    """CSS colour number i of curves and drawings."""
    return f"var(--c{i % PALETTE})"


def chart(
    title: str,
    curves: Sequence[Curve],
    *,
    x_label: str = "",
    log: bool = False,
    borders: Sequence[tuple[float, str]] = (),
) -> Markup:
    """A chart of the curves.

    Args:
        title: heading.
        curves: the series; one without finite points is left out.
        x_label: label of the x axis.
        log: whether the y axis is logarithmic.
        borders: (x, name) of vertical lines, such as the start of a stage.

    Returns:
        An HTML figure; empty without a curve.
    """
    drawn = [_finite(curve, log) for curve in curves]
    drawn = [curve for curve in drawn if len(curve.x)]
    if not drawn:
        return Markup("")
    x = np.concatenate([curve.x for curve in drawn])
    y = np.concatenate([curve.y for curve in drawn])
    span_x, span_y = _span(x, 0.0), _span(y, 0.06)
    parts = _axes(span_x, span_y, log, x_label)
    for place, name in borders:
        at = _place(place, span_x, _LEFT, _WIDTH - _RIGHT)
        parts.append(tag("path", d=f"M{at:.1f} {_TOP}V{_HEIGHT - _BOTTOM}", class_="border"))
        parts.append(tag("text", name, x=round(at + 4, 1), y=_TOP + 10))
    for i, curve in enumerate(drawn):
        parts.append(_line(curve, span_x, span_y, color(i)))
    description = f"{title}: {', '.join(curve.name for curve in drawn)}"
    drawing = tag(
        "svg", parts, viewBox=f"0 0 {_WIDTH:g} {_HEIGHT:g}", role="img", aria_label=description
    )
    return tag("figure", tag("h3", title), drawing, legend([c.name for c in drawn]), class_="panel")


def legend(names: Sequence[str]) -> Markup | None:
    """A legend of the colours; None for a single curve."""
    if len(names) < 2:
        return None
    keys = [tag("li", tag("i", style=f"background:{color(i)}"), n) for i, n in enumerate(names)]
    return tag("ul", keys, class_="legend")


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round numbers from low to high, in steps of 1, 2 or 5 times a power of 10.

    Args:
        low: lower end of the axis.
        high: upper end of the axis.
        most: largest number of steps between the ends; the numbers may be one more.
    """
    span = max(high - low, 1e-12)
    step = 10.0 ** np.floor(np.log10(span / most))
    step = next(step * m for m in (1, 2, 5, 10, 20) if span / (step * m) <= most)
    first = np.ceil(low / step - 1e-9)
    count = int(np.floor(high / step + 1e-9) - first) + 1
    return [float(round((first + i) * step, 12)) for i in range(count)]


def _finite(curve: Curve, log: bool) -> Curve:
    """The finite points, thinned to what is drawn, with logarithms of y if `log`."""
    x, y = np.asarray(curve.x, float), np.asarray(curve.y, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        y = np.log10(y) if log else y
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    subset = spread_indices(len(x), MAX_CURVE_POINTS)
    return Curve(curve.name, x[subset], y[subset])


def _span(values: np.ndarray, margin: float) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = (high - low) * margin or (abs(high) * 0.05 + 1e-9) * (high == low)
    return low - room, high + room


def _place(value: float, span: tuple[float, float], begin: float, end: float) -> float:
    return begin + (value - span[0]) / (span[1] - span[0]) * (end - begin)


def _axes(x: tuple[float, float], y: tuple[float, float], log: bool, label: str) -> list[Markup]:
    bottom, parts = _HEIGHT - _BOTTOM, []
    for value in _decades(*y) if log else ticks(*y):
        at = _place(value, y, bottom, _TOP)
        text = _figure(10**value) if log else _figure(value)
        parts.append(tag("path", d=f"M{_LEFT} {at:.1f}H{_WIDTH - _RIGHT}", class_="axis"))
        parts.append(tag("text", text, x=_LEFT - 6, y=round(at + 4, 1), text_anchor="end"))
    for value in ticks(*x):
        at = round(_place(value, x, _LEFT, _WIDTH - _RIGHT), 1)
        parts.append(tag("text", _figure(value), x=at, y=bottom + 15, text_anchor="middle"))
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    parts.append(tag("text", label, x=middle, y=_HEIGHT - 4, text_anchor="middle"))
    return parts


def _decades(low: float, high: float) -> list[float]:
    """Ticks of a logarithmic axis: powers of ten, and 2 and 5 times these if they are few."""
    whole = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    steps = (0.0,) if high - low > 2.5 else (0.0, np.log10(2), np.log10(5))
    values = [n + step for n in whole for step in steps if low <= n + step <= high]
    return [float(x) for x in values[:: max(1, -(-len(values) // 7))]]


def _line(curve: Curve, x: tuple[float, float], y: tuple[float, float], ink: str) -> Markup:
    points = [
        (_place(a, x, _LEFT, _WIDTH - _RIGHT), _place(b, y, _HEIGHT - _BOTTOM, _TOP))
        for a, b in zip(curve.x, curve.y, strict=True)
    ]
    label = tag("title", curve.name)
    if len(points) == 1:
        (a, b) = points[0]
        return tag("circle", label, cx=round(a, 1), cy=round(b, 1), r=3, fill=ink)
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points)
    return tag("path", label, d=path, class_="curve", stroke=ink)


def _figure(value: float) -> str:
    """A number in few characters."""
    if value and (abs(value) >= 1e5 or abs(value) < 1e-3):
        power = int(np.floor(np.log10(abs(value)) + 1e-9))
        return f"{value / 10.0**power:.3g}e{power}"
    return f"{value:.6g}"
