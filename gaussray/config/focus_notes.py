"""Tells which depth of field was chosen, and whether its blur has enough rays."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from gaussray.camera.camera import Camera
from gaussray.camera.focus_pull import FocusPull
from gaussray.render.focus import FocusMeter
from gaussray.render.options import RenderOptions
from gaussray.render.rig.aperture import AUTO, ApertureOptions
from gaussray.runtime.output import counted


# Share of the surfaces whose blur is looked at, and the distance in pixels between the displaced
# copies of a point from which blur looks like copies.
_SHARE, _MOST_BETWEEN = 0.25, 3.0


def note_depth_of_field(
    options: ApertureOptions,
    camera: Camera,
    render: RenderOptions,
    meter: FocusMeter,
    note: Callable[[str], Any],
) -> None:
    """Say which focus and radius were chosen, and warn of blur that shows as displaced copies.

    All pixels share the points of the aperture. N rays image a point N times, spread evenly over
    its circle of confusion, of diameter c: neighbours are about c sqrt(pi / 4 N) apart.

    Args:
        options: the aperture as it was given.
        camera: camera of the first picture.
        render: rays per pixel.
        meter: measures the blur.
        note: gets the lines.
    """
    radius = float(camera.aperture.radius)
    if options.has_shares:
        numbers = chosen_lengths(vars(options), camera)
        chosen = (f"{k}={x:g} ({_source(getattr(options, k))})" for k, x in numbers.items())
        note(f"Depth of field in scene units: {', '.join(chosen)}.")
    if render.error:
        return
    blur = meter.blur(camera, _SHARE)
    needed = math.ceil(math.pi / 4 * (blur / _MOST_BETWEEN) ** 2)
    if render.samples < needed:
        note(
            f"A quarter of the first picture is blurred over {blur:.0f} pixels or more, which "
            f"{counted(render.samples, 'ray')} a pixel show as displaced copies. Raise "
            f"render.samples (about {needed} suffice), or lower aperture.radius ({radius:.3g})."
        )


def chosen_lengths(given: Mapping[str, Any], camera: Camera) -> dict[str, float]:
    """The numbers in scene units that stand for the texts of an aperture, by key.

    Args:
        given: the keys of the aperture as they were given.
        camera: a camera with that aperture.
    """
    aperture = camera.aperture
    numbers: dict[str, Any] = {"radius": aperture.radius}
    if not isinstance(aperture.focus_distance, FocusPull):
        numbers = {"focus_distance": aperture.focus_distance, "radius": aperture.radius}
    if aperture.rim is not None:
        numbers |= {"rim_radius": aperture.rim.radius, "rim_distance": aperture.rim.distance}
    # Single precision: the digits that it has.
    return {
        key: float(f"{float(number):.6g}")
        for key, number in numbers.items()
        if isinstance(given[key], str)
    }


def _source(given: str) -> str:
    return "what the middle of the first picture shows" if given == AUTO else given
