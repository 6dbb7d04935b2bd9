"""A capture with what the fit of a scene found for its cameras, and which pictures it saw."""

import dataclasses
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.capture.capture import Capture, View
from gaussray.render.rig.fitted_cameras import FittedCameras, read_fitted_cameras
from gaussray.scene.formats.any_file import is_foreign


# Name of a camera and folder of its pictures: another capture may have cameras of equal names.
_CameraKey = tuple[str, Path]


@dataclasses.dataclass(frozen=True)
class FoundCapture:
    """A capture, and what the fit of a scene found for it.

    Args:
        capture: the capture, with the cameras as they were refined.
        responses: matrix of linear red, green and blue (row: output channel) of each camera whose
            exposure or colours the fit refined, by the camera's name and its pictures' folder.
        fitted: files of the pictures that the scene was fitted to, by the camera's name and their
            folder. Empty where that is not known: then the capture's own splits count.
    """

    capture: Capture
    responses: Mapping[_CameraKey, Float[np.ndarray, "3 3"]] = dataclasses.field(
        default_factory=dict
    )
    fitted: Mapping[_CameraKey, frozenset[Path]] = dataclasses.field(default_factory=dict)

    def response(self, view: View) -> Float[np.ndarray, "3 3"] | None:
        """The colour response of a view's camera to linear light; None if it is not known."""
        return self.responses.get(_key(view))

    def part(self, view: View) -> str:
        """What a view tests: `train` (the fit saw it), `held_out_times` (it saw the camera at other
        times) or `held_out_cameras`."""
        if self.fitted and view.effect not in self.capture.effects:
            own = self.fitted.get(_key(view))
            if own is None:
                return "held_out_cameras"
            return "train" if view.image.resolve() in own else "held_out_times"
        if view.split == "train":
            return "train"
        return "held_out_times" if view.camera_name in self._trained else "held_out_cameras"

    @cached_property
    def _trained(self) -> set[str]:
        """Cameras of the capture's training pictures."""
        return {view.camera_name for view in self.capture.views if view.split == "train"}


def with_found_cameras(truth: Capture, scene: Path) -> FoundCapture:
    """A capture with the cameras that the fit of a scene found for its pictures (fit.refine), of
    held-out ones what all cameras share; and with the colour responses that it found, and the
    pictures that it saw. Cameras are as recorded where the fit refined nothing, or saw other
    pictures or pictures of another size.

    Args:
        truth: the capture that the scene is scored on.
        scene: the folder of a reconstruction, or a scene file in it.
    """
    # What lies beside another program's model is not ours.
    known = bool(truth.views) and not is_foreign(scene)
    stored = read_fitted_cameras(scene) if known else None
    if stored is None:
        return FoundCapture(truth)
    trained = stored.training_pictures
    keys = {(name, file.parent) for name, files in trained.items() for file in files}
    fitted = {
        (name, folder): frozenset(file for file in trained[name] if file.parent == folder)
        for name, folder in keys
    }
    responses = stored.color_responses
    found = {(name, at): responses[name] for name, at in keys if name in responses}
    if not any(_key(view) in fitted for view in truth.views):
        # The scene was fitted to another capture.
        return FoundCapture(truth)
    return FoundCapture(_with_refined(truth, stored), found, fitted)


def _key(view: View) -> _CameraKey:
    return view.camera_name, view.image.resolve().parent


def _with_refined(truth: Capture, stored: FittedCameras) -> Capture:
    if not stored.refined:
        return truth
    cameras = stored.views(truth.views[0].camera.time.dtype)
    found = dict(zip(stored.pictures, cameras, strict=True))

    def changed(views: list[View]) -> list[View]:
        return [_found(view, found.get(str(view.image.resolve()))) for view in views]

    return dataclasses.replace(truth, views=changed(truth.views))


def _found(view: View, own: View | None) -> View:
    if own is None or own.camera_name != view.camera_name:
        return view
    sizes = [(film.width, film.height) for film in (own.camera.film, view.camera.film)]
    return dataclasses.replace(view, camera=own.camera) if sizes[0] == sizes[1] else view
