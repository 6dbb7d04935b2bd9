"""The viewer's controls: which configuration keys have sliders, with range, unit and tooltip."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from gaussray.camera.lens.registry import models_by_name
from gaussray.config.schema import choices
from gaussray.config.yaml_files import group_values
from gaussray.render.rig.aperture import ApertureOptions, resolve_aperture


# The configuration groups with controls, in the order of the panel, and their folder titles.
GROUPS = {"lens": "lens", "aperture": "aperture", "shutter": "shutter", "sensor": "sensor"}
# Choices that keep the capture's camera, which the viewer does not use.
HIDDEN_CHOICES = ("keep",)
# The choices that make an ideal pinhole camera without a sensor model.
PINHOLE = {"lens": "pinhole", "aperture": "pinhole", "shutter": "global", "sensor": "none"}
# Tooltips of the menus of kinds.
KIND_HINTS = {
    "lens": "How the lens maps directions to pixels.",
    "aperture": "A pinhole is sharp everywhere; an open aperture has depth of field.",
    "shutter": "Global: all rows at once. Rolling: row after row. Interlaced: every other row.",
    "sensor": "Vignetting, noise, quantisation and tone curve.",
}
SAMPLES = ("1", "4", "16", "64", "256")

ControlValues = dict[str, Any]


class Slider(NamedTuple):
    """A slider for the configuration `key` from `low` to `high`, with a tooltip (`hint`).

    `is_visible` decides from the current values whether the slider has an effect. Values in
    `skipped` count as `low`.
    """

    key: str
    label: str
    low: float
    high: float
    step: float
    hint: str
    is_visible: Callable[[Mapping[str, Any]], bool] = lambda values: True
    skipped: tuple[float, ...] = ()

    def value_at(self, shown: float) -> float:
        """The value of the key where the slider shows a number."""
        return self.low if shown in self.skipped else shown

    @property
    def group(self) -> str:
        return self.key.split(".")[0]


def sliders(distance: float, span: float) -> list[Slider]:
    """The sliders of the viewer.

    Args:
        distance: typical distance of the scene from the camera, scene units.
        span: duration of the scene, in the unit of its times.
    """
    near, time = _round(distance), _round(span)

    def has_aperture(values: Mapping[str, Any]) -> bool:
        return values["aperture.radius"] != 0

    def has_readout(values: Mapping[str, Any]) -> bool:
        return values["shutter.kind"] in ("rolling", "interlaced")

    def has_fields(values: Mapping[str, Any]) -> bool:
        return values["shutter.kind"] == "interlaced"

    return [
        Slider(
            "lens.fov", "field of view (°)", 5.0, 360.0, 1.0,
            "Horizontal field of view in degrees: between the picture's left and right edge, or "
            "across the image circle of a fisheye.",
        ),
        Slider(
            "aperture.radius", "radius (units)", 0.0, near / 10, near / 1000,
            "Radius of the aperture, in scene units. 0: a pinhole, everything is sharp.",
        ),
        Slider(
            "aperture.focus_distance", "focus (units)", near / 50, 5 * near, near / 200,
            "Distance at which the picture is sharp, in scene units. Click the picture to set it.",
            has_aperture,
        ),
        Slider(
            "aperture.blades", "blades", 0, 9, 1,
            "Number of aperture blades, the edges of the blur shape. Below 3: round.", has_aperture,
            skipped=(1, 2),
        ),
        Slider(
            "shutter.readout", "readout time", 0.0, time, time / 200,
            "Rolling shutter: time from the first row to the last, in the capture's unit of time.",
            has_readout,
        ),
        Slider(
            "shutter.field_time", "field delay", 0.0, time / 2, time / 200,
            "Interlacing: time between the two fields, in the capture's unit of time.", has_fields,
        ),
        Slider(
            "shutter.exposure", "exposure time", 0.0, time / 2, time / 200,
            "Exposure time of each row, in the capture's unit of time. Longer: more motion blur.",
        ),
        Slider(
            "sensor.exposure", "exposure (EV)", -5.0, 5.0, 0.1,
            "Exposure correction in stops: +1 doubles the light.",
        ),
        Slider(
            "sensor.falloff", "vignetting", 0.0, 8.0, 0.5,
            "Vignetting: light falls off with this power of the cosine of the ray's angle; 4 is "
            "the natural falloff of a flat sensor.",
        ),
    ]  # fmt: skip


def offered_choices(group: str) -> list[str]:
    """The choices of a configuration group that the viewer offers."""
    names = [name for name in choices(group) if name not in HIDDEN_CHOICES]
    if group != "lens":
        return names
    # Other lenses need a file, or have coefficients for one size of picture.
    return [name for name in names if models_by_name()[group_values(group, name)["model"]].any_size]


def choice_values(group: str, choice: str) -> ControlValues:
    """The values that a choice of a group sets, by configuration key.

    Args:
        group: a configuration group, such as `lens`.
        choice: one of its choices, such as `fisheye`.
    """
    return {f"{group}.{key}": value for key, value in group_values(group, choice).items()}


def aperture_values(choice: str, focus_distance: float) -> ControlValues:
    """The values that a choice of an aperture sets, with all lengths as numbers.

    Args:
        choice: an aperture, such as `wide`.
        focus_distance: distance in focus, in scene units, of which lengths are shares.
    """
    values = {**group_values("aperture", choice), "focus_distance": focus_distance}
    fields: Any = {key: tuple(x) if isinstance(x, list) else x for key, x in values.items()}
    options = resolve_aperture(ApertureOptions(**fields), lambda: focus_distance)
    return {f"aperture.{key}": getattr(options, key) for key in values}


def pinhole_values(values: Mapping[str, Any], fov: float) -> ControlValues:
    """The values of an ideal pinhole camera.

    Args:
        values: control values by configuration key. A pinhole lens keeps its field of view.
        fov: field of view in place of any other lens, degrees.
    """
    result = dict(values)
    for group, choice in PINHOLE.items():
        result |= choice_values(group, choice)
    result["aperture.focus_distance"] = values["aperture.focus_distance"]
    result["lens.fov"] = values["lens.fov"] if values["lens.model"] == "pinhole" else fov
    return result


def nearest_choice(group: str, values: Mapping[str, Any]) -> str:
    """The choice of the same kind (lens model, shutter kind) that differs least from the values.

    Args:
        group: a configuration group with controls (`GROUPS`).
        values: control values by configuration key; those of other groups do not count.
    """
    current = {key: value for key, value in values.items() if key.split(".")[0] == group}
    candidates = {name: choice_values(group, name) for name in offered_choices(group)}
    fits = [n for n in candidates if _kind(group, candidates[n]) == _kind(group, current)]

    def differences(name: str) -> int:
        return sum(current[key] != value for key, value in candidates[name].items())

    return min(fits or candidates, key=differences)


def _kind(group: str, values: Mapping[str, Any]) -> Any:
    """What distinguishes the choices of a group other than by numbers."""
    if group == "aperture":
        return bool(values["aperture.radius"]), bool(values["aperture.rim_radius"])
    return values.get({"lens": "lens.model", "shutter": "shutter.kind"}.get(group, ""))


def consistent_values(values: Mapping[str, Any]) -> ControlValues:
    """The values with the focus surface that fits the lens: a sphere for lenses that can exceed 180
    degrees, a plane for a pinhole."""
    model = models_by_name().get(values["lens.model"])
    flat = model is None or model.perspective
    return {**values, "aperture.focus": "plane" if flat else "sphere"}


def max_fov(values: Mapping[str, Any]) -> float:
    """The largest field of view of the chosen lens model, in degrees."""
    model = models_by_name().get(values["lens.model"])
    return 360.0 if model is None else model.widest


def flat_values(blocks: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """(key, value) pairs of the groups in a preset file."""
    for group, block in blocks.items():
        if isinstance(block, Mapping):
            yield from ((f"{group}.{name}", value) for name, value in block.items())


def _round(value: float) -> float:
    """The value rounded to two significant digits."""
    return float(f"{max(value, 1e-6):.1e}")
