"""The cameras of a capture as the fit of a scene found them."""

import dataclasses
from pathlib import Path

from gaussray.capture.capture import Capture, View
from gaussray.render.rig.fitted_cameras import read_fitted_cameras
from gaussray.scene.formats.any_file import is_foreign


def with_found_cameras(truth: Capture, scene: Path) -> Capture:
    """A capture with the cameras that the fit of a scene found for its pictures (fit.refine), of
    held-out ones what all cameras share; as it is if the fit refined nothing, or saw other pictures
    or pictures of another size.

    Args:
        truth: the capture that the scene is scored on.
        scene: the folder of a reconstruction, or a scene file in it.
    """
    # What lies beside another program's model is not ours.
    known = bool(truth.views) and not is_foreign(scene)
    fitted = read_fitted_cameras(scene) if known else None
    if fitted is None or not fitted.refined:
        return truth
    cameras = fitted.views(truth.views[0].camera.time.dtype)
    found = dict(zip(fitted.pictures, cameras, strict=True))

    def changed(views: list[View]) -> list[View]:
        return [_found(view, found.get(str(view.image.resolve()))) for view in views]

    return dataclasses.replace(truth, views=changed(truth.views))


def _found(view: View, own: View | None) -> View:
    if own is None or own.camera_name != view.camera_name:
        return view
    sizes = [(film.width, film.height) for film in (own.camera.film, view.camera.film)]
    return dataclasses.replace(view, camera=own.camera) if sizes[0] == sizes[1] else view
