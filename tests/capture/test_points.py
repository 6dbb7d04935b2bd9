"""Starting points: every kind of PLY that occurs, and every way to be broken."""

import numpy as np
import pytest

from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.points import read_points
from gaussray.color import srgb_decode


POSITION = np.array([[0.5, -1, 2], [3, 4, 5.25], [-6, 7, 8]])
CODES = np.array([[0, 128, 255], [10, 20, 30], [1, 2, 3]], np.uint8)
LINEAR = srgb_decode(CODES / 255)
TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}


def table(**columns):
    """Structured rows from name=(type, values), in this order."""
    rows = np.empty(3, [(name, kind) for name, (kind, _) in columns.items()])
    for name, (_, values) in columns.items():
        rows[name] = values
    return rows


def standard(kind="u1", colors=CODES):
    xyz = {name: ("f4", POSITION[:, k]) for k, name in enumerate("xyz")}
    return table(**xyz, **{n: (kind, colors[:, k]) for k, n in enumerate(("red", "green", "blue"))})


def write(path, rows, form="binary_little_endian", before="", data_before=b"", after=""):
    lines = ["ply", f"format {form} 1.0", "comment made by hand", *before.splitlines()]
    lines += [f"element vertex {len(rows)}"]
    kinds = [(n, TYPES[rows.dtype[n].str[1:]]) for n in rows.dtype.names]
    lines += [f"property {kind} {name}" for name, kind in kinds] + after.splitlines()
    header = "\n".join([*lines, "end_header", ""]).encode()
    if form == "ascii":
        data = "".join(" ".join(str(v) for v in row) + "\n" for row in rows.tolist()).encode()
    else:
        order = ">" if "big" in form else "<"
        data = rows.astype(rows.dtype.newbyteorder(order)).tobytes()
    path.write_bytes(header + data_before + data)
    return path


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_every_format_gives_the_same_points(tmp_path, form):
    points = read_points(write(tmp_path / "p.ply", standard(), form))
    np.testing.assert_array_equal(points.position, POSITION)
    np.testing.assert_allclose(points.color, LINEAR, rtol=1e-6)
    assert points.position.dtype == points.color.dtype == np.float32


def test_order_of_properties_and_extra_ones_do_not_matter(tmp_path):
    rows = table(
        blue=("u1", CODES[:, 2]),
        z=("f8", POSITION[:, 2]),
        nx=("f4", 0),
        red=("u1", CODES[:, 0]),
        y=("f8", POSITION[:, 1]),
        green=("u1", CODES[:, 1]),
        x=("f8", POSITION[:, 0]),
        label=("i4", 7),
    )
    points = read_points(write(tmp_path / "p.ply", rows))
    np.testing.assert_array_equal(points.position, POSITION)
    np.testing.assert_allclose(points.color, LINEAR, rtol=1e-6)


def test_float_colours_are_linear_light(tmp_path):
    points = read_points(write(tmp_path / "p.ply", standard("f4", LINEAR)))
    np.testing.assert_allclose(points.color, LINEAR, rtol=1e-6)


def test_float_colours_that_look_like_codes_are_warned_of(tmp_path):
    with pytest.warns(CaptureWarning, match="p.ply.*linear light, and the largest is 255"):
        read_points(write(tmp_path / "p.ply", standard("f4", CODES)))


def test_sixteen_bit_colours_are_srgb(tmp_path):
    points = read_points(write(tmp_path / "p.ply", standard("u2", CODES.astype(int) * 257)))
    np.testing.assert_allclose(points.color, LINEAR, rtol=1e-6)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_elements_before_and_after_the_vertices_are_passed_over(tmp_path, form):
    before = "element face 2\nproperty list uchar int vertex_indices\nproperty float weight"
    after = "element edge 0\nproperty int a"
    big = "big" in form
    data = b"".join(
        bytes([n]) + np.arange(n + 1, dtype=">i4" if big else "<i4").tobytes() for n in (3, 2)
    )
    data = b"3 0 1 2 0.5\n2 0 1 0.5\n" if form == "ascii" else data
    path = write(tmp_path / "p.ply", standard(), form, before, data, after)
    np.testing.assert_array_equal(read_points(path).position, POSITION)


def test_points_without_colours_are_gray_with_a_warning(tmp_path):
    rows = table(**{name: ("f4", POSITION[:, k]) for k, name in enumerate("xyz")})
    with pytest.warns(CaptureWarning, match="p.ply: the points have no red"):
        points = read_points(write(tmp_path / "p.ply", rows))
    assert (points.color == 0.5).all()


def test_points_that_are_not_finite_are_counted_and_dropped(tmp_path):
    rows = standard()
    rows["y"][1] = np.nan
    with pytest.warns(CaptureWarning, match="p.ply: 1 of 3 points are not finite"):
        points = read_points(write(tmp_path / "p.ply", rows))
    np.testing.assert_array_equal(points.position, POSITION[[0, 2]])


def test_no_finite_point_at_all_is_an_error(tmp_path):
    rows = standard()
    rows["x"] = np.inf
    with pytest.raises(CaptureError, match="at least one point must be finite"):
        read_points(write(tmp_path / "p.ply", rows))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_truncated_data_says_how_many_rows_there_are(tmp_path, form):
    path = write(tmp_path / "p.ply", standard(), form)
    data = path.read_bytes()
    cut = data.index(b"3.0 4.0") if form == "ascii" else len(data) - 16
    path.write_bytes(data[:cut])
    with pytest.raises(CaptureError, match="p.ply.*must hold the 3 rows.*got 1"):
        read_points(path)


def test_a_malformed_file_is_an_error_of_the_capture(tmp_path):
    (tmp_path / "bad.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"
    )
    with pytest.raises(CaptureError, match="bad.ply: .*no y"):
        read_points(tmp_path / "bad.ply")
    (tmp_path / "bad.ply").write_bytes(b"plx\n")
    with pytest.raises(CaptureError, match="bad.ply: .*must begin with the line 'ply'"):
        read_points(tmp_path / "bad.ply")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="none.ply"):
        read_points(tmp_path / "none.ply")
