"""What faults are tried on: a capture of four cameras and four frames, and words that are quick."""

import dataclasses
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gaussray.camera.aperture import no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.camera.shutter import global_shutter
from gaussray.camera.trajectory import Trajectory
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.scene import Scene
from gaussray.scene.store import save_scene


SIDE, TIMES = 32, (0.0, 1 / 3, 2 / 3, 1.0)
CAMERAS = {"cam_0": -0.6, "cam_1": -0.2, "cam_2": 0.6, "cam_3": 0.2}
TRACE = ["trace.levels=0", "trace.group=2", "trace.chunk=8"]
# Steps of a block, and seconds between saved states.
BLOCK, INTERVAL = 4, 0.2
FIT = [
    f"fit.coarse={12 * BLOCK}", f"fit.fine={36 * BLOCK}", f"fit.block={BLOCK}", "fit.tiles=4",
    "fit.points=100", "fit.start=given", "fit.surround=0", "track.poses=0", "field.sides=[4]",
    "field.channels=4", "field.width=8",
    "prune.loss=0", "prune.precision=full", f"fit.checkpoint={INTERVAL}", *TRACE,
]  # fmt: skip


def single(x) -> jnp.ndarray:
    """In single precision."""
    return jnp.asarray(x, jnp.float32)


def scene_of(count: int, seed: int = 0) -> Scene:
    """So many random Gaussians around the origin, at rest; the fewer, the larger."""
    chance = np.random.default_rng(seed)
    mean = chance.uniform(-1, 1, (count, 3))
    scale = chance.uniform(0.05, 0.3, (count, 3)) * min((60 / count) ** (1 / 3), 1)
    color = chance.uniform(0, 1, (count, 3))
    parts = mean, chance.normal(size=(count, 4)), scale, np.full(count, 0.9)
    still = Gaussians(*(single(x) for x in parts), constant_harmonics(single(color), 0))
    parts = (x[:0] for x in (still.mean, still.quat, still.scale, still.opacity))
    return Scene(still, Gaussians(*parts, still.harmonics[:0]), None, single([0, 1]))


def records(side: int = SIDE) -> list[FrameRecord]:
    """All frames of all cameras; the last camera is held out."""
    lens = pinhole(single([side, side]), single([side / 2, side / 2]))
    return [
        FrameRecord(
            f"images/{name}/{i:04d}.png",
            Camera(
                Film(side, side, "center"),
                lens,
                no_aperture(),
                global_shutter(),
                Trajectory(single([0]), single([[1, 0, 0, 0]]), single([[x, 0, -3]])),
                single(time),
            ),
            name,
            "test" if name == "cam_3" else "train",
        )
        for name, x in CAMERAS.items()
        for i, time in enumerate(TIMES)
    ]


def write_capture(folder: Path) -> None:
    """Pictures of Gaussians that go to the right, one state a frame, and the scene of the first."""
    listed, first = records(), scene_of(60)
    for moment in TIMES:
        right = single([0.3 * moment, 0, 0])
        moved = dataclasses.replace(first.static, mean=first.static.mean + right)
        show = Renderer(dataclasses.replace(first, static=moved), options=RenderOptions(samples=1))
        for record in (r for r in listed if abs(float(r.camera.time) - moment) < 1e-6):
            write_image(folder / record.file_path, show(record.camera).color)
    write_manifest(folder / "transforms.json", listed, extra={"time_unit": "s"})
    save_scene(folder / "run" / "scene.npz", first)
    write_manifest(folder / "run" / "cameras.json", listed)


def words_of(work: str, capture: Path, out: Path) -> list[str]:
    """The command of a work: reconstruct, render (a film), samples (drawn cameras), evaluate."""
    quiet = [f"out={out}", "progress=quiet", "report=false"]
    scene = f"scene={capture / 'run'}"
    drawn = ["dataset.count=24", "format=exr", "sample.sensor.exposure.uniform=[-1,1]"]
    return {
        "reconstruct": ["reconstruct", f"capture.path={capture}", "resume=auto", *FIT, *quiet],
        "render": [
            "render",
            scene,
            "trajectory=between",
            "camera.split=train",
            "trajectory.steps=30",
            *TRACE,
            *quiet,
        ],
        "samples": ["render", scene, *drawn, *TRACE, *quiet],
        "evaluate": ["evaluate", scene, f"truth={capture}", "evaluate.split=all", *TRACE, *quiet],
    }[work]


class Forked:
    """Work in a process of its own, that has what this one has imported; what it says is in
    `log`."""

    def __init__(self, work: Callable[[], object], log: Path):
        self.returncode: int | None = None
        self.pid = os.fork()
        if not self.pid:
            code = 1
            try:
                file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
                os.dup2(file, 1)
                os.dup2(file, 2)
                work()
                code = 0
            except SystemExit as stop:
                code = int(stop.code or 0)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)

    def poll(self) -> int | None:
        """The exit code, or minus the signal; None while it is at work."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def wait(self) -> int:
        """The exit code, or minus the signal, at its end."""
        while self.poll() is None:
            time.sleep(0.01)
        return self.returncode or 0

    def kill(self) -> None:
        """As kill -9 does."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)
