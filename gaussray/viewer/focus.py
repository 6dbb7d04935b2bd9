"""Click to focus: the focus distance that makes the clicked surface sharp."""

import numpy as np

from gaussray.camera.camera import Camera
from gaussray.render.focus import focus_distances, without_aperture
from gaussray.viewer.preview import PreviewRenderer


def clicked_focus_distance(
    previewer: PreviewRenderer, camera: Camera, pixel: tuple[int, int]
) -> float | None:
    """The focus distance of the surface in a pixel, in scene units; None without a surface.

    Args:
        previewer: traces the pixel's chief ray.
        camera: the camera; of its aperture only `focus` counts.
        pixel: column and row of the pixel.
    """
    alpha, distance = map(np.asarray, previewer.probe(without_aperture(camera), pixel))
    place = np.asarray(pixel, np.float64)
    found = focus_distances(camera, camera.aperture.focus, place, alpha, distance)
    return float(found) if np.isfinite(found) else None
