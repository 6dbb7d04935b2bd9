"""Frames that stay on the device: what a picture costs without its way to a file."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import exact
from benchmarks.record import backend, on_cuda, timed
from gaussray.camera.camera import Camera
from gaussray.render import Renderer, RenderOptions
from gaussray.render.frame_batch import TracedPart
from gaussray.render.renderer import Frame
from gaussray.scene.scene import Scene
from gaussray.tracer.measure import enlarged_capacity
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.traverse import Capacity


class Bench(Renderer):
    """A renderer that guesses its list sizes from an earlier one's, where that saves a compilation.

    The kernel's only size is the length of the longest list, which every report tells: the guess is
    put right after the first frame.
    """

    guess: Capacity | None = None

    def launch(self, camera: Camera) -> list[TracedPart]:
        """A frame's parts, under way on the device; whether lists were long enough is not asked."""
        return self._begin(list(self._views.views([camera])), split_frame=True).parts

    def settled(self, camera: Camera) -> Frame:
        """A whole frame, after which lists have the sizes that it needs."""
        frame = self(camera)
        if on_cuda(self.trace.backend):
            parts = self.launch(camera)
            needed = np.max([np.asarray(part.report.needed).reshape(-1) for part in parts], axis=0)
            none = Capacity((1,) * (len(needed) - 2), 1, 1)
            (size,) = self._capacity
            right = enlarged_capacity(none, [int(n) for n in needed], headroom=1.5)
            if right.slots != self._capacity[size].slots:
                self._capacity[size] = right
                frame = self(camera)
            Bench.guess = self._capacity[size]
        return frame

    def _measure(self, batch, part, trace) -> Capacity:
        levels = trace.levels + 1
        if on_cuda(trace.backend) and Bench.guess is not None:
            return Capacity((1,) * levels, 1, Bench.guess.slots)
        return super()._measure(batch, part, trace)


class Shot(NamedTuple):
    """A picture to be measured; `truth` gives numbers of pixels and their exact colours."""

    scene: Scene
    camera: Camera
    options: RenderOptions
    trace: TraceOptions
    truth: Callable[[], tuple[np.ndarray, np.ndarray]]


def filmed(
    shots: Sequence[Shot], *, jobs: int = 1
) -> Iterator[tuple[dict[str, Any], tuple[np.ndarray, np.ndarray]]]:
    """Figures of the frames of every shot, and the pixels and colours they were judged by.

    Every frame makes its rays, the scene at their times (deformation, grid) and the trace, and is
    left on the device; whether anything was dropped is asked at the end. With several `jobs` so
    many programs are compiled at once, before anything is timed; how long one takes is not known
    then.
    """

    def ready(shot: Shot) -> tuple[Bench, Frame, tuple[np.ndarray, np.ndarray]]:
        renderer = Bench(shot.scene, options=shot.options, trace=shot.trace)
        return renderer, renderer.settled(shot.camera), shot.truth()

    if jobs == 1:
        for shot in shots:
            renderer, frame, truth = ready(shot)
            yield _figures(shot, renderer, frame, truth), _judged(frame, truth)
        return
    with ThreadPoolExecutor(jobs) as pool:
        # The first one finds sizes that the others guess by.
        prepared = [ready(shots[0]), *pool.map(ready, shots[1:])]
    for shot, (renderer, frame, truth) in zip(shots, prepared, strict=True):
        figures = _figures(shot, renderer, frame, truth)
        yield figures | {"compile_s": None}, _judged(frame, truth)


def _judged(frame: Frame, truth: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    return truth[0], frame.color.reshape(-1, 3)[truth[0]]


def _figures(shot: Shot, renderer: Bench, frame: Frame, truth) -> dict[str, Any]:
    film, samples, camera = shot.camera.film, shot.options.samples, jax.device_get(shot.camera)
    figures = timed(renderer.launch, camera)
    lost = [int(np.sum(part.report.dropped)) for part in renderer.launch(camera)]
    rays = film.width * film.height * samples
    return {
        "gaussians": shot.scene.count,
        "rays": rays,
        "samples": samples,
        "k": shot.trace.k,
        "backend": backend(shot.trace.backend),
        "direction": "forward",
        **figures,
        "compile_s": round(frame.seconds - figures["latency_s"], 3),
        **exact.errors(_judged(frame, truth)[1], truth[1]),
        "hits_per_ray": frame.hits / rays,
        "dropped": sum(lost),
        "devices": renderer.mesh.size,
    }


def true_pixels(
    scene: Scene, camera: Camera, samples: int, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of random pixels, and their exact colours."""
    film, gaussians = camera.film, scene.count
    chosen = exact.checked(film.width * film.height, gaussians, samples)
    return chosen, exact.picture(scene, camera, chosen, samples=samples, **options)
