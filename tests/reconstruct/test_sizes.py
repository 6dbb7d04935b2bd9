"""Training pictures of quite different sizes, and through lenses of different models."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.lens import ray_table
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.view_part import part_of_view
from gaussray.dataset.images import write_image
from gaussray.reconstruct import reconstruct


pytestmark = pytest.mark.usefixtures("known_sizes")

WIDE, TALL = toy.CAMERAS[:2]
# What is left of the pictures of these cameras: left, top, width, height.
BOXES = {WIDE: (0, 3, toy.SIZE, 10), TALL: (4, 0, 8, toy.SIZE)}
# The lenses of both captures differ by rounding.
CLOSE = 1e-4
# A table's directions are interpolated; twenty steps of Adam enlarge what they differ by: decibels.
TABLE = 0.02


@pytest.fixture(scope="module")
def capture(tmp_path_factory, known_sizes):
    return read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))


def smaller(capture):
    """The capture with smaller pictures of two cameras."""
    views = [
        part_of_view(view, BOXES[view.camera_name], BOXES[view.camera_name][2:], {})
        if view.camera_name in BOXES
        else view
        for view in capture.views
    ]
    return dataclasses.replace(capture, views=views)


def masked(capture, folder):
    """The capture with whole pictures, of which masks leave as much."""
    for name, (left, top, width, height) in BOXES.items():
        mask = np.zeros((toy.SIZE, toy.SIZE, 3))
        mask[top : top + height, left : left + width] = 1
        write_image(folder / f"{name}.png", mask)
    views = [
        dataclasses.replace(view, mask=folder / f"{view.camera_name}.png")
        if view.camera_name in BOXES
        else view
        for view in capture.views
    ]
    return dataclasses.replace(capture, views=views)


@pytest.mark.filterwarnings("ignore:stereo finds")
@pytest.mark.parametrize("start", ["given", "stereo"])
def test_smaller_pictures_are_fitted_like_masked_ones(capture, tmp_path, start):
    fit = dataclasses.replace(toy.SHORT.fit, start=start)
    options = dataclasses.replace(toy.SHORT, fit=fit)
    with pytest.warns(CaptureWarning, match=r"3 sizes .* in the middle of one of 16 x 16"):
        first = reconstruct(smaller(capture), tmp_path / "sizes", options=options, quiet=True)
    second = reconstruct(masked(capture, tmp_path), tmp_path / "masks", options=options, quiet=True)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        np.testing.assert_allclose(a, b, atol=CLOSE)


def through_tables(capture):
    """The capture with tables of the same directions as lenses of two cameras."""

    def table(view):
        camera = view.camera
        across, down = (jnp.arange(n, dtype=jnp.float32) + 0.5 for n in (view.width, view.height))
        pixel = jnp.stack(jnp.meshgrid(across, down), axis=-1)
        rays = jax.vmap(jax.vmap(camera.lens.direction))(pixel)
        lens = ray_table(rays, view.width, view.height)
        return dataclasses.replace(view, camera=dataclasses.replace(camera, lens=lens))

    views = [table(view) if view.camera_name in BOXES else view for view in capture.views]
    return dataclasses.replace(capture, views=views)


def scores(run):
    """PSNR of the training pixels of each block of steps."""
    lines = (run / "metrics.jsonl").read_text().splitlines()
    return [json.loads(line)["psnr"] for line in lines]


@pytest.mark.filterwarnings("ignore:training pictures have 3 sizes")
def test_cameras_of_different_lens_models_are_fitted_together(capture, tmp_path):
    """Each camera has directions of its own, as its pictures are another part."""
    capture = smaller(capture)
    mixed = through_tables(capture)
    assert len({type(view.camera.lens) for view in mixed.views}) == 2
    for seen, out in ((mixed, "mixed"), (capture, "one")):
        reconstruct(seen, tmp_path / out, options=toy.SHORT, quiet=True)
    first, second = (scores(tmp_path / out) for out in ("mixed", "one"))
    np.testing.assert_allclose(first, second, atol=TABLE)
    written = json.loads((tmp_path / "mixed/cameras.json").read_text())["frames"]
    models = {frame["camera"]: frame.get("lens", {}).get("model") for frame in written}
    assert models == {name: "table" if name in BOXES else None for name in toy.CAMERAS}
