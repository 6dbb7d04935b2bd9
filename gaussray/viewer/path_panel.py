"""The part of the panel that records, previews and exports a camera path."""

import time as clock
from typing import Any

import numpy as np

from gaussray.viewer.camera_path import (
    path_command,
    path_trajectory,
    save_path,
    turntable,
    viewpoint_at,
)
from gaussray.viewer.preset import preset_folder, save_preset
from gaussray.viewer.viewpoint import (
    Viewpoint,
    subject_distance,
    up_direction,
    viewing_direction,
)


# Seconds of a new path.
SECONDS = 4.0
_EMPTY = "No keyframes. Move the camera, then add one."


class PathPanel:
    """Keyframes of one page, and the controls for them.

    `page` is the page (`viewer.page.Page`), `gui` the folder's interface of viser.
    """

    def __init__(self, page: Any, gui: Any):
        self.page, self.keyframes = page, list[Viewpoint]()
        self._began = 0.0
        add = gui.add_button("Add keyframe", hint="Append the current viewpoint to the path.")
        remove = gui.add_button("Remove last keyframe")
        clear = gui.add_button("Remove all keyframes")
        circle = gui.add_button(
            "Turntable", hint="One turn around what is in the middle of the picture."
        )
        self.seconds = gui.add_number(
            "duration (s)", SECONDS, min=0.1, max=3600.0, step=0.5, hint="Duration of the video."
        )
        self.playing = gui.add_checkbox(
            "preview", False, hint="Move the camera along the path, in a loop."
        )
        export = gui.add_button(
            "Export path", hint="Write the camera and its path beside the presets."
        )
        self.text = gui.add_markdown(_EMPTY)
        add.on_click(lambda _: self.add())
        remove.on_click(lambda _: self.set_keyframes(self.keyframes[:-1]))
        clear.on_click(lambda _: self.set_keyframes([]))
        circle.on_click(lambda _: self.add_turntable())
        self.playing.on_update(lambda _: self._begin())
        export.on_click(lambda _: self.export())

    @property
    def frames(self) -> int:
        """Number of frames of the video."""
        return max(round(self.seconds.value * self.page.model.fps), 2)

    def add(self) -> None:
        """Append the current viewpoint."""
        self.set_keyframes([*self.keyframes, self.page.viewpoint])

    def add_turntable(self) -> None:
        """Replace the keyframes by a turn around what is in the middle of the picture."""
        page, now = self.page, self.page.viewpoint
        distance = subject_distance(page.model.scene, now)
        target = np.asarray(now.position) + distance * viewing_direction(now)
        try:
            self.set_keyframes(turntable(now, target, up_direction(page.model.views)))
        except ValueError as error:
            self.text.content = f"**{error}**"

    def set_keyframes(self, keyframes: list[Viewpoint]) -> None:
        """Replace the keyframes."""
        self.keyframes = keyframes
        count = len(keyframes)
        self.text.content = f"{count} keyframe{'s' if count > 1 else ''}." if count else _EMPTY

    def export(self) -> None:
        """Write the path and the preset of its camera, and show the command that renders them."""
        page = self.page
        try:
            path = path_trajectory(self.keyframes, page.model.times[:2])
            folder = preset_folder(page.out, page.handles["name"].value.strip())
            save_preset(page.model, page.values, viewpoint_at(path, 0.0), folder, size=page.size)
            save_path(folder, path)
        except (ValueError, OSError) as error:
            self.text.content = f"**{error}**"
            return
        self.text.content = f"`{path_command(folder, self.frames)}`"

    def advance(self) -> None:
        """Move the page's camera along the path while the preview plays."""
        if not self.playing.value or len(self.keyframes) < 2:
            return
        path = path_trajectory(self.keyframes, self.page.model.times[:2])
        fraction = (clock.monotonic() - self._began) / self.seconds.value % 1.0
        self.page.move_to(viewpoint_at(path, fraction))
        self.page.refresh()

    def _begin(self) -> None:
        self._began = clock.monotonic()
        if self.playing.value and len(self.keyframes) < 2:
            self.text.content = "**A preview needs at least two keyframes.**"
