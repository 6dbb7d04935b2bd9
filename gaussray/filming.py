"""A data set of pictures: what cameras see of a scene, as a paired capture in a folder."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from gaussray.atomic import whole
from gaussray.capture.frames import read_image
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.dataset.video import write_video
from gaussray.progress import Progress
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.scene import Scene
from gaussray.tracer.trace import TraceOptions


def render_dataset(
    scene: Scene,
    records: Sequence[FrameRecord],
    out: Path | str,
    *,
    options: RenderOptions,
    trace: TraceOptions,
    fps: float = 8.0,
    quiet: bool = False,
) -> Path:
    """Write every recorded frame as a picture, each effect's manifest, and a video per camera.

    The folder is a paired capture: it can be read back, reconstructed and evaluated. A picture that
    is already there is kept, so an interrupted run goes on; a folder that was begun with another
    scene, camera or option is refused.
    """
    out = Path(out)
    _claim(out, scene, records, options, trace)
    render = Renderer(scene, options=options, trace=trace)
    progress = Progress("render", len(records), quiet=quiet)
    shown: dict[str, list[Path]] = {}
    missing = [not (out / record.file_path).exists() for record in records]
    frames = render.film(r.camera for r, new in zip(records, missing, strict=True) if new)
    for done, (record, new) in enumerate(zip(records, missing, strict=True), 1):
        path = out / record.file_path
        if new:
            write_image(path, next(frames).color)
        shown.setdefault(f"{record.effect}_{record.camera_name}", []).append(path)
        progress.report(done, record.effect)
    for effect in dict.fromkeys(record.effect for record in records):
        name = "transforms" if effect == "pinhole" else effect
        chosen = [record for record in records if record.effect == effect]
        write_manifest(out / f"{name}.json", chosen)
    for name, paths in shown.items():
        film = next(r.camera.film for r in records if out / r.file_path == paths[0])
        size = film.width, film.height
        if len(paths) > 1:
            write_video(out / f"{name}.mp4", (read_image(path, *size) for path in paths), fps)
    return out


def _claim(out: Path, scene: Scene, records: Sequence[FrameRecord], options, trace) -> None:
    """Note in `out` what its pictures are made of, unless another note is there already."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves((scene, [record.camera for record in records])):
        digest.update(np.asarray(leaf).tobytes())
    files = [record.file_path for record in records]
    static = [jax.tree.structure(record.camera) for record in records]
    digest.update(repr((files, static, options, trace)).encode())
    note, own = out / "render.sha256", digest.hexdigest() + "\n"
    try:
        if note.exists() and note.read_text() != own:
            raise ValueError(
                f"out={out} holds pictures of another scene, camera or option. Choose another "
                "folder, or delete this one."
            )
        with whole(note) as partial:
            partial.write_text(own)
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error}") from error
