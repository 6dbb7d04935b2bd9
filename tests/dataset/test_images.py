"""Pictures written and read again, and pictures of pictures."""

import os
import time
import types

import films
import numpy as np
import OpenImageIO as oiio
import pytest
from picture_files import Picture

from gaussray.capture.frames import read_encoded, read_image, read_mask
from gaussray.color import srgb_decode
from gaussray.dataset.images import (
    contact_sheet,
    enlarge,
    side_by_side,
    srgb_levels,
    write_image,
)
from gaussray.dataset.layers import write_layers


ALL_CODES = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=-1)


@pytest.mark.parametrize("form", ["codes", "linear"])
def test_every_srgb_code_survives_writing_and_reading(tmp_path, form):
    image = ALL_CODES if form == "codes" else srgb_decode(ALL_CODES / 255).astype(np.float32)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_encoded(Picture(tmp_path / "a.png", 16, 16)), ALL_CODES)
    write_image(tmp_path / "b.png", read_image(tmp_path / "a.png", 16, 16))
    np.testing.assert_array_equal(read_encoded(Picture(tmp_path / "b.png", 16, 16)), ALL_CODES)


def test_codes_are_clipped_and_rounded_to_nearest():
    linear = np.array([[[-1, 0, 0.18], [0.5, 1, 7]]])
    np.testing.assert_array_equal(srgb_levels(linear), [[[0, 0, 118], [188, 255, 255]]])


@pytest.mark.parametrize(("depth", "tolerance"), [("float", 0), ("half", 2**-11)])
def test_an_exr_is_linear_light_beyond_one_and_below_zero(tmp_path, depth, tolerance):
    linear = np.random.default_rng(0).normal(0, 10, (8, 12, 3)).astype(np.float32)
    write_image(tmp_path / "a.exr", linear, depth=depth)
    np.testing.assert_allclose(read_image(tmp_path / "a.exr", 12, 8), linear, rtol=tolerance)


def test_the_same_pixels_are_the_same_bytes_at_any_time(tmp_path):
    linear = np.random.default_rng(0).random((8, 12, 3), np.float32)
    write_image(tmp_path / "a.exr", linear)
    write_layers(tmp_path / "c.exr", {"depth": linear[..., 0]})
    second = time.time() // 1
    while time.time() // 1 == second:  # what a file would note of when it was made
        time.sleep(0.02)
    write_image(tmp_path / "b.exr", linear)
    write_layers(tmp_path / "d.exr", {"depth": linear[..., 0]})
    for first, later in ("ab", "cd"):
        one, two = ((tmp_path / f"{name}.exr").read_bytes() for name in (first, later))
        assert one == two
    assert "DateTime" not in {
        item.name for item in oiio.ImageInput.open(str(tmp_path / "a.exr")).spec().extra_attribs
    }


def test_a_map_of_one_channel_may_be_infinite_in_an_exr(tmp_path):
    depth = np.full((8, 12), np.inf, np.float32)
    depth[0] = 3
    write_image(tmp_path / "depth.exr", depth)
    assert oiio.ImageInput.open(str(tmp_path / "depth.exr")).spec().nchannels == 1
    np.testing.assert_array_equal(read_image(tmp_path / "depth.exr", 12, 8)[..., 0], depth)


def test_a_mask_comes_back(tmp_path):
    mask = np.random.default_rng(0).random((8, 12)) > 0.5
    films.write_mask(tmp_path / "m.png", mask)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", 12, 8), mask)


def test_folders_are_made_and_nothing_temporary_stays(tmp_path):
    write_image(tmp_path / "new/deep/a.png", ALL_CODES)
    assert [path.name for path in (tmp_path / "new/deep").iterdir()] == ["a.png"]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_image(tmp_path / "a.png", ALL_CODES)
    with pytest.raises(OSError, match="a.png: the picture cannot be written: .*channel"):
        write_image(tmp_path / "a.png", np.zeros((4, 4, 7), np.uint8))
    np.testing.assert_array_equal(read_encoded(Picture(tmp_path / "a.png", 16, 16)), ALL_CODES)
    assert len(list(tmp_path.iterdir())) == 1


def test_a_path_below_a_file_is_refused_by_name(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file/a.png: its folder cannot be made"):
        write_image(tmp_path / "file/a.png", ALL_CODES)


def test_what_a_format_cannot_hold_is_refused(tmp_path):
    linear = np.ones((4, 4, 3))
    with pytest.raises(ValueError, match="suffix must be .png or .exr, got '.gif'"):
        write_image(tmp_path / "a.gif", linear)
    with pytest.raises(ValueError, match="must be linear light, got 8-bit levels"):
        write_image(tmp_path / "a.exr", ALL_CODES)
    with pytest.raises(ValueError, match="must stay within 65504, got 70000.0. Use depth='float'"):
        write_image(tmp_path / "a.exr", 7e4 * linear)
    with pytest.raises(ValueError, match="depth must be one of half, float, got 'double'"):
        write_image(tmp_path / "a.exr", linear, depth="double")
    linear[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="must be finite, got 1 values that are not"):
        write_image(tmp_path / "a.png", linear)


def test_side_by_side_is_truth_then_ours_then_the_amplified_difference():
    truth = np.full((4, 5, 3), 100, np.uint8)
    ours = np.full((4, 5, 3), 90, np.uint8)
    joined = side_by_side(truth, ours, gain=4)
    assert joined.shape == (4, 15, 3) and joined.dtype == np.uint8
    np.testing.assert_array_equal(joined[0, ::5, 0], [100, 90, 40])
    shown = np.arange(20).reshape(4, 5) % 3 == 0
    masked = side_by_side(truth, ours, shown, gain=4)
    np.testing.assert_array_equal(masked[:, :10], joined[:, :10])
    np.testing.assert_array_equal(masked[:, 10:, 0], 40 * shown)
    with pytest.raises(ValueError, match="must have one size"):
        side_by_side(truth, ours[:2])


def test_enlarging_repeats_pixels_by_the_smallest_factor_that_suffices():
    image = np.arange(6, dtype=np.uint8).reshape(2, 3, 1)
    assert enlarge(image, 0) is not None and enlarge(image, 2).shape == (2, 3, 1)
    large = enlarge(image, 5)
    assert large.shape == (6, 9, 1)
    np.testing.assert_array_equal(large[::3, ::3], image)


def test_a_contact_sheet_holds_its_pictures_and_its_labels():
    red = np.full((30, 40, 3), (255, 0, 0), np.uint8)
    blue = np.full((20, 20, 3), (0, 0, 255), np.uint8)
    rows = [("pinhole 30.1 dB", [red, blue]), ("fisheye", [blue])]
    sheet = contact_sheet(rows, titles=("truth", "ours"))
    assert sheet.dtype == np.uint8
    assert (sheet == (255, 0, 0)).all(axis=-1).sum() == 30 * 40
    assert (sheet == (0, 0, 255)).all(axis=-1).sum() == 2 * 20 * 20
    dark = (sheet < 100).all(axis=-1)
    left = np.argmax((sheet == (255, 0, 0)).all(axis=-1).any(axis=0))
    assert dark[:, :left].sum() > 100, "row labels"
    assert dark[:20, left:].sum() > 30, "column titles"
    assert not dark[:, left:][26:].any(), "no label on a picture"


def test_a_contact_sheet_enlarges_small_pictures():
    red = np.full((10, 10, 3), (255, 0, 0), np.uint8)
    sheet = contact_sheet([("", [red])], least=25)
    assert (sheet == (255, 0, 0)).all(axis=-1).sum() == 30 * 30
    with pytest.raises(ValueError, match="at least one row"):
        contact_sheet([])


def test_a_picture_that_lost_its_end_is_no_picture(tmp_path, monkeypatch):
    real = oiio.ImageOutput.create

    class Full:
        """Writes as OpenImageIO does to a full disk: not all of it, without a word."""

        def __init__(self, name):
            self.file = real(name)

        def __getattr__(self, name):
            return getattr(self.file, name)

        def close(self):
            self.file.close()
            for partial in tmp_path.iterdir():
                os.truncate(partial, partial.stat().st_size - 20)
            return True

    monkeypatch.setattr(oiio, "ImageOutput", types.SimpleNamespace(create=Full))
    with pytest.raises(OSError, match="a.png: the picture cannot be written"):
        write_image(tmp_path / "a.png", np.zeros((8, 8, 3), np.uint8))
    assert not list(tmp_path.iterdir())
