"""Rendering for one page: previews while something changes, then the final picture."""

import threading
import time as clock
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from gaussray.camera.camera import Camera, with_chromatic
from gaussray.render.develop import picture_levels
from gaussray.render.focus import without_aperture
from gaussray.render.job import RenderJob
from gaussray.render.renderer import Renderer
from gaussray.viewer.adaptive_size import SizeController, preview_sizes
from gaussray.viewer.develop import develop_preview
from gaussray.viewer.focus import clicked_focus_distance
from gaussray.viewer.model import ViewerModel
from gaussray.viewer.preview import PreviewRenderer
from gaussray.viewer.timing import RenderStatus, StageTimer
from gaussray.viewer.viewpoint import Viewpoint
from gaussray.viewer.window import Pane, compose_window, panes


# Seconds without a change before the final picture is rendered, and between checks for finished
# compilations.
IDLE, POLL = 0.35, 0.1

Levels = UInt8[np.ndarray, "h w 3"]


class RenderRequest(NamedTuple):
    """What to render: control values, viewpoint, layout, window aspect (width / height), and the
    size of the final picture in pixels (None: the model's)."""

    values: Mapping[str, Any]
    viewpoint: Viewpoint
    layout: str = "camera"
    split: float = 0.5
    window: float = 1.5
    dark: bool = True
    size: tuple[int, int] | None = None


class ViewerSession:
    """Renders the latest request in background threads.

    Args:
        model: the scene and its render jobs.
        previewer: renders previews; shared by all pages.
        show: called with an image (h, w, 3) of the window and whether it is final.
        report: called with a status, or with the text of an error.
    """

    def __init__(
        self,
        model: ViewerModel,
        previewer: PreviewRenderer,
        show: Callable[[Levels, bool], None],
        report: Callable[[RenderStatus | str], None],
    ):
        self.model, self.previewer, self._show, self._report = model, previewer, show, report
        self.size_controller = SizeController(preview_sizes(model.size), 1000 / model.options.rate)
        self._timer = StageTimer()
        self._changed = threading.Condition()
        self._request: RenderRequest | None = None
        self._closed, self._show_lock = False, threading.Lock()
        self._status: RenderStatus | str = ""
        self._renderers: dict[Any, Renderer] = {}
        self._final_pool = ThreadPoolExecutor(1, thread_name_prefix="final picture")
        self.pictures: dict[str, Levels] = {}
        threading.Thread(target=self._run, name="preview", daemon=True).start()

    def request(self, request: RenderRequest) -> None:
        """Render this request instead of the one before."""
        with self._changed:
            if request == self._request:
                return
            self._request = request
            self._changed.notify_all()

    def close(self) -> None:
        """End the threads."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._final_pool.shutdown(wait=False, cancel_futures=True)

    def focus(self, position: tuple[float, float]) -> float | None:
        """Focus distance of the surface at a position in the window (fractions of its sides); None
        where there is no surface."""
        request = self._request
        if request is None:
            return None
        for pane in self._panes(request):
            pixel = pane.pixel(position, self.model.size)
            if pixel is not None:
                camera = self._job(request, pane, self.model.size).records[0].camera
                return clicked_focus_distance(self.previewer, camera, pixel)
        return None

    def _run(self) -> None:
        done, since, rendered = None, 0.0, None
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._request is not done, POLL)  # noqa: B023
                if self._closed:
                    return
                request = self._request
            if request is None:
                continue
            if request is not done:
                done = request if self._attempt(self._render_preview, request) else None
                since = clock.monotonic()
                if done is None:
                    clock.sleep(POLL)
            elif rendered is not request and clock.monotonic() - since > IDLE:
                rendered = request
                self._final_pool.submit(self._attempt, self._render_final, request)
            else:
                self._update_compiling()

    def _set_status(self, status: RenderStatus | str) -> None:
        self._status = status
        self._report(status)

    def _update_compiling(self) -> None:
        """Update the status when the number of compiling programs changes."""
        status = self._status
        if not isinstance(status, RenderStatus) or not status.stages:
            return
        if status.compiling != self._compiling:
            self._set_status(status._replace(compiling=self._compiling))

    def _attempt(self, make: Callable[[RenderRequest], bool], request: RenderRequest) -> bool:
        """The result of `make`; True after an error, which becomes the status."""
        try:
            return make(request)
        except ValueError as error:
            self._set_status(str(error))
        except Exception as error:
            self._set_status(f"{type(error).__name__}: {error}")
        return True

    def _render_preview(self, request: RenderRequest) -> bool:
        """Show a preview; False if no program for one is compiled yet."""
        if self.previewer.failure is not None:
            error, self.previewer.failure = self.previewer.failure, None
            raise error
        rays = {pane: self._rays(request, pane) for pane in self._panes(request)}
        largest = self.size_controller.size(sum(rays.values()))
        size = self._ready_size(request, rays, largest)
        if size is None:
            self._set_status(
                RenderStatus(largest, sum(rays.values()), {}, 0.0, 0, False, self._compiling)
            )
            return False
        self._timer.begin()
        pictures, hits, dropped, used = [], 0, 0, 0
        for pane in rays:
            job = self._job(request, pane, size)
            count = rays[pane] if self.previewer.has(_camera(job), rays[pane]) else 1
            with self._timer.stage("tracing"):
                preview = self.previewer(_camera(job), count)
            assert preview is not None
            with self._timer.stage("developing"):
                pictures.append((pane, develop_preview(preview, job)))
            hits, dropped, used = hits + preview.hits, dropped + preview.dropped, used + count
        self._put(request, pictures, self._timer, False)
        stages, pixels = dict(self._timer.stages), size[0] * size[1]
        self.size_controller.record(size, used, sum(stages.values()))
        rate = self._timer.finish()
        status = RenderStatus(
            size, used, stages, hits / (pixels * used), dropped, False, self._compiling, rate
        )
        self._set_status(status)
        return True

    def _render_final(self, request: RenderRequest) -> bool:
        """Show the picture as `gaussray render` makes it, unless another request has arrived."""
        timer, pictures, hits, rays = StageTimer(), [], 0.0, 0
        for pane in self._panes(request):
            if self._request is not request:
                return False
            job = self._job(request, pane, request.size or self.model.size)
            begin = clock.monotonic()
            frame = self._renderer(job)(_camera(job))
            stage = "compiling and tracing" if frame.compiled else "tracing"
            timer.stages[stage] = timer.stages.get(stage, 0) + 1000 * (clock.monotonic() - begin)
            with timer.stage("developing"):
                pictures.append(
                    (pane, picture_levels(job.records[0], frame.color, job.dataset.sensor))
                )
            hits += frame.hits / (frame.color[..., 0].size * frame.samples)
            rays += frame.samples
        if self._put(request, pictures, timer, True):
            size, each = request.size or self.model.size, hits / len(pictures)
            self._set_status(RenderStatus(size, rays, timer.stages, each, 0, True, self._compiling))
            self._compile_likely_next(request)
        return True

    def _renderer(self, job: RenderJob) -> Renderer:
        """The renderer for a job's settings; kept, so that its lists are measured once."""
        key = job.options, job.trace
        if key not in self._renderers:
            self._renderers[key] = Renderer(self.model.scene, options=job.options, trace=job.trace)
        return self._renderers[key]

    def _put(
        self,
        request: RenderRequest,
        pictures: list[tuple[Pane, Levels]],
        timer: StageTimer,
        final: bool,
    ) -> bool:
        """Show pictures, unless they are final ones of an outdated request."""
        with self._show_lock:
            if final and self._request is not request:
                return False
            self.pictures = {pane.name: picture for pane, picture in pictures} if final else {}
            with timer.stage("encoding"):
                self._show(compose_window(pictures, request.window, request.dark), final)
        return True

    def _compile_likely_next(self, request: RenderRequest) -> None:
        """Compile what is likely to be needed next: a focus click, an aperture, an exposure."""
        values = dict(request.values)
        values["aperture.radius"] = values["aperture.radius"] or 0.01
        blurred = request._replace(values=values, layout="camera")
        (pane,) = self._panes(blurred)
        count = self._rays(blurred, pane)
        size = self.size_controller.size(count)
        self.previewer.prepare(_camera(self._job(blurred, pane, size)), count)
        camera = self._job(blurred, pane, self.model.size).records[0].camera
        self.previewer.prepare(without_aperture(camera), 1, probe=True)

    @property
    def _compiling(self) -> int:
        return self.previewer.compiling

    def _ready_size(
        self, request: RenderRequest, rays: Mapping[Pane, int], largest: tuple[int, int]
    ) -> tuple[int, int] | None:
        """The largest size up to `largest` whose programs are all compiled, preferably with blur;
        compilation of the programs for `largest` starts. None if there is no such size."""
        smaller = [size for size in self.size_controller.sizes if size[0] <= largest[0]][::-1]
        for fewest in (False, True):
            for size in smaller:
                cameras = {pane: _camera(self._job(request, pane, size)) for pane in rays}
                counts = {pane: 1 if fewest else count for pane, count in rays.items()}
                if all(self.previewer.has(cameras[pane], counts[pane]) for pane in rays):
                    return size
                if size == largest and not fewest:
                    for pane, count in rays.items():
                        self.previewer.prepare(cameras[pane], count)
        return None

    def _rays(self, request: RenderRequest, pane: Pane) -> int:
        """Rays per pixel of a preview: one where nothing blurs."""
        values = request.values
        if pane.name == "pinhole" or not (values["aperture.radius"] or values["shutter.exposure"]):
            return 1
        return min(self.model.options.samples, values["render.samples"])

    def _panes(self, request: RenderRequest) -> list[Pane]:
        width, height = self.model.size
        return panes(request.layout, request.window, width / height, request.split)

    def _job(self, request: RenderRequest, pane: Pane, size: tuple[int, int]) -> RenderJob:
        make = self.model.pinhole_job if pane.name == "pinhole" else self.model.job
        return make(request.values, request.viewpoint, size)


def _camera(job: RenderJob) -> Camera:
    return with_chromatic(job.records[0].camera, job.dataset.sensor.chromatic)
