"""The bytes of a picture and its name must agree on what reads it, and its header on its size."""

import shutil

import numpy as np
import OpenImageIO as oiio
import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.picture_file import picture_size, read_stored
from gaussray.io.safe.limits import Limits, limit, limits
from gaussray.io.safe.pictures import open_picture


def write(path, width=4, height=3, channels=3, kind="uint8"):
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), oiio.ImageSpec(width, height, channels, kind))
    file.write_image(np.zeros((height, width, channels), kind))
    file.close()
    return path


@pytest.mark.parametrize("suffix", ["png", "jpg", "jpeg", "tif", "exr", "bmp", "webp", "PNG"])
def test_pictures_of_every_format_are_opened(tmp_path, suffix):
    assert open_picture(write(tmp_path / f"a.{suffix}")).spec().width == 4


# Of files that not every OpenImageIO can write.
BEGINNINGS = {
    "gif": b"GIF89a\x01\x00\x01\x00\x00\x00\x00;",
    "jp2": b"\0\0\0\x0cjP  \r\n\x87\n",
}


@pytest.mark.parametrize("suffix", ["hdr", "tga", "dpx", "gif", "jp2"])
def test_other_formats_are_refused(tmp_path, suffix):
    if suffix in BEGINNINGS:
        (tmp_path / f"a.{suffix}").write_bytes(BEGINNINGS[suffix])
    else:
        write(tmp_path / f"a.{suffix}")
    with pytest.raises(
        OSError, match=f"a.{suffix}: the picture cannot be opened: it is none of PN"
    ):
        open_picture(tmp_path / f"a.{suffix}")


@pytest.mark.parametrize("name", ["a.jpg", "a.tga", "a.null", "a", "a?b.png"])
def test_a_picture_under_another_name_is_refused(tmp_path, name):
    """OpenImageIO chooses a reader by the name, and one called null makes pictures of any size."""
    shutil.copy(write(tmp_path / "real.png"), tmp_path / name)
    rule = "must not contain a question mark" if "?" in name else "must end in .png. Rename"
    with pytest.raises(OSError, match=f"its name {rule}"):
        open_picture(tmp_path / name)


def test_the_size_that_a_header_tells_is_held_against_the_limits(tmp_path):
    """A bomb: 64 megapixels of one colour in less than a hundredth of the bytes."""
    path, before = write(tmp_path / "a.png", 8000, 8000, 1), limits()
    assert path.stat().st_size < 640_000
    try:
        limit(Limits(picture=63.9))
        with pytest.raises(CaptureError, match="a.png: its megapixels must be at most limits.pict"):
            picture_size(path)
        limit(Limits(channels=4))
        with pytest.raises((ValueError, OSError), match="b.exr: "):
            open_picture(write(tmp_path / "b.exr", channels=5, kind="float"))
    finally:
        limit(before)


def test_a_header_of_more_than_the_file_can_hold_is_refused(tmp_path):
    path = write(tmp_path / "a.png", 4, 3)
    data = bytearray(path.read_bytes())
    data[16:24] = (2**31 - 1).to_bytes(4, "big") * 2
    path.write_bytes(bytes(data))
    with pytest.raises((OSError, CaptureError), match="a.png: "):
        read_stored(path, 2**31 - 1, 2**31 - 1)


def test_a_header_with_any_byte_changed_is_read_or_refused(tmp_path):
    """Where a name is no text, the library's own message of it is none either."""
    path = write(tmp_path / "a.exr", channels=3, kind="float")
    good, refused = path.read_bytes(), 0
    for at in range(8, 330):
        path.write_bytes(good[:at] + b"\x87" + good[at + 1 :])
        try:
            read_stored(path, 4, 3)
        except (OSError, CaptureError) as error:
            refused += 1
            assert str(error).startswith(str(path)) and len(str(error)) < 1000
    assert refused > 100
