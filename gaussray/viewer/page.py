"""The viewer's page in one browser: it connects controls, mouse and pictures."""

import threading
import time as clock
from pathlib import Path
from typing import Any

import numpy as np
import viser  # type: ignore[import-not-found]

from gaussray.viewer import controls as table
from gaussray.viewer.model import ViewerModel
from gaussray.viewer.overlay import CameraMarker, Overlay
from gaussray.viewer.panel import add_controls, add_overlay
from gaussray.viewer.path_panel import PathPanel
from gaussray.viewer.preset import (
    preset_folder,
    preset_names,
    read_preset,
    render_command,
    save_preset,
)
from gaussray.viewer.preview import PreviewRenderer
from gaussray.viewer.session import RenderRequest, ViewerSession
from gaussray.viewer.timing import RenderStatus, status_text
from gaussray.viewer.unit_readout import physical_readout
from gaussray.viewer.viewpoint import Viewpoint, subject_distance, viewing_direction
from gaussray.viewer.window import window_fov


# Quality of JPEG previews; pictures below this many pixels are sent as PNG; seconds between two
# updates of the status text.
JPEG_QUALITY, PNG_PIXELS, STATUS_INTERVAL = 80, 320 * 320, 0.25


class Page:
    """The page of one connected browser."""

    def __init__(
        self,
        client: viser.ClientHandle,
        model: ViewerModel,
        previewer: PreviewRenderer,
        out: Path,
        overlay: Overlay,
    ):
        self.client, self.model, self.out = client, model, out
        self.values, self.time = dict(model.initial_values), model.initial_viewpoint.time
        self.layout, self.split, self.dark = "camera", 0.5, model.options.dark
        self.size = model.size
        self._status_time, self._waiting = 0.0, True
        self._setter: int | None = None
        self.handles: dict[str, Any] = {}
        self.path: PathPanel
        self.session = ViewerSession(model, previewer, self._show, self._show_status)
        add_controls(self)
        add_overlay(self, overlay)
        client.camera.on_update(lambda _: self.refresh())
        client.scene.on_click()(self._clicked)
        self._stopped = threading.Event()
        threading.Thread(target=self._play, name="play", daemon=True).start()
        self.refresh()

    def close(self) -> None:
        """End this page's threads, after the browser has disconnected."""
        self._stopped.set()
        self.session.close()

    @property
    def viewpoint(self) -> Viewpoint:
        """The current viewpoint."""
        camera = self.client.camera
        quat, position = (tuple(float(x) for x in v) for v in (camera.wxyz, camera.position))
        return Viewpoint(quat, position, self.time)  # type: ignore[arg-type]

    def refresh(self) -> None:
        """Request a picture for the current controls and viewpoint."""
        camera = self.client.camera
        if camera._state.update_timestamp == 0 or not camera.image_height:
            return
        shape = camera.image_width / camera.image_height
        self._align(shape)
        values, layout = dict(self.values), self.layout
        self.session.request(
            RenderRequest(values, self.viewpoint, layout, self.split, shape, self.dark, self.size)
        )

    def move_to(self, viewpoint: Viewpoint) -> None:
        """Move the camera to a viewpoint; it orbits around the middle of the picture."""
        ahead = viewing_direction(viewpoint) * subject_distance(self.model.scene, viewpoint)
        with self.client.atomic():
            self.client.camera.position = np.asarray(viewpoint.position)
            self.client.camera.look_at = np.asarray(viewpoint.position) + ahead
        self.time = viewpoint.time
        self._set("time", viewpoint.time)

    def _align(self, shape: float) -> None:
        """Give the browser's camera the picture's field of view, so that camera frusta and points
        fit the picture. They are hidden unless the picture is a single pinhole picture."""
        plain = self.layout == "pinhole"
        values = table.pinhole_values(self.values, self.model.fov) if plain else self.values
        matches = values["lens.model"] == "pinhole" and not any(values["lens.k"])
        matches = matches and self.layout != "side by side"
        width, height = self.model.size
        if matches:
            self.client.camera.fov = window_fov(values["lens.fov"], shape, width / height)
        for name in ("cameras", "points"):
            node = self.handles.get(f"/{name}")
            if node is not None:
                early = name == "points" and self._waiting
                node.visible = matches and (self.handles[name].value or early)

    def _show(self, sheet: np.ndarray, final: bool) -> None:
        # JPEG blocks would show in small pictures, and PNG encodes those fast.
        lossless = final or sheet.shape[0] * sheet.shape[1] < PNG_PIXELS
        self.client.scene.set_background_image(
            sheet, format="png" if lossless else "jpeg", jpeg_quality=JPEG_QUALITY
        )
        self.client.flush()
        if self._waiting:
            # The points were visible until the first picture.
            self._waiting = False
            self.handles["/points"].visible = self.handles["points"].value

    def _show_status(self, status: RenderStatus | str) -> None:
        now = clock.monotonic()
        preview = isinstance(status, RenderStatus) and not status.final
        if preview and now - self._status_time < STATUS_INTERVAL:
            return
        self._status_time = now
        text = status_text(status) if isinstance(status, RenderStatus) else f"**{status}**"
        camera = physical_readout(self.values, self.model.physical)
        self.handles["status"].content = f"{text}  \n{camera}" if camera else text

    def _play(self) -> None:
        """Advance time while the box is ticked."""
        first, last, seconds = self.model.times
        before = clock.monotonic()
        while not self._stopped.wait(1 / (2 * self.model.options.rate)):
            now = clock.monotonic()
            if self.handles["play"].value and last > first:
                elapsed = (now - before) / seconds * (last - first)
                self.time = first + (self.time - first + elapsed) % (last - first)
                self._set("time", self.time)
                self.refresh()
            before = now
            self.path.advance()

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        """Focus on the clicked surface."""
        self.handles["status"].content = "Focusing ..."
        distance = self.session.focus(event.screen_pos)
        if distance is None:
            self.handles["status"].content = "No surface there to focus on."
            return
        self.values["aperture.focus_distance"] = distance
        self._set("aperture.focus_distance", distance)
        self.refresh()
        self.handles["status"].content = f"Focus distance {distance:.3g} scene units."
        self._status_time = clock.monotonic() + 1

    def _set(self, name: str, value: Any) -> None:
        """Set a control without running its callback."""
        handle = self.handles.get(name)
        if handle is None:
            return
        self._setter = threading.get_ident()  # an assignment runs its callbacks in this thread
        try:
            if hasattr(handle, "min"):
                value = min(max(value, handle.min), handle.max)
            handle.value = value
        finally:
            self._setter = None

    def changed(self, name: str) -> None:
        """Callback of the controls for time, layout, rays per pixel and overlays."""
        if self._setter == threading.get_ident():
            return
        value = self.handles[name].value
        if name == "samples":
            self.values["render.samples"] = int(value)
        elif name == "size":
            self.size = self.model.sizes[list(self.handles["size"].options).index(value)]
        elif name not in ("cameras", "points"):
            setattr(self, name, value)
        if name == "layout":
            self.handles["split"].visible = value == "split"
        if name == "dark":
            self.client.gui.configure_theme(
                dark_mode=value, show_logo=False, show_share_button=False
            )
        self.refresh()

    def moved(self, one: table.Slider) -> None:
        """Callback of a camera slider."""
        if self._setter == threading.get_ident():
            return
        kind = type(self.model.initial_values[one.key])
        self.values[one.key] = kind(one.value_at(self.handles[one.key].value))
        self._set(one.group, table.nearest_choice(one.group, self.values))
        self.update_visibility()
        self.refresh()

    def choose(self, group: str) -> None:
        """Callback of the choice of a lens, aperture, shutter or sensor; sets its values."""
        if self._setter == threading.get_ident():
            return
        choice = self.handles[group].value
        if group == "aperture":
            values = table.aperture_values(choice, self.values["aperture.focus_distance"])
        else:
            values = table.choice_values(group, choice)
        self.values = table.consistent_values({**self.values, **values})
        self._update_controls()
        self.refresh()

    def _update_controls(self) -> None:
        """Set every control to the current values."""
        self.handles["lens.fov"].max = table.max_fov(self.values)
        for key, value in self.values.items():
            self._set(key, value)
        for group in table.GROUPS:
            self._set(group, table.nearest_choice(group, self.values))
        self._set("samples", str(self.values["render.samples"]))
        self.update_visibility()

    def update_visibility(self) -> None:
        """Show only the sliders that have an effect."""
        for one in table.sliders(1.0, 1.0):
            self.handles[one.key].visible = one.is_visible(self.values)
        self.handles["lens.fov"].max = table.max_fov(self.values)

    def save(self) -> None:
        """Callback of the button that saves a preset."""
        try:
            folder = preset_folder(self.out, self.handles["name"].value.strip())
            picture = self.session.pictures.get("camera")
            save_preset(self.model, self.values, self.viewpoint, folder, picture, self.size)
        except (ValueError, OSError) as error:
            self.handles["command"].content = f"**{error}**"
            return
        self.handles["preset"].options = ["-", *preset_names(self.out)]
        self.handles["command"].content = f"`{render_command(folder)}`"

    def open(self) -> None:
        """Callback of the menu that opens a preset."""
        name = self.handles["preset"].value
        if name == "-":
            return
        try:
            preset = read_preset(self.out / name)
        except (ValueError, OSError) as error:
            self.handles["command"].content = f"**{error}**"
            return
        self.values = {**self.model.initial_values, **preset.values}
        self._update_controls()
        self.move_to(preset.viewpoint)
        self.handles["command"].content = f"`{render_command(self.out / name)}`"
        self.refresh()

    def jump_to_camera(self, marker: CameraMarker) -> None:
        """Callback of a click on a camera: move there, at the current time."""
        self.move_to(marker.viewpoint._replace(time=self.time))
        self.refresh()
