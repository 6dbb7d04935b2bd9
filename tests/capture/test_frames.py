"""Pictures from disk: exact values, and every way in which a file can be wrong."""

import tracemalloc

import films
import numpy as np
import OpenImageIO as oiio
import pytest
import toy
from picture_files import Picture, random_codes, write

from gaussray.capture import frames, picture_file
from gaussray.capture.capture import View
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.frames import read_encoded, read_image, read_mask, visible_pixels
from gaussray.capture.picture_file import read_levels, read_with_alpha
from gaussray.capture.videos import frame_path
from gaussray.capture.view_file import check_images
from gaussray.color import srgb_decode, srgb_encode


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_png_is_the_exact_inverse_of_the_srgb_curve(tmp_path, kind):
    codes = random_codes(kind)
    path = write(tmp_path / "a.png", codes)
    linear = read_image(path, 32, 24)
    assert linear.dtype == np.float32
    expected = srgb_decode(codes / np.iinfo(kind).max)
    np.testing.assert_allclose(linear, expected, rtol=1e-7)
    np.testing.assert_allclose(
        read_image(path, 32, 24, "linear"), codes / np.iinfo(kind).max, rtol=1e-7
    )


def test_stored_codes_come_back_as_they_are(tmp_path):
    codes = random_codes()
    view = Picture(write(tmp_path / "a.png", codes), 32, 24)
    np.testing.assert_array_equal(read_encoded(view), codes)
    assert read_encoded(view).dtype == np.uint8


def test_levels_have_eight_bits_and_deeper_ones_are_rounded(tmp_path):
    codes = random_codes(np.uint16)
    deep = write(tmp_path / "a.png", codes)
    # Level n of 255 is code 257 n of 65535.
    np.testing.assert_array_equal(read_levels(deep, 32, 24), (codes.astype(int) + 128) // 257)
    codes = random_codes()
    np.testing.assert_array_equal(read_levels(write(tmp_path / "b.png", codes), 32, 24), codes)


def test_a_jpeg_is_read_as_srgb(tmp_path):
    codes = np.full((24, 32, 3), (200, 100, 50), np.uint8)
    stored = read_encoded(Picture(write(tmp_path / "a.jpg", codes), 32, 24))
    assert np.abs(stored.astype(int) - codes).max() <= 2


def test_an_exr_is_linear_light_of_any_size(tmp_path):
    linear = np.random.default_rng(0).normal(1, 3, (24, 32, 3)).astype(np.float32)
    path = write(tmp_path / "a.exr", linear)
    np.testing.assert_array_equal(read_image(path, 32, 24), linear)
    encoded = read_encoded(Picture(path, 32, 24))
    np.testing.assert_allclose(encoded, srgb_encode(linear.astype(np.float64)), rtol=1e-6)


def test_codes_said_to_be_linear_are_encoded(tmp_path):
    codes = random_codes()
    view = Picture(write(tmp_path / "a.png", codes), 32, 24, "linear")
    np.testing.assert_allclose(read_encoded(view), srgb_encode(codes / 255), atol=1e-6)


def test_gray_becomes_three_equal_channels(tmp_path):
    codes = random_codes(channels=1)
    stored = read_encoded(Picture(write(tmp_path / "a.png", codes), 32, 24))
    np.testing.assert_array_equal(stored, codes.repeat(3, axis=-1))


def test_alpha_is_dropped_with_a_warning_and_the_stored_colours_stay(tmp_path):
    codes = random_codes(channels=4)
    path = write(tmp_path / "a.png", codes)
    with pytest.warns(CaptureWarning, match="alpha below 1 in pictures is ignored"):
        stored = read_encoded(Picture(path, 32, 24))
    np.testing.assert_array_equal(stored, codes[..., :3])


def test_opaque_alpha_is_dropped_without_a_word(tmp_path):
    codes = random_codes(channels=4)
    codes[..., 3] = 255
    view = Picture(write(tmp_path / "a.png", codes), 32, 24)
    np.testing.assert_array_equal(read_encoded(view), codes[..., :3])


def test_exr_channels_are_found_by_name(tmp_path):
    pixels = np.random.default_rng(0).random((24, 32, 4)).astype(np.float32)
    spec = oiio.ImageSpec(32, 24, 4, "float")
    spec.channelnames = ("Z", "B", "G", "R")
    file = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert file.open(str(tmp_path / "a.exr"), spec) and file.write_image(pixels) and file.close()
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr", 32, 24), pixels[..., [3, 2, 1]])


def test_a_missing_picture_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere.png: the picture does not exist"):
        read_image(tmp_path / "nowhere.png", 32, 24)


def test_an_empty_picture_is_called_empty(tmp_path):
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(OSError, match="a.png: the file is empty. Copy it again."):
        read_image(tmp_path / "a.png", 32, 24)


@pytest.mark.parametrize("suffix", ["png", "jpg", "exr"])
@pytest.mark.parametrize("keep", [0.05, 0.5, 0.95, -3])
def test_a_truncated_picture_fails_instead_of_inventing_pixels(tmp_path, suffix, keep):
    pixels = random_codes() if suffix != "exr" else np.ones((24, 32, 3), np.float32)
    path = write(tmp_path / f"cut.{suffix}", pixels)
    data = path.read_bytes()
    path.write_bytes(data[: keep if keep < 0 else int(keep * len(data))])
    with pytest.raises(OSError, match=f"cut.{suffix}: the picture (is truncated|cannot be opened)"):
        read_image(path, 32, 24)


def test_a_file_that_is_no_picture_is_named(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    with pytest.raises(OSError, match="text.png: the picture cannot be opened"):
        read_image(tmp_path / "text.png", 32, 24)


def test_a_size_that_disagrees_names_both_sizes(tmp_path):
    path = write(tmp_path / "a.png", random_codes())
    with pytest.raises(CaptureError, match=r"a.png.*w x h = 24 x 32.*got 32 x 24"):
        read_image(path, 24, 32)


def test_an_unknown_colour_space_lists_the_known_ones(tmp_path):
    path = write(tmp_path / "a.png", random_codes())
    with pytest.raises(CaptureError, match="color_space must be one of srgb, linear, got 'aces'"):
        read_image(path, 32, 24, "aces")


def test_a_mask_is_true_where_it_is_white(tmp_path):
    codes = np.zeros((24, 32, 1), np.uint8)
    codes[:5] = 255
    codes[5:7] = 100
    mask = read_mask(write(tmp_path / "m.png", codes), 32, 24)
    assert mask.dtype == bool and mask[:5].all() and not mask[5:].any()


def test_a_mask_of_another_size_is_that_of_the_nearest_pixels(tmp_path):
    codes = random_codes()
    white = codes.max(axis=-1) >= 128
    path = write(tmp_path / "m.png", codes)
    np.testing.assert_array_equal(read_mask(path, 64, 48), white.repeat(2, 0).repeat(2, 1))
    # The middle of three pixels; 71 rows are those of 72, up to a pixel.
    large = write(tmp_path / "l.png", codes.repeat(3, 0).repeat(3, 1)[:71])
    np.testing.assert_array_equal(read_mask(large, 32, 24), white)


def test_of_an_object_that_was_cut_out_the_opaque_pixels_count(tmp_path):
    codes = np.full((24, 32, 4), 60, np.uint8)
    codes[:5, :, 3] = 255
    mask = read_mask(write(tmp_path / "m.png", codes), 32, 24)
    assert mask[:5].all() and not mask[5:].any()
    # Alpha that is nowhere below half tells nothing, nor does alpha of zero everywhere.
    codes[..., 3], codes[:7, :, :3] = 255, 255
    codes[:, 3, 3] = 200
    mask = read_mask(write(tmp_path / "o.png", codes), 32, 24)
    assert mask[:7].all() and not mask[7:].any()
    codes[..., 3], codes[:7, :, :3] = 0, 255
    mask = read_mask(write(tmp_path / "n.png", codes), 32, 24)
    assert mask[:7].all() and not mask[7:].any()


@pytest.mark.parametrize("size", [(32, 20), (24, 32)])
def test_a_mask_of_another_shape_is_refused_as_a_mask(tmp_path, size):
    path = write(tmp_path / "m.png", random_codes())
    with pytest.raises(CaptureError, match=rf"m.png: the mask must be .* = {size[0]} x .*got 32"):
        read_mask(path, *size)


def test_a_mask_of_a_few_pixels_tells_nothing(tmp_path):
    path = write(tmp_path / "m.png", random_codes()[:3, :4])
    with pytest.raises(CaptureError, match="m.png: the mask must be .* got 4 x 3"):
        read_mask(path, 32, 24)


@pytest.mark.parametrize("background", ["mask", "none"])
@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.filterwarnings("ignore::gaussray.capture.errors.CaptureWarning")
def test_picture_and_mask_are_of_one_reading(tmp_path, monkeypatch, background, masked):
    of = toy.camera(width=32, height=24)
    image = write(tmp_path / "a.png", random_codes(channels=4))
    mask = write(tmp_path / "m.png", random_codes(channels=1)) if masked else None
    view = View(of, image, mask, None, "a", "train", 0.0, "pinhole", None, "srgb", background)
    values, counted = read_encoded(view), visible_pixels(view)
    opened, read = [], read_with_alpha
    monkeypatch.setattr(frames, "read_with_alpha", lambda *a: opened.append(a[0]) or read(*a))
    found, shown = frames.read_with_mask(view)
    np.testing.assert_array_equal(found, values)
    assert opened.count(image) == 1
    assert (shown is None) == (background == "none" and not masked) == counted.all()
    assert shown is None or (shown == counted).all()


def test_frames_of_videos_have_no_alpha_to_be_read(tmp_path, monkeypatch):
    films.film(tmp_path / "v.mp4", films.shades(2))
    image, of = frame_path(tmp_path / "v.mp4", 1), toy.camera()
    view = View(of, image, None, None, "a", "train", 0.0, "pinhole", None, "srgb", "mask")
    # A video would be decoded again, from its start.
    monkeypatch.setattr(frames, "read_with_alpha", None)
    assert visible_pixels(view).all() and visible_pixels(view).shape == (view.height, view.width)


def test_checking_names_every_wrong_picture_at_once(tmp_path):
    path = write(tmp_path / "0.png", random_codes())
    good = Picture(path, 32, 24)
    check_images([good, good])
    with pytest.raises(CaptureError, match="(?s)2 of 3 pictures.*1.png.*got 32 x 24"):
        check_images([good, Picture(tmp_path / "1.png", 32, 24), Picture(path, 8, 8)])


@pytest.mark.parametrize("suffix", ["png", "tif", "exr"])
def test_blocks_of_rows_make_the_whole_picture(tmp_path, monkeypatch, suffix):
    codes = np.random.default_rng(1).integers(0, 256, (150, 8, 4), np.uint8)
    codes[:64, :, 3] = 255
    pixels = codes if suffix != "exr" else (codes / np.float32(255))
    path = write(tmp_path / f"a.{suffix}", pixels)
    whole = read_with_alpha(path, 8, 150, "black")
    monkeypatch.setattr(picture_file, "_BLOCK", 1)
    blocks = read_with_alpha(path, 8, 150, "black")
    np.testing.assert_array_equal(blocks.values, whole.values)
    np.testing.assert_array_equal(blocks.alpha, whole.alpha)
    np.testing.assert_allclose(whole.alpha, codes[..., 3] / 255, atol=1e-6)
    straight = np.round(codes[..., :3] * (codes[..., 3:] / 255))
    expected = straight if suffix != "exr" else codes[..., :3] / 255
    np.testing.assert_allclose(whole.values, expected, atol=1e-6)


def test_reading_a_picture_takes_few_bytes_a_pixel(tmp_path):
    codes = np.full((2000, 2000, 4), 100, np.uint8)
    path = write(tmp_path / "a.png", codes)
    tracemalloc.start()
    read_with_alpha(path, 2000, 2000, "black")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Three bytes of colour and four of alpha, and less than 36 MB for a block of rows.
    assert peak / codes[..., 0].size < 7 + 36e6 / 4e6


def test_floating_point_numbers_are_no_levels(tmp_path):
    path = write(tmp_path / "a.exr", np.full((24, 32, 3), 0.5, np.float32))
    with pytest.raises(CaptureError, match="a.exr: the picture must hold levels .* Save it with 8"):
        read_levels(path, 32, 24)
