"""A model with the toy's scene, for the tests of the page."""

import time as clock
from pathlib import Path

import toy

from gaussray.config.compose import compose_config
from gaussray.dataset.manifest import write_manifest
from gaussray.scene.store import save_scene
from gaussray.tracer.traverse import Capacity
from gaussray.viewer.model import ViewerModel


# Lists with room for every toy.
ROOM = Capacity((512,), 512, 64)
WORDS = (
    *("view.width=16", "render.samples=2", "trace.levels=0", "trace.group=2", "trace.chunk=8"),
    *("camera.split=train", "view.samples=2"),
)


def write_scene(folder: Path) -> Path:
    """The toy's scene with the cameras that filmed it."""
    save_scene(folder / "scene.npz", toy.scene())
    write_manifest(folder / "cameras.json", toy.records())
    return folder


def viewer_model(folder: Path, *words: str) -> ViewerModel:
    """Of the scene in a folder."""
    told = [f"scene={folder}", *WORDS, *words]
    return ViewerModel(compose_config("view", told), told)


def made(previewer, camera, samples):
    """The preview, as soon as its program is there."""
    until = clock.monotonic() + 120
    while (found := previewer(camera, samples)) is None:
        assert previewer.failure is None and clock.monotonic() < until
        clock.sleep(0.01)
    return found
