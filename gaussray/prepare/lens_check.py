"""Whether a lens is one that exists: field of view, principal point, distortion."""

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from gaussray.camera.lens import check_lens
from gaussray.camera.lens.registry import models_by_camera_model
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import LARGEST_DARK_SHARE, unusual_pixels
from gaussray.prepare.lens_models import LensKeyValues, fisheye_angles, lens_fov
from gaussray.prepare.sparse_model import camera_of, pixel_rays


# Focal lengths in widths of the picture outside of which no lens is believed: 136 degrees, and 7.
FOCAL = (0.2, 8.0)
# Shift of the corner by distortion, as a share of its distance from the centre: of phones and
# cameras it is a few hundredths; wide action cameras reach a third.
UNUSUAL, IMPOSSIBLE = 0.35, 0.7
# Shift of the principal point from the middle, as a share of the width.
CENTRE = 0.1
# Share of the picture that may have no viewing direction with a lens that was estimated: there a
# larger one shows an estimate that went wrong, not a lens that was calibrated in the middle alone.
ESTIMATED_DARK_SHARE = 0.25


def corner_distortion(lens: LensKeyValues) -> float:
    """Shift of the picture's corner by distortion, as a share of its undistorted distance from the
    centre; NaN if the lens has no ray there. Fisheye lenses count against r = f theta."""
    focal, centre = np.array([lens["fl_x"], lens["fl_y"]]), np.array([lens["cx"], lens["cy"]])
    corner = np.array([[0.5, 0.5]])
    stored = float(np.linalg.norm((corner[0] - centre) / focal))
    if "FISHEYE" in lens["camera_model"]:
        ideal = float(fisheye_angles(lens, np.array([stored]))[0])
    else:
        ray = np.array(camera_of(lens).cam_ray_from_img(corner), np.float64).reshape(3)
        ideal = float(np.linalg.norm(ray[:2]) / ray[2]) if ray[2] > 0 else float("nan")
    return stored / ideal - 1 if ideal > 0 else float("nan")


def is_unreadable(lens: LensKeyValues) -> bool:
    """Whether distortion turns back so far within the picture that no reader takes the lens."""
    return "FISHEYE" not in lens["camera_model"] and _dark_share(lens) > LARGEST_DARK_SHARE


def lens_complaint(lens: LensKeyValues) -> tuple[str, str]:
    """What is wrong with a lens: a level (`refuse`, `warn` or empty) and the reason.

    A pinhole without directions for the corners is no more than a warning, because readers of
    captures leave these pixels out. Levels are those of lenses that were estimated; of a known one
    readers take what is not `is_unreadable`.
    """
    fisheye = "FISHEYE" in lens["camera_model"]
    share = lens["fl_x"] / lens["w"]
    least = FOCAL[0] / 2 if fisheye else FOCAL[0]
    if not least <= share <= FOCAL[1]:
        return "refuse", (
            f"a focal length of {lens['fl_x']:.4g} pixels for a picture {lens['w']} wide "
            f"({lens_fov(lens):.3g} degrees), which hardly any lens has"
        )
    if unusual := unusual_pixels(lens["fl_x"], lens["fl_y"]):
        return "refuse", unusual
    bend = corner_distortion(lens)
    if np.isnan(bend) or not fisheye and _dark(lens, np.array([0.0, 1.0])).any():
        return _turning_back(lens)
    if abs(bend) > IMPOSSIBLE:
        return "refuse", f"distortion that shifts the corner by {100 * bend:.0f} %"
    shift = max(abs(lens["cx"] / lens["w"] - 0.5), abs(lens["cy"] / lens["h"] - 0.5))
    if shift > CENTRE:
        return "warn", f"a principal point {100 * shift:.0f} % of the picture off the middle"
    if abs(bend) > UNUSUAL:
        return "warn", f"distortion that shifts the corner by {100 * bend:.0f} %"
    return "", ""


def _turning_back(lens: LensKeyValues) -> tuple[str, str]:
    """The complaint about a lens that has no ray for a corner."""
    percent = 100 * _dark_share(lens)
    if "FISHEYE" in lens["camera_model"] or percent > 100 * ESTIMATED_DARK_SHARE:
        return "refuse", (
            "distortion that turns back within the picture, of which about "
            f"{percent:.0f} % get no viewing direction"
        )
    return "warn", (
        "distortion that turns back before the corners of the picture, of which about "
        f"{max(round(percent), 1)} % get no viewing direction and do not count"
    )


def _dark_share(lens: LensKeyValues) -> float:
    """Share of the picture that has no viewing direction, as the readers of captures find it; of a
    fisheye that of the middles of 32 x 32 fields."""
    if "FISHEYE" in lens["camera_model"]:
        return float(_dark(lens, (np.arange(32) + 0.5) / 32).mean())
    keys = Keys(Path("transforms.json"), dict(lens))
    block = Keys(keys.file, {}, keys.frame, "lens.")
    try:
        model = models_by_camera_model()[lens["camera_model"]].from_keys(keys, block, np.float32)
        return check_lens(model, lens["w"], lens["h"], dark=1.0)
    except ValueError:
        # Two pixels share a direction, which readers refuse.
        return 1.0


def _dark(lens: LensKeyValues, share: Float[np.ndarray, " shares"]) -> Bool[np.ndarray, " pixels"]:
    """Which pixels have no viewing direction, at shares of the width and of the height."""
    columns, rows = (np.clip(lens[key] * share, 0.5, lens[key] - 0.5) for key in ("w", "h"))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return np.any(np.isnan(pixel_rays(lens, pixels)), axis=1)
