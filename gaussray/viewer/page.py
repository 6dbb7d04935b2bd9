"""The web page: controls, the scene under the mouse, and what a picture cost."""

import threading
import time as clock
from pathlib import Path
from typing import Any

import numpy as np
import viser  # type: ignore[import-not-found]

from gaussray.viewer import controls as table
from gaussray.viewer.model import Studio
from gaussray.viewer.overlay import Around, Mark
from gaussray.viewer.panel import build, surround
from gaussray.viewer.preset import command, folder_of, presets, read_preset, save_preset
from gaussray.viewer.preview import Sketcher
from gaussray.viewer.session import Session, Wish
from gaussray.viewer.timing import Reading, sentence
from gaussray.viewer.unit_readout import spoken
from gaussray.viewer.viewpoint import Stance, distance_of, forwards
from gaussray.viewer.window import field_of_window


# Quality of JPEG while something moves, pixels below which there is none, and seconds between two
# texts.
QUALITY, SMALL, CALM = 80, 320 * 320, 0.25


class Page:
    """The page of one visitor."""

    def __init__(
        self,
        client: viser.ClientHandle,
        studio: Studio,
        sketcher: Sketcher,
        out: Path,
        around: Around,
    ):
        self.client, self.studio, self.out = client, studio, out
        self.values, self.time = dict(studio.begin), studio.stance.time
        self.layout, self.split, self.dark = "effect", 0.5, studio.options.dark
        self._told, self._waiting = 0.0, True
        self._setter: int | None = None
        self._k = studio.configured(self.values).trace.k
        self.handles: dict[str, Any] = {}
        self.session = Session(studio, sketcher, self._show, self._tell)
        build(self)
        surround(self, around)
        client.camera.on_update(lambda _: self.refresh())
        client.scene.on_click()(self._clicked)
        self._stopped = threading.Event()
        threading.Thread(target=self._play, name="play", daemon=True).start()
        self.refresh()

    def close(self) -> None:
        """The visitor has left."""
        self._stopped.set()
        self.session.close()

    @property
    def stance(self) -> Stance:
        """Where the visitor stands."""
        camera = self.client.camera
        quat, place = (tuple(float(x) for x in v) for v in (camera.wxyz, camera.position))
        return Stance(quat, place, self.time)  # type: ignore[arg-type]

    def refresh(self) -> None:
        """Show what the controls and the mouse say now."""
        camera = self.client.camera
        if camera._state.update_timestamp == 0 or not camera.image_height:
            return
        shape = camera.image_width / camera.image_height
        self._align(shape)
        self.session.wish(
            Wish(dict(self.values), self.stance, self.layout, self.split, shape, self.dark)
        )

    def stand(self, stance: Stance) -> None:
        """Move to a stance; one looks at what is in the middle of the picture."""
        ahead = forwards(stance) * distance_of(self.studio.scene, stance)
        with self.client.atomic():
            self.client.camera.position = np.asarray(stance.place)
            self.client.camera.look_at = np.asarray(stance.place) + ahead
        self.time = stance.time
        self._set("time", stance.time)

    def _align(self, shape: float) -> None:
        """The browser's own camera sees as the picture does, if that is a pinhole's: frusta and
        points then lie where they are. They are hidden where they cannot."""
        plain = self.layout == "pinhole"
        values = table.plain(self.values, self.studio.field) if plain else self.values
        true = values["lens.model"] == "pinhole" and not any(values["lens.k"])
        true = true and self.layout != "side by side"
        width, height = self.studio.size
        if true:
            self.client.camera.fov = field_of_window(values["lens.fov"], shape, width / height)
        for name in ("cameras", "points"):
            node = self.handles.get(f"/{name}")
            if node is not None:
                early = name == "points" and self._waiting
                node.visible = true and (self.handles[name].value or early)

    def _show(self, sheet: np.ndarray, whole: bool) -> None:
        # Small pictures show the blocks of a JPEG, and are soon written without.
        plain = whole or sheet.shape[0] * sheet.shape[1] < SMALL
        self.client.scene.set_background_image(
            sheet, format="png" if plain else "jpeg", jpeg_quality=QUALITY
        )
        self.client.flush()
        if self._waiting:
            # Until there is a picture, the points are all there is to see.
            self._waiting = False
            self.handles["/points"].visible = self.handles["points"].value

    def _tell(self, said: Reading | str) -> None:
        now = clock.monotonic()
        brief = isinstance(said, Reading) and not said.whole
        if brief and now - self._told < CALM:
            return
        self._told = now
        text = sentence(said, self._k) if isinstance(said, Reading) else f"**{said}**"
        real = spoken(self.values, self.studio.physical)
        self.handles["status"].content = f"{text}  \n{real}" if real else text

    def _play(self) -> None:
        """Time goes on while the box is ticked."""
        first, last, seconds = self.studio.times
        before = clock.monotonic()
        while not self._stopped.wait(1 / (2 * self.studio.options.rate)):
            now = clock.monotonic()
            if self.handles["play"].value and last > first:
                gone = (now - before) / seconds * (last - first)
                self.time = first + (self.time - first + gone) % (last - first)
                self._set("time", self.time)
                self.refresh()
            before = now

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        """Focus on what was clicked."""
        self.handles["status"].content = "focusing ..."
        distance = self.session.focus(event.screen_pos)
        if distance is None:
            self.handles["status"].content = "nothing there to focus on"
            return
        self.values["aperture.focus_distance"] = distance
        self._set("aperture.focus_distance", distance)
        self.refresh()
        self.handles["status"].content = f"focus at {distance:.3g} scene units"
        self._told = clock.monotonic() + 1

    def _set(self, name: str, value: Any) -> None:
        """A control's position, without what moving it by hand would do."""
        handle = self.handles.get(name)
        if handle is None:
            return
        self._setter = threading.get_ident()  # callbacks of an assignment run in its thread
        try:
            if hasattr(handle, "min"):
                value = min(max(value, handle.min), handle.max)
            handle.value = value
        finally:
            self._setter = None

    def changed(self, name: str) -> None:
        if self._setter == threading.get_ident():
            return
        value = self.handles[name].value
        if name == "samples":
            self.values["render.samples"] = int(value)
        elif name not in ("cameras", "points"):
            setattr(self, name, value)
        if name == "layout":
            self.handles["split"].visible = value == "split"
        if name == "dark":
            self.client.gui.configure_theme(
                dark_mode=value, show_logo=False, show_share_button=False
            )
        self.refresh()

    def moved(self, one: table.Control) -> None:
        """A slider was moved by hand."""
        if self._setter == threading.get_ident():
            return
        kind = type(self.studio.begin[one.key])
        self.values[one.key] = kind(self.handles[one.key].value)
        self._set(one.group, table.choice_of(one.group, self.values))
        self.reveal()
        self.refresh()

    def choose(self, group: str) -> None:
        """Another lens, opening, shutter or sensor, with the numbers that are its own."""
        if self._setter == threading.get_ident():
            return
        told = table.chosen(group, self.handles[group].value)
        if group == "aperture":
            told["aperture.focus_distance"] = self.values["aperture.focus_distance"]
        self.values = table.settled({**self.values, **told})
        self._follow()
        self.refresh()

    def _follow(self) -> None:
        """Every control where the values are."""
        self.handles["lens.fov"].max = table.widest(self.values)
        for key, value in self.values.items():
            self._set(key, value)
        for group in table.GROUPS:
            self._set(group, table.choice_of(group, self.values))
        self._set("samples", str(self.values["render.samples"]))
        self.reveal()

    def reveal(self) -> None:
        """Only the sliders that say something."""
        for one in table.controls(1.0, 1.0):
            self.handles[one.key].visible = one.shown(self.values)
        self.handles["lens.fov"].max = table.widest(self.values)

    def save(self) -> None:
        try:
            folder = folder_of(self.out, self.handles["name"].value.strip())
            picture = self.session.pictures.get("effect")
            save_preset(self.studio, self.values, self.stance, folder, picture)
        except (ValueError, OSError) as error:
            self.handles["command"].content = f"**{error}**"
            return
        self.handles["preset"].options = ["-", *presets(self.out)]
        self.handles["command"].content = f"`{command(folder)}`"

    def open(self) -> None:
        name = self.handles["preset"].value
        if name == "-":
            return
        try:
            found = read_preset(self.out / name)
        except (ValueError, OSError) as error:
            self.handles["command"].content = f"**{error}**"
            return
        self.values = {**self.studio.begin, **found.values}
        self._follow()
        self.stand(found.stance)
        self.handles["command"].content = f"`{command(self.out / name)}`"
        self.refresh()

    def jump(self, mark: Mark) -> None:
        self.stand(mark.stance._replace(time=self.time))
        self.refresh()
