"""How fast pictures get to disk: conversion, codec, and the writing of a data set as a whole.

python -m benchmarks.bench_disk [--side 512] [--frames 64] [--threads N] [--gaussians 20000]

One depth-of-field frame of the dynamic room, as it is (`clean`) and with the noise of a sensor
(`noisy`), moved on by a few pixels for each of --frames. For each kind of file:

one_thread, all_threads: pictures/s of the codec, file included, on one thread and on --threads; of
  videos, frames/s of one video and of several at a time
conversion: pictures/s from values on the device to those that the file stores, on the host
data_set: pictures/s of `render_dataset` with a renderer whose frames are there at once, manifests
  included; of labels, of `write_labels` with a labeller whose labels are there at once
kilobytes: of a picture

Files go to the folder for temporary files (TMPDIR). Medians of three rounds.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from benchmarks.problem import cameras, dynamic_room
from benchmarks.record import begin, record, show
from gaussray.camera.camera import Camera
from gaussray.dataset.layers import write_integers, write_layers
from gaussray.dataset.manifest import FrameRecord
from gaussray.dataset.video import write_video
from gaussray.render import Renderer, RenderOptions
from gaussray.render.aov.files import with_label_files, write_labels
from gaussray.render.aov.labeller import Labeller
from gaussray.render.dataset import render_dataset
from gaussray.render.develop import develop_picture, write_picture
from gaussray.render.frame import DevelopedFrame
from gaussray.render.options import NO_SENSOR
from gaussray.runtime.devices import cores
from gaussray.tracer.options import TraceOptions


ROUNDS = 3
# Videos of the data set of videos; the others have a camera for each frame, and so no video.
VIDEOS = 4
LABELS = ("depth", "normal", "flow_forward", "group", "valid")


class Ready(Renderer):
    """A renderer whose frames are on the device at once."""

    values: Sequence[Array] = ()

    def render_developed(
        self, cameras: Iterable[Camera], develop: Callable[[int, Array], Any]
    ) -> Iterator[DevelopedFrame]:
        for number, _ in enumerate(cameras):
            values = self.values[number % len(self.values)]
            yield DevelopedFrame(jax.device_get(develop(number, values)), 1)


class ReadyLabeller(Labeller):
    """A labeller whose labels are there at once."""

    def __init__(self, labels: dict[str, np.ndarray]):
        self.labels = labels

    def __call__(self, *_: Any, **__: Any) -> dict[str, np.ndarray]:
        return self.labels


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--side", type=int, default=512)
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--gaussians", type=int, default=20_000)
    parser.add_argument("--threads", type=int, default=cores())
    chosen = parser.parse_args(argv)
    camera = cameras(chosen.side)["depth_of_field"]
    options = RenderOptions(samples=16)
    trace = TraceOptions(backend=chosen.backend)
    renderer = Ready(dynamic_room(chosen.gaussians), options=options, trace=trace)
    frame = renderer(camera)
    clean = np.dstack([frame.color, frame.alpha, frame.depth])
    rows = []
    for picture, values in (("clean", clean), ("noisy", _noisy(clean))):
        renderer.values = [
            jnp.asarray(np.roll(values, (k, 2 * k), (0, 1))) for k in range(min(chosen.frames, 16))
        ]
        for kind in ("png", "exr", "video"):
            rows.append(_line(chosen, kind, picture, _pictures(renderer, camera, kind, chosen)))
    rows.append(_line(chosen, "labels", "clean", _labels(clean, camera, chosen)))
    names = "one_thread", "all_threads", "conversion", "data_set", "kilobytes"
    show(rows, "kind", "picture", "side", "threads", *names)


def _line(chosen, kind: str, picture: str, figures: dict[str, float | None]) -> dict[str, Any]:
    rate = figures["data_set"]
    assert rate is not None
    return record(
        "disk", kind=kind, picture=picture, side=chosen.side, threads=chosen.threads,
        scene="dynamic_room", gaussians=chosen.gaussians, run_s_median=1 / rate, **figures,
    )  # fmt: skip


def _pictures(renderer: Ready, camera: Camera, kind: str, chosen) -> dict[str, float | None]:
    """The figures of a kind of picture."""
    each = chosen.frames if kind != "video" else -(-chosen.frames // VIDEOS)
    suffix = "exr" if kind == "exr" else "png"
    records = [
        FrameRecord(f"images/{i:04d}.{suffix}", camera, f"camera_{i // each}", "test")
        if kind == "video"
        else FrameRecord(f"images/{i:04d}.{suffix}", camera, f"camera_{i}", "test")
        for i in range(chosen.frames)
    ]

    def convert(number: int) -> Any:
        values = renderer.values[number % len(renderer.values)]
        return jax.device_get(develop_picture(records[number], values, NO_SENSOR))

    converted = [convert(i) for i in range(len(renderer.values))]

    def encode(out: Path, number: int) -> None:
        if kind == "video":
            frames = (converted[k % len(converted)].values for k in range(each))
            write_video(out / f"{number}.mp4", frames, 24)
        else:
            write_picture(out / f"{number}.{suffix}", converted[number % len(converted)])

    def data_set(out: Path) -> None:
        render_dataset(renderer, records, out, quiet=True)

    count, frames = (VIDEOS, each) if kind == "video" else (chosen.frames, 1)
    return {
        "conversion": _rate(lambda _: [convert(i) for i in range(chosen.frames)], chosen.frames),
        "data_set": _rate(data_set, chosen.frames),
    } | _codec(encode, count, frames, chosen.threads)


def _labels(values: np.ndarray, camera: Camera, chosen) -> dict[str, float | None]:
    """The figures of labels; made-up normals and flow have the noise of real ones."""
    depth = values[..., 4]
    slope = np.stack(np.gradient(depth), axis=-1).astype(np.float32)
    normal = np.dstack([slope, np.ones_like(depth)])
    layers = {
        "depth": depth,
        "normal": normal / np.linalg.norm(normal, axis=-1, keepdims=True),
        "flow_forward": 8 / np.maximum(depth, 0.1)[..., None] * np.ones(2, np.float32),
    }
    integers = {"group": (depth * 4).astype(np.int32) % 7, "valid": (depth > 0).astype(np.int32)}
    plain = [FrameRecord(f"images/{i:04d}.png", camera, "a", "test") for i in range(chosen.frames)]
    records = with_label_files(plain, LABELS)

    def encode(out: Path, number: int) -> None:
        write_layers(out / f"{number}.exr", layers)
        for name, codes in integers.items():
            write_integers(out / f"{number}.{name}.png", codes)

    def data_set(out: Path) -> None:
        assigned = [one.file_path for one in records]
        labeller = ReadyLabeller(layers | integers)
        for _ in write_labels(out, records, assigned, LABELS, labeller):
            pass

    rate = _rate(data_set, chosen.frames)
    return {"conversion": None, "data_set": rate} | _codec(encode, chosen.frames, 1, chosen.threads)


def _codec(
    encode: Callable[[Path, int], None], count: int, frames: int, threads: int
) -> dict[str, float | None]:
    """Pictures/s of `count` files of so many frames, and kilobytes of a picture."""

    def one_after_another(out: Path) -> None:
        for i in range(count):
            encode(out, i)

    def side_by_side(out: Path) -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda i: encode(out, i), range(count)))

    with tempfile.TemporaryDirectory() as out:
        encode(Path(out), 0)
        size = sum(os.path.getsize(path) for path in Path(out).iterdir())
    return {
        "one_thread": _rate(one_after_another, count * frames),
        "all_threads": _rate(side_by_side, count * frames),
        "kilobytes": size / frames / 1e3,
    }


def _rate(write: Callable[[Path], object], count: int) -> float:
    """Pictures/s of a function that writes so many of them into an empty folder."""
    seconds = []
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as out:
            began = time.perf_counter()
            write(Path(out))
            seconds.append(time.perf_counter() - began)
    return count / float(np.median(seconds))


def _noisy(values: np.ndarray) -> np.ndarray:
    """With the noise of 2,000 electrons at white, in light."""
    noise = np.random.default_rng(0).normal(size=(*values.shape[:2], 3))
    light = values[..., :3] + noise * np.sqrt(np.maximum(values[..., :3], 0) / 2000)
    return np.dstack([light, values[..., 3:]]).astype(np.float32)


if __name__ == "__main__":
    main()
