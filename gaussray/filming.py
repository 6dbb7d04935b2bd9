"""A data set of pictures: what cameras see of a scene, as a paired capture in a folder."""

import hashlib
import time as clock
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

from gaussray.atomic import whole
from gaussray.capture.frames import read_image
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.dataset.video import write_video
from gaussray.devices import agreed, leads, share, wait
from gaussray.progress import Progress
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.scene import Scene
from gaussray.tracer.trace import TraceOptions


# Seconds within which a shared folder shows what another host has written.
PATIENCE = 90.0


def render_dataset(
    scene: Scene,
    records: Sequence[FrameRecord],
    out: Path | str,
    *,
    options: RenderOptions,
    trace: TraceOptions,
    fps: float = 8.0,
    devices: int | None = None,
    quiet: bool = False,
) -> Path:
    """Write every recorded frame as a picture, each effect's manifest, and a video per camera.

    The folder is a paired capture: it can be read back, reconstructed and evaluated. A picture that
    is already there is kept, so an interrupted run goes on; a folder that was begun with another
    scene, camera or option is refused. Each host renders its share of what is missing, on so many
    `devices` (None is all); the first one writes the rest when all pictures are there.
    """
    out = Path(out)
    _claim(out, scene, records, options, trace)
    there = agreed(np.array([(out / record.file_path).exists() for record in records]))
    own = share([record for record, old in zip(records, there, strict=True) if not old])
    render = Renderer(scene, options=options, trace=trace, devices=devices)
    progress = Progress("render", len(own), quiet=quiet or not leads())
    frames = render.film(record.camera for record in own)
    for done, (record, frame) in enumerate(zip(own, frames, strict=True), 1):
        write_image(out / record.file_path, frame.color)
        progress.report(done, record.effect)
    wait("pictures")
    if leads():
        _demand_all(out, records)
        _write_lists_and_videos(out, records, fps)
    wait("videos")
    return out


def _demand_all(out: Path, records: Sequence[FrameRecord]) -> None:
    """Every picture, also those that other hosts have written, which a network may show late."""
    patience = clock.monotonic() + PATIENCE
    while missing := [r.file_path for r in records if not (out / r.file_path).exists()]:
        if clock.monotonic() > patience:
            raise OSError(
                f"out={out}: {len(missing)} pictures that other hosts have rendered are not here, "
                f"such as {missing[0]}. Choose a folder that all hosts share."
            )
        clock.sleep(0.5)


def _write_lists_and_videos(out: Path, records: Sequence[FrameRecord], fps: float) -> None:
    shown: dict[str, list[Path]] = {}
    for record in records:
        name = f"{record.effect}_{record.camera_name}"
        shown.setdefault(name, []).append(out / record.file_path)
    for effect in dict.fromkeys(record.effect for record in records):
        name = "transforms" if effect == "pinhole" else effect
        chosen = [record for record in records if record.effect == effect]
        write_manifest(out / f"{name}.json", chosen)
    for name, paths in shown.items():
        film = next(r.camera.film for r in records if out / r.file_path == paths[0])
        size = film.width, film.height
        if len(paths) > 1:
            write_video(out / f"{name}.mp4", (read_image(path, *size) for path in paths), fps)


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
        if leads():
            with whole(note) as partial:
                partial.write_text(own)
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error}") from error
