"""The name of the effects that the pictures of a rig show."""

from collections.abc import Sequence

import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import Shutter
from gaussray.render.rig.aperture import ApertureOptions
from gaussray.render.rig.lens import LensOptions, label_of_lens, lens_label
from gaussray.render.rig.shutter import ShutterOptions, reads_rows_in_turn


def effect_name(
    cameras: Sequence[Camera],
    lens: LensOptions,
    aperture: ApertureOptions,
    shutter: ShutterOptions,
) -> str:
    """The names of all effects that any of the cameras shows, joined; pinhole without any.

    A part that the options set is named by them, one that they keep by the cameras' own. Cameras of
    one rig share the name, as their pictures share a manifest.

    Args:
        cameras: the cameras, before the options change them.
        lens: options of the lens.
        aperture: options of the aperture.
        shutter: options of the shutter.
    """
    if lens.model == "keep":
        lenses = {type(camera.lens): camera.lens for camera in cameras}.values()
        names = list(dict.fromkeys(label for label in map(label_of_lens, lenses) if label))
    else:
        names = [label for label in (lens_label(lens),) if label]
    if aperture.radius is None:
        apertures = {id(camera.aperture): camera.aperture for camera in cameras}.values()
        is_blurred = any(float(one.radius) > 0 for one in apertures)
    else:
        is_blurred = bool(aperture.radius)
    if is_blurred:
        names.append("depth_of_field")
    if shutter.kind == "keep":
        shutters = {id(camera.shutter): camera.shutter for camera in cameras}.values()
        shown = {name for one in shutters for name in _shutter_effects(one)}
    else:
        fields = shutter.kind == "table" and _has_two_fields(np.asarray(shutter.row_times))
        shown = {
            "rolling_shutter": reads_rows_in_turn(shutter) and not fields,
            "interlaced": shutter.kind == "interlaced" or fields,
            "motion_blur": shutter.exposure > 0,
        }
        shown = {name for name, is_shown in shown.items() if is_shown}
    names += [name for name in ("rolling_shutter", "interlaced", "motion_blur") if name in shown]
    return "+".join(names) or "pinhole"


def _shutter_effects(shutter: Shutter) -> set[str]:
    """The effects of a camera's own shutter."""
    table = np.zeros(1) if shutter.row_times is None else np.asarray(shutter.row_times)
    has_fields = _has_two_fields(table)
    in_turn = float(shutter.row_step) != 0 or np.ptp(table) > 0 and not has_fields
    shown = {
        "rolling_shutter": in_turn,
        "interlaced": has_fields,
        "motion_blur": float(shutter.exposure) > 0,
    }
    return {name for name, is_shown in shown.items() if is_shown}


def _has_two_fields(row_times: np.ndarray) -> bool:
    """Whether even rows share one time and odd rows another one."""
    even, odd = row_times[::2], row_times[1::2]
    return odd.size > 0 and bool(np.ptp(even) == np.ptp(odd) == 0 and even[0] != odd[0])
