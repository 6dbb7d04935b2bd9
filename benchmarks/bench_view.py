"""How long the page's pictures take while its camera moves, stage by stage.

python -m benchmarks.bench_view RUN [view.samples=1 aperture.radius=0.05 ...]
    [--widths 64 128 192 256 512 1920] [--frames 20]

What `gaussray view scene=RUN` shows between two movements of a mouse, by the parts that the page
is made of, without a browser: tracing, the sensor's development, the JPEG; `latency_s` is all of
it. `lens_s` are the seconds from the choice of another lens (LENS) to its first picture, when
nothing else compiles and no programs are kept on disk (do not set JAX_COMPILATION_CACHE_DIR);
`final_s` those that its final picture of this size takes after one through the lens before.
"""

import io
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.record import backend, begin, record, show
from gaussray.camera.camera import Camera, with_chromatic
from gaussray.config.compose import compose_config
from gaussray.render.job import RenderJob
from gaussray.render.renderer import Renderer
from gaussray.viewer.controls import choice_values
from gaussray.viewer.develop import develop_preview
from gaussray.viewer.model import ViewerModel
from gaussray.viewer.preview import PreviewRenderer
from gaussray.viewer.timing import PREVIEW_STAGES, StageTimer


# What the camera moves by from picture to picture, in scene units, and what is not counted: lists
# may turn out too short at first.
STEP, FIRST = 2e-3, 3
# As in gaussray.viewer.page.
JPEG_QUALITY = 80
# The lens that is chosen after the pictures of a width.
LENS = "equidistant"


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("scene", help="a reconstruction's folder")
    parser.add_argument("words", nargs="*", help="values of the configuration, as view takes them")
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128, 192, 256, 512, 1920])
    parser.add_argument("--frames", type=int, default=20)
    chosen = parser.parse_intermixed_args(argv)
    words = [f"scene={chosen.scene}", f"trace.backend={chosen.backend}", *chosen.words]
    model = ViewerModel(compose_config("view", words), words)
    job = model.job(model.initial_values, model.initial_viewpoint, model.size)
    previewer = PreviewRenderer(
        model.scene, options=job.options, trace=job.trace, keys=model.options.keys
    )
    name = Path(chosen.scene).resolve().name
    rows = [_measured(name, model, previewer, width, chosen.frames) for width in chosen.widths]
    previewer.close()
    show(
        rows,
        "width",
        "height",
        "samples",
        "k",
        *PREVIEW_STAGES,
        "latency_s",
        "fps",
        "lens_s",
        "final_s",
        "hits",
        "dropped",
    )


def _measured(
    scene: str, model: ViewerModel, previewer: PreviewRenderer, width: int, frames: int
) -> dict:
    """Medians over pictures of one width."""
    full = model.size
    size = width, max(round(width * full[1] / full[0]), 1)
    values = model.initial_values
    blurs = values["aperture.radius"] or values["shutter.exposure"]
    rays = min(model.options.samples, values["render.samples"]) if blurs else 1
    seen = []
    for i in range(-FIRST, frames):
        viewpoint = model.initial_viewpoint
        viewpoint = viewpoint._replace(position=tuple(np.add(viewpoint.position, STEP * i)))
        timer, began = StageTimer(), time.perf_counter()
        with timer.stage("tracing"):
            job = model.job(values, viewpoint, size)
            while (preview := previewer(_camera(job), rays)) is None or previewer.compiling:
                time.sleep(0.05)
        with timer.stage("developing"):
            codes = develop_preview(preview, job)
        with timer.stage("encoding"):
            _jpeg(codes)
        if i >= 0:
            seen.append((*timer.stages.values(), time.perf_counter() - began, preview))
    began = time.perf_counter()
    job = model.job(values | choice_values("lens", LENS), model.initial_viewpoint, size)
    while previewer(_camera(job), rays) is None:
        time.sleep(0.01)
    lens = time.perf_counter() - began
    render = Renderer(model.scene, options=job.options, trace=job.trace)
    render(_camera(model.job(values, model.initial_viewpoint, size)))
    began = time.perf_counter()
    render(_camera(job))
    final = time.perf_counter() - began
    *stages, seconds = (
        float(np.median([one[j] for one in seen])) for j in range(len(PREVIEW_STAGES) + 1)
    )
    count = size[0] * size[1] * rays
    return record(
        "view", effect="sketch", scene=scene, rays=count, samples=rays, k=job.trace.k,
        gaussians=sum(s.static.count + s.moving.count for s in previewer.scenes),
        backend=backend(job.trace.backend),
        direction="forward", width=size[0], height=size[1], run_s_median=seconds,
        latency_s=seconds, lens_s=round(lens, 2), final_s=round(final, 2),
        **dict(zip(PREVIEW_STAGES, stages, strict=True)),
        hits=float(np.median([one[-1].hits for one in seen])) / count,
        dropped=max(one[-1].dropped for one in seen),
    )  # fmt: skip


def _camera(job: RenderJob) -> Camera:
    return with_chromatic(job.records[0].camera, job.dataset.sensor.chromatic)


def _jpeg(codes: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "jpeg", quality=JPEG_QUALITY)
    return file.getvalue()


if __name__ == "__main__":
    main()
