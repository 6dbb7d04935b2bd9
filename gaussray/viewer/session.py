"""One visitor's pictures: sketches while something changes, then the picture itself."""

import threading
import time as clock
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from gaussray.camera.camera import Camera, with_chromatic
from gaussray.render.dataset import stored
from gaussray.render.randomize.generate import Shot
from gaussray.render.renderer import Renderer
from gaussray.viewer.adaptive_size import Pacer, ladder
from gaussray.viewer.develop import developed
from gaussray.viewer.focus import focus_at, pointing
from gaussray.viewer.model import Studio
from gaussray.viewer.preview import Sketcher
from gaussray.viewer.timing import Meter, Reading
from gaussray.viewer.viewpoint import Stance
from gaussray.viewer.window import Pane, composed, panes


# Seconds without a change after which the picture is rendered, and between looks at what compiles.
REST, GLANCE = 0.35, 0.1

Codes = UInt8[np.ndarray, "h w 3"]


class Wish(NamedTuple):
    """What a visitor wants to see: the controls, where from, and the window (width over height)."""

    values: Mapping[str, Any]
    stance: Stance
    layout: str = "effect"
    split: float = 0.5
    window: float = 1.5
    dark: bool = True


class Session:
    """Makes what was wished for last; `show(sheet, whole)` puts it on the page, `tell` gets a
    reading or a text of what is wrong. Threads of its own do both."""

    def __init__(
        self,
        studio: Studio,
        sketcher: Sketcher,
        show: Callable[[Codes, bool], None],
        tell: Callable[[Reading | str], None],
    ):
        self.studio, self.sketcher, self._show, self._tell = studio, sketcher, show, tell
        self.pacer = Pacer(ladder(studio.size), 1000 / studio.options.rate)
        self._meter = Meter()
        self._news = threading.Condition()
        self._wish: Wish | None = None
        self._closed, self._showing = False, threading.Lock()
        self._said: Reading | str = ""
        self._renderers: dict[Any, Renderer] = {}
        self._fine = ThreadPoolExecutor(1, thread_name_prefix="fine")
        self.pictures: dict[str, Codes] = {}
        threading.Thread(target=self._live, name="sketch", daemon=True).start()

    def wish(self, wish: Wish) -> None:
        """Show this from now on."""
        with self._news:
            if wish == self._wish:
                return
            self._wish = wish
            self._news.notify_all()

    def close(self) -> None:
        """The visitor has left."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._fine.shutdown(wait=False, cancel_futures=True)

    def focus(self, place: tuple[float, float]) -> float | None:
        """The focus distance of what is seen at a place of the window (shares of its sides)."""
        wish = self._wish
        if wish is None:
            return None
        for pane in self._panes(wish):
            pixel = pane.pixel(place, self.studio.size)
            if pixel is not None:
                camera = self._shot(wish, pane, self.studio.size).records[0].camera
                return focus_at(self.sketcher, camera, pixel)
        return None

    def _live(self) -> None:
        done, since, rendered = None, 0.0, None
        while True:
            with self._news:
                self._news.wait_for(lambda: self._closed or self._wish is not done, GLANCE)  # noqa: B023
                if self._closed:
                    return
                wish = self._wish
            if wish is None:
                continue
            if wish is not done:
                done = wish if self._tried(self._sketch, wish) else None
                since = clock.monotonic()
                if done is None:
                    clock.sleep(GLANCE)
            elif rendered is not wish and clock.monotonic() - since > REST:
                rendered = wish
                self._fine.submit(self._tried, self._render, wish)
            else:
                self._remind()

    def _say(self, said: Reading | str) -> None:
        self._said = said
        self._tell(said)

    def _remind(self) -> None:
        """Tell again when a program is ready."""
        said = self._said
        if isinstance(said, Reading) and said.stages and said.building != self._building:
            self._say(said._replace(building=self._building))

    def _tried(self, make: Callable[[Wish], bool], wish: Wish) -> bool:
        """What `make` returns; what is wrong is told, and that is all that can be shown."""
        try:
            return make(wish)
        except ValueError as error:
            self._say(str(error))
        except Exception as error:
            self._say(f"{type(error).__name__}: {error}")
        return True

    def _sketch(self, wish: Wish) -> bool:
        """Show a picture at once; False if no program for any is ready yet."""
        if self.sketcher.failure is not None:
            error, self.sketcher.failure = self.sketcher.failure, None
            raise error
        rays = {pane: self._rays(wish, pane) for pane in self._panes(wish)}
        wanted = self.pacer.size(sum(rays.values()))
        size = self._ready(wish, rays, wanted)
        if size is None:
            self._say(Reading(wanted, sum(rays.values()), {}, 0.0, 0, False, self._building))
            return False
        self._meter.begin()
        made, hits, dropped, used = [], 0, 0, 0
        for pane in rays:
            shot = self._shot(wish, pane, size)
            count = rays[pane] if self.sketcher.has(_camera(shot), rays[pane]) else 1
            with self._meter.stage("tracing"):
                sketch = self.sketcher(_camera(shot), count)
            assert sketch is not None
            with self._meter.stage("developing"):
                made.append((pane, developed(sketch, shot)))
            hits, dropped, used = hits + sketch.hits, dropped + sketch.dropped, used + count
        self._put(wish, made, self._meter, False)
        stages, pixels = dict(self._meter.stages), size[0] * size[1]
        self.pacer.measured(size, used, sum(stages.values()))
        rate = self._meter.finish()
        reading = Reading(
            size, used, stages, hits / (pixels * used), dropped, False, self._building, rate
        )
        self._say(reading)
        return True

    def _render(self, wish: Wish) -> bool:
        """Show the picture as `gaussray render` makes it, unless something else is wished for."""
        meter, made, hits, rays = Meter(), [], 0.0, 0
        for pane in self._panes(wish):
            if self._wish is not wish:
                return False
            shot = self._shot(wish, pane, self.studio.size)
            begin = clock.monotonic()
            frame = self._renderer(shot)(_camera(shot))
            how = "compiling and tracing" if frame.compiled else "tracing"
            meter.stages[how] = meter.stages.get(how, 0) + 1000 * (clock.monotonic() - begin)
            with meter.stage("developing"):
                made.append((pane, stored(shot.records[0], frame.color, shot.sensor)))
            hits += frame.hits / (frame.color[..., 0].size * frame.samples)
            rays += frame.samples
        if self._put(wish, made, meter, True):
            told = self.studio.size, rays, meter.stages, hits / len(made), 0, True
            self._say(Reading(*told, self._building))
            self._anticipate(wish)
        return True

    def _renderer(self, shot: Shot) -> Renderer:
        """The one for a shot's settings; its lists are measured once."""
        known = shot.options, shot.trace
        if known not in self._renderers:
            how = {"options": shot.options, "trace": shot.trace}
            self._renderers[known] = Renderer(self.studio.scene, **how)
        return self._renderers[known]

    def _put(self, wish: Wish, made: list[tuple[Pane, Codes]], meter: Meter, whole: bool) -> bool:
        """Onto the page, unless it is a picture of the past."""
        with self._showing:
            if whole and self._wish is not wish:
                return False
            self.pictures = {pane.name: picture for pane, picture in made} if whole else {}
            with meter.stage("encoding"):
                self._show(composed(made, wish.window, wish.dark), whole)
        return True

    def _anticipate(self, wish: Wish) -> None:
        """Compile what is likely to be wanted next: a click for focus, an opening, an exposure."""
        wide = dict(wish.values)
        wide["aperture.radius"] = wide["aperture.radius"] or 0.01
        blurred = wish._replace(values=wide, layout="effect")
        (pane,) = self._panes(blurred)
        count = self._rays(blurred, pane)
        size = self.pacer.size(count)
        self.sketcher.prepare(_camera(self._shot(blurred, pane, size)), count)
        camera = self._shot(blurred, pane, self.studio.size).records[0].camera
        self.sketcher.prepare(pointing(camera), 1, probe=True)

    @property
    def _building(self) -> int:
        return self.sketcher.building

    def _ready(
        self, wish: Wish, rays: Mapping[Pane, int], wanted: tuple[int, int]
    ) -> tuple[int, int] | None:
        """The largest size up to the one that is wanted of which all programs are there; those of
        the wanted one are ordered. Where only unblurred pictures can be had, they will do."""
        smaller = [size for size in self.pacer.sizes if size[0] <= wanted[0]][::-1]
        for fewest in (False, True):
            for size in smaller:
                cameras = {pane: _camera(self._shot(wish, pane, size)) for pane in rays}
                counts = {pane: 1 if fewest else count for pane, count in rays.items()}
                if all(self.sketcher.has(cameras[pane], counts[pane]) for pane in rays):
                    return size
                if size == wanted and not fewest:
                    for pane, count in rays.items():
                        self.sketcher.prepare(cameras[pane], count)
        return None

    def _rays(self, wish: Wish, pane: Pane) -> int:
        """Rays a pixel of a sketch: one, where nothing blurs."""
        values = wish.values
        if pane.name == "pinhole" or not (values["aperture.radius"] or values["shutter.exposure"]):
            return 1
        return min(self.studio.options.samples, values["render.samples"])

    def _panes(self, wish: Wish) -> list[Pane]:
        width, height = self.studio.size
        return panes(wish.layout, wish.window, width / height, wish.split)

    def _shot(self, wish: Wish, pane: Pane, size: tuple[int, int]) -> Shot:
        make = self.studio.sharp_shot if pane.name == "pinhole" else self.studio.shot
        return make(wish.values, wish.stance, size)


def _camera(shot: Shot) -> Camera:
    return with_chromatic(shot.records[0].camera, shot.sensor.chromatic)
