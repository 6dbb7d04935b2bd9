"""Binary PGM and PPM pictures are read, and refused where their header is another than the file."""

import os

import numpy as np
import pytest

from gaussray.capture.errors import CaptureError
from gaussray.capture.picture_file import read_stored
from gaussray.io.safe.netpbm import check_netpbm
from gaussray.io.safe.pictures import open_picture


PIXELS = bytes(range(12))


def written(path, content):
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("name", "content", "most"),
    [
        ("a.pgm", b"P5\n4 3\n255\n" + PIXELS, 255),
        ("a.pnm", b"P5 # a comment\n#another\n4\t3\n15\n" + PIXELS, 15),
        ("a.pgm", b"P5 4 3 4095\n" + np.arange(12, dtype=">u2").tobytes(), 4095),
        ("A.PPM", b"P6\n4 1\n255\n" + PIXELS, 255),
        ("a.pnm", b"P6\n4 1\n65535\n" + np.arange(12, dtype=">u2").tobytes() + b"\n", 65535),
    ],
)
def test_levels_are_those_of_the_file(tmp_path, name, content, most):
    spec = open_picture(written(tmp_path / name, content)).spec()
    values = read_stored(tmp_path / name, spec.width, spec.height)
    assert spec.nchannels == (3 if b"P6" in content else 1)
    full = np.iinfo(values.dtype).max
    own = values if spec.nchannels == 3 else values[..., :1]
    assert own.reshape(12) / full == pytest.approx(np.arange(12) / most, abs=0.6 / full)


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (b"P5\n4 3\n255\n" + PIXELS[:11], "must hold 12 bytes of pixels, got 11"),
        (b"P5\n4 3\n256\n" + PIXELS, "must hold 24 bytes of pixels, got 12"),
        (b"P5\n4 3\n255\n" + bytes(9999), "alone in its file, 12 bytes of pixels, got 9999"),
        (b"P5\n99999 99999\n255\n" + PIXELS, "megapixels must be at most limits.picture"),
        (b"P5\n999999999 1\n255\n" + PIXELS, "megapixels must be at most limits.picture"),
        (b"P5\n99999999999 1\n255\n" + PIXELS, "its header is damaged"),
        (b"P5\n0 3\n255\n" + PIXELS, "must have pixels"),
        (b"P5\n4 3\n0\n" + PIXELS, "must have pixels"),
        (b"P5\n4 3\n65536\n" + PIXELS, "must have pixels"),
        (b"P5\n-4 3\n255\n" + PIXELS, "its header is damaged"),
        (b"P5\n4 3\n255", "its header is damaged"),
        (b"P5\n#" + b"a" * 9999 + b"\n4 3\n255\n" + PIXELS, "its header is damaged"),
        (b"P5" + b" #\n" * 3000, "its header is damaged"),
        (b"P5" + b" " * 3000 + b"x", "its header is damaged"),
        (b"P54 3 255 " + PIXELS, "its header is damaged"),
        (b"P2\n4 3\n255\n1 2 3 4 5 6 7 8 9 10 11 12", "none of PNG.*binary PGM, binary PPM"),
        (b"P6\n4 1\n255\n" + PIXELS, "binary PPM file, so its name must end in .ppm or .pnm"),
        (b"Pf\n4 3\n-1\n" + bytes(48), "none of PNG"),
    ],
)
def test_hostile_headers_are_refused(tmp_path, content, rule):
    with pytest.raises((OSError, ValueError), match=f"a.pgm: .*{rule}"):
        open_picture(written(tmp_path / "a.pgm", content))


def test_a_file_of_a_terabyte_is_not_read(tmp_path):
    """OpenImageIO would take all of it into memory."""
    path = written(tmp_path / "a.pgm", b"P5\n4 3\n255\n" + PIXELS)
    os.truncate(path, 1 << 40)
    with pytest.raises(OSError, match="alone in its file"):
        check_netpbm(path)


def test_a_header_with_any_byte_changed_is_read_or_refused(tmp_path):
    path, good, refused = tmp_path / "a.pgm", b"P5\n4 3\n255\n" + PIXELS, 0
    for at in range(11):
        for byte in range(256):
            path.write_bytes(good[:at] + bytes([byte]) + good[at + 1 :])
            try:
                read_stored(path, 4, 3)
            except (OSError, CaptureError) as error:
                refused += 1
                assert str(error).startswith(str(path)) and len(str(error)) < 1000
    assert refused > 2000
