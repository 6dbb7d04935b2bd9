"""What can be set on the page: numbers of the configuration, with their ranges and units."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from gaussray.camera.lens.registry import models_by_name
from gaussray.config.schema import choices
from gaussray.config.yaml_files import group_values


# The groups whose every key the page holds, in its order, and what it calls their choices.
GROUPS = {"lens": "lens", "aperture": "opening", "shutter": "shutter", "sensor": "sensor"}
# Choices that leave the capture's camera as it is: the viewer has none.
HIDDEN = ("keep",)
# What shows a scene as it is.
PLAIN = {"lens": "pinhole", "aperture": "pinhole", "shutter": "global", "sensor": "none"}
SAMPLES = ("1", "4", "16", "64", "256")
Values = dict[str, Any]


class Control(NamedTuple):
    """A slider of the `key`, from `low` to `high`; `shown` tells when it says anything."""

    key: str
    label: str
    low: float
    high: float
    step: float
    hint: str
    shown: Callable[[Mapping[str, Any]], bool] = lambda values: True

    @property
    def group(self) -> str:
        return self.key.split(".")[0]


def controls(distance: float, span: float) -> list[Control]:
    """The sliders for a scene whose things are about `distance` away and move for a time `span`."""
    near, time = _round(distance), _round(span)

    def opened(values: Mapping[str, Any]) -> bool:
        return values["aperture.radius"] != 0

    def reads(values: Mapping[str, Any]) -> bool:
        return values["shutter.kind"] in ("rolling", "interlaced")

    def fields(values: Mapping[str, Any]) -> bool:
        return values["shutter.kind"] == "interlaced"

    fov = "From edge to edge (pinhole) or from rim to rim, in degrees."
    unit = "the unit of the scene"
    when = "the capture's unit of time"
    return [
        Control("lens.fov", "field [deg]", 5.0, 360.0, 1.0, fov),
        Control(
            "aperture.radius", "radius [u]", 0.0, near / 10, near / 1000,
            f"Of the opening, in {unit}. 0 is a pinhole: everything is sharp.",
        ),
        Control(
            "aperture.focus_distance", "focus [u]", near / 50, 5 * near, near / 200,
            f"Where everything is sharp, in {unit}. A click on the picture sets it.", opened,
        ),
        Control(
            "aperture.blades", "blades", 0, 9, 1,
            "Edges of the opening; below 3 it is round.", opened,
        ),
        Control(
            "shutter.readout", "readout [t]", 0.0, time, time / 200,
            f"From the first row's time to the last row's, in {when}.", reads,
        ),
        Control(
            "shutter.field_time", "fields [t]", 0.0, time / 2, time / 200,
            f"From one field to the other, in {when}.", fields,
        ),
        Control(
            "shutter.exposure", "exposed [t]", 0.0, time / 2, time / 200,
            f"How long every row sees the scene, in {when}: motion blur.",
        ),
        Control(
            "sensor.exposure", "light [EV]", -5.0, 5.0, 0.1, "Stops: light times 2 to that power.",
        ),
        Control(
            "sensor.falloff", "falloff", 0.0, 8.0, 0.5,
            "The picture's edge darkens by this power of cos(angle); 4 is a flat sensor's.",
        ),
    ]  # fmt: skip


def offered(group: str) -> list[str]:
    """The choices of a group that the page offers."""
    names = [name for name in choices(group) if name not in HIDDEN]
    if group != "lens":
        return names
    # Other lenses need a file, or have coefficients for one size of picture.
    return [name for name in names if models_by_name()[group_values(group, name)["model"]].any_size]


def chosen(group: str, choice: str) -> Values:
    """All values that a choice of a group sets."""
    return {f"{group}.{key}": value for key, value in group_values(group, choice).items()}


def plain(values: Mapping[str, Any], fov: float) -> Values:
    """The values of an ideal pinhole, with the field of the lens if that is one too."""
    told = dict(values)
    for group, choice in PLAIN.items():
        told |= chosen(group, choice)
    told["lens.fov"] = values["lens.fov"] if values["lens.model"] == "pinhole" else fov
    return told


def choice_of(group: str, values: Mapping[str, Any]) -> str:
    """The choice of the same kind that these values are most like."""
    own = {key: value for key, value in values.items() if key.split(".")[0] == group}
    told = {name: chosen(group, name) for name in offered(group)}
    fits = [name for name in told if _kind(group, told[name]) == _kind(group, own)]

    def unlike(name: str) -> int:
        return sum(own[key] != value for key, value in told[name].items())

    return min(fits or told, key=unlike)


def _kind(group: str, values: Mapping[str, Any]) -> Any:
    """What makes choices of a group different in kind, not in numbers."""
    if group == "aperture":
        return values["aperture.radius"] > 0, values["aperture.rim_radius"] > 0
    return values.get({"lens": "lens.model", "shutter": "shutter.kind"}.get(group, ""))


def settled(values: Mapping[str, Any]) -> Values:
    """The values with what follows from others: a lens that may see aside focuses on a sphere."""
    model = models_by_name().get(values["lens.model"])
    flat = model is None or model.perspective
    return {**values, "aperture.focus": "plane" if flat else "sphere"}


def widest(values: Mapping[str, Any]) -> float:
    """The largest field of the chosen lens, in degrees."""
    model = models_by_name().get(values["lens.model"])
    return 360.0 if model is None else model.widest


def flat(told: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Blocks of a YAML file as values."""
    for group, block in told.items():
        if isinstance(block, Mapping):
            yield from ((f"{group}.{name}", value) for name, value in block.items())


def _round(value: float) -> float:
    """A number of two digits near a value."""
    return float(f"{max(value, 1e-6):.1e}")
