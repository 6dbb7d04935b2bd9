"""The table of a PLY file's vertices: what is malformed is named."""

import numpy as np
import pytest

from gaussray.io.ply import read_vertices


ONE = b"ply\nformat ascii 1.0\nelement vertex 1\n"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "must begin with the line 'ply'"),
        (b"\x89PNG\r\n\x1a\n" + bytes(90), "must begin with the line 'ply'"),
        (ONE, "must end with 'end_header'"),
        (b"ply\nformat zip 1.0\nend_header\n", "must be one of ascii, .*got 'zip'"),
        (b"ply\nelement vertex 1\nend_header\n", "must be one of ascii, .*got None"),
        (b"ply\nformat ascii 1.0\nend_header\n", "must have an element vertex"),
        (b"ply\nformat ascii 1.0\nelement vertex three\nend_header\n", "'element vertex three'"),
        (b"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "'element vertex -1'"),
        (b"ply\nproperty float x\nend_header\n", "malformed line: 'property float x'"),
        (ONE + b"property quad x\nend_header\n", "quad x"),
        (ONE + b"property list uchar int x\nend_header\n", "must not have list properties"),
        (ONE + b"property float x\nproperty float x\nend_header\n1 1\n", "vertex is malformed"),
        (ONE + b"property float x\nend_header\nabc\n", "1 rows of 1 numbers, .*'abc'"),
        (ONE + b"property float x\nend_header\n1 2\n", "1 rows of 1 numbers, .*1 rows of 2"),
        (ONE + b"property uchar x\nend_header\n300\n", "x beyond its type uint8"),
        (ONE + b"property uchar x\nend_header\n0.5\n", "x beyond its type uint8"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement face 2\nproperty list uchar int i\n"
            b"element vertex 1\nproperty uchar x\nend_header\n\0",
            "must hold the 2 rows of the header, got 1",
        ),
        (
            b"ply\nformat binary_little_endian 1.0\nelement face 9\nproperty float i\n"
            b"element vertex 1\nproperty uchar x\nend_header\n\0",
            "must hold the 1 rows of the header, got 0",
        ),
    ],
)
def test_a_malformed_file_says_what_is_wrong(tmp_path, content, says):
    path = tmp_path / "bad.ply"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=f"bad.ply: .*{says}"):
        read_vertices(path)


def test_types_are_the_files_own(tmp_path):
    path = tmp_path / "a.ply"
    head = b"ply\nformat ascii 1.0\ncomment one of two\nelement vertex 2\n"
    path.write_bytes(head + b"property uchar a\nproperty double b\nend_header\n255 0.1\n0 nan\n")
    table = read_vertices(path)
    assert table.dtype == np.dtype([("a", "u1"), ("b", "<f8")])
    np.testing.assert_array_equal(table["a"], [255, 0])
    np.testing.assert_array_equal(table["b"], [0.1, np.nan])
