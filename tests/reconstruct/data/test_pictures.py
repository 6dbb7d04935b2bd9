"""Training pictures on the host: their tiles, masks and cameras, in memory and on disk."""

import dataclasses
import os
import re

import films
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.film import Film
from gaussray.camera.lens import KannalaBrandt
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.paired import read_views
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.data.tiles import cut, tile_pixels


# Odd sides that tiles of SIDE do not divide, and a side whose square fills no bytes.
WIDTH, HEIGHT, SIDE = 13, 19, 5
TIMES = (0.0, 0.5, 1.0)


def picture(frame):
    """Codes that name their own column, row and frame."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([x, y, np.full_like(x, frame)], axis=-1).astype(np.uint8)


def hole():
    """A mask that is False in one corner and at one pixel."""
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:5, :7] = mask[17, 3] = False
    return mask


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """Three views of a camera that moves; the one in the middle has a mask."""
    folder = tmp_path_factory.mktemp("capture")
    films.write_mask(folder / "mask.png", hole())
    records = [
        FrameRecord(
            f"{i}.png", toy.camera(0.2 * i, time, WIDTH, HEIGHT), f"cam{i % 2}", "train",
            mask_path="mask.png" if i == 1 else None,
        )
        for i, time in enumerate(TIMES)
    ]  # fmt: skip
    for i, record in enumerate(records):
        write_image(folder / record.file_path, picture(i))
    write_manifest(folder / "transforms.json", records)
    return read_views(folder / "transforms.json")


def other(view, **parts):
    """The view through a camera of which parts are others."""
    camera = type(view.camera)(**(vars(view.camera) | parts))
    return dataclasses.replace(view, camera=camera)


@pytest.mark.parametrize("memory", [1.0, 0.0])
def test_footage_holds_the_bytes_the_masks_and_the_times(views, memory, tmp_path):
    told = []
    shown = footage(views, side=SIDE, memory=memory, folder=tmp_path, report=told.append)
    assert isinstance(shown.pixel, np.memmap) == isinstance(shown.mask, np.memmap) == (memory == 0)
    assert shown.pixel.dtype == np.uint8 and shown.scale == 255
    pixels = tile_pixels(shown.film, SIDE)
    np.testing.assert_array_equal(shown.pixel, [cut(picture(i), pixels) for i in range(3)])
    np.testing.assert_array_equal(
        shown.pictures(np.array([2, 0])), np.stack([picture(2), picture(0)])
    )
    np.testing.assert_array_equal(shown.times, np.float32(TIMES))
    assert shown.name.tolist() == ["cam0", "cam1", "cam0"] and told == [1, 2, 3]
    all_of = np.ones((HEIGHT, WIDTH), bool)
    np.testing.assert_array_equal(shown.masks(np.arange(3)), np.stack([all_of, hole(), all_of]))
    np.testing.assert_array_equal(shown.visible(1, 0), cut(hole(), pixels)[0])
    # Of the corner that is masked, one tile holds nothing else.
    np.testing.assert_array_equal(np.argwhere(~shown.visible_tiles()), [[1, 0]])
    # The file has no name: nothing is left, even if the process is ended.
    assert not list(tmp_path.iterdir())


def test_the_file_goes_with_the_footage(views, tmp_path):
    def open_files():
        kept = os.listdir("/proc/self/map_files")
        return [k for k in kept if str(tmp_path) in os.readlink(f"/proc/self/map_files/{k}")]

    if not os.access("/proc/self/map_files", os.R_OK):
        pytest.skip("this system does not list what is mapped")
    shown = footage(views, side=SIDE, memory=0.0, folder=tmp_path)
    assert len(open_files()) == 2
    del shown
    assert not open_files()


def test_without_masks_all_counts(views):
    shown = footage([views[0], views[2]], side=SIDE)
    assert shown.mask is None and shown.masks(np.arange(2)) is None
    assert shown.visible(0) is None and shown.visible_tiles() is None


def test_a_part_has_its_own_pictures_masks_and_cameras(views):
    whole, chosen = footage(views, side=SIDE), np.array([2, 1])
    part = whole.part(chosen)
    np.testing.assert_array_equal(part.pictures(np.arange(2)), whole.pictures(chosen))
    np.testing.assert_array_equal(part.masks(np.arange(2)), whole.masks(chosen))
    np.testing.assert_array_equal(part.times, whole.times[chosen])
    np.testing.assert_array_equal(part.viewpoints, whole.viewpoints[chosen])
    place = np.asarray(whole.camera.trajectory.translation)[chosen]
    np.testing.assert_array_equal(part.camera.trajectory.translation, place)
    assert footage([views[0], views[2]], side=SIDE).part(chosen[:1] - 1).mask is None


def test_one_float_file_makes_all_of_them_fractions(views, tmp_path):
    write_image(tmp_path / "a.exr", np.full((HEIGHT, WIDTH, 3), 0.25, np.float32), depth="float")
    fine = dataclasses.replace(views[2], image=tmp_path / "a.exr")
    shown = footage([views[0], fine], side=SIDE)
    assert shown.pixel.dtype == np.float32 and shown.scale == 1
    np.testing.assert_array_equal(shown.pictures(np.array([0]))[0], np.float32(picture(0) / 255))


def test_a_full_disk_is_one_clear_error(views, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    told = f"{re.escape(str(tmp_path))}: the training pictures .* raise fit.memory"
    with pytest.raises(OSError, match=told):
        footage(views, side=SIDE, memory=0.0, folder=tmp_path)


def test_without_a_view_the_remedy_is_named():
    with pytest.raises(CaptureError, match='"split": "train"'):
        footage([], side=SIDE)


@pytest.mark.parametrize("what", ["size", "lens", "film", "path"])
def test_views_that_cannot_be_stacked_are_named(views, what):
    camera = views[2].camera
    size = toy.single([WIDTH / 2, HEIGHT / 2])
    pose = camera.trajectory
    double = (jnp.concatenate([x, x]) for x in (pose.quat, pose.translation))
    parts = {
        "size": {"film": Film(HEIGHT, WIDTH, "center")},
        "lens": {"lens": KannalaBrandt(size, size, jnp.zeros(4, jnp.float32), toy.single(1.0))},
        "film": {"film": Film(WIDTH, HEIGHT, "box", 1.0)},
        "path": {"trajectory": Trajectory(toy.single([0, 1]), *double)},
    }
    with pytest.raises(CaptureError, match="must share one size, lens model") as error:
        footage([*views[:2], other(views[2], **parts[what])], side=SIDE)
    assert str(views[2].image) in str(error.value) and str(views[0].image) in str(error.value)
