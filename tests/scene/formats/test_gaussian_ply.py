"""A model of 3D Gaussian Splatting is read as it was meant, written as it is read, or refused."""

import os

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

from gaussray.scene.formats.gaussian_ply import RESTS, read_gaussians, write_gaussians
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import radiance


# Half a unit in the last place of single precision.
HALF = 2.0**-24
# One rounding to single precision, of a value computed in double precision.
ROUNDED = 2 * HALF
# Logarithms here are below 32 in size, and a stored one is rounded to 24 bits.
LOGARITHM = 32 * HALF
# Sixteen products in single precision, of coefficients and harmonics up to about 3.
SUM = 1e-5


def names(degree, normals=True):
    """The properties in the order of the standard."""
    rest = [f"f_rest_{i}" for i in range(RESTS[degree])]
    color = [f"f_dc_{i}" for i in range(3)] + rest
    shape = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    return ["x", "y", "z", *(["nx", "ny", "nz"] if normals else []), *color, *shape]


def model(degree=3, count=7, seed=0, order=None):
    """Records of stored values; each property is a column."""
    draw = np.random.default_rng(seed)
    order = order or names(degree)
    table = np.empty(count, [(name, "<f4") for name in order])
    for name in sorted(order):
        table[name] = draw.normal(size=count)
    return table


def write(path, table, form="binary_little_endian", head=(), tail=()):
    """A writer that shares nothing with ours."""
    words = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}
    lines = ["ply", f"format {form} 1.0", "comment a test", *head, f"element vertex {len(table)}"]
    for name in table.dtype.names:
        lines.append(f"property {words[table.dtype[name].str[1:]]} {name}")
    text = "\n".join([*lines, *tail, "end_header", ""]).encode()
    if form == "ascii":
        rows = [" ".join(repr(x.item()) for x in row) for row in table]
        path.write_bytes(text + "\n".join([*rows, ""]).encode())
    else:
        code = "<" if form.endswith("little_endian") else ">"
        path.write_bytes(text + table.astype(table.dtype.newbyteorder(code)).tobytes())
    return path


def same(a, b, rtol=0.0):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.dtype == y.dtype == jnp.float32
        np.testing.assert_allclose(x, y, rtol=rtol)


@pytest.mark.parametrize("degree", range(4))
def test_every_value_is_what_the_standard_says(tmp_path, degree):
    table = model(degree)
    found = read_gaussians(write(tmp_path / "a.ply", table))
    wide = {name: table[name].astype(np.float64) for name in table.dtype.names}
    np.testing.assert_array_equal(found.mean, np.stack([table[x] for x in "xyz"], axis=1))
    np.testing.assert_allclose(found.opacity, 1 / (1 + np.exp(-wide["opacity"])), rtol=ROUNDED)
    scale = np.exp(np.stack([wide[f"scale_{i}"] for i in range(3)], axis=1))
    np.testing.assert_allclose(found.scale, scale, rtol=ROUNDED)
    quat = np.stack([wide[f"rot_{i}"] for i in range(4)], axis=1)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    np.testing.assert_allclose(found.quat, quat, rtol=ROUNDED)
    assert found.harmonics.shape == (7, (degree + 1) ** 2, 3) and found.tint is None
    per_channel = (degree + 1) ** 2 - 1
    for channel in range(3):
        np.testing.assert_array_equal(found.harmonics[:, 0, channel], table[f"f_dc_{channel}"])
        for i in range(per_channel):
            stored = table[f"f_rest_{channel * per_channel + i}"]
            np.testing.assert_array_equal(found.harmonics[:, 1 + i, channel], stored)


def test_colours_are_those_of_the_definition(tmp_path):
    """f_rest 0 to 14 are the red coefficients of degree 1 (-1, 0, 1), then 2, then 3."""
    table = model()
    found = read_gaussians(write(tmp_path / "a.ply", table))
    way = np.random.default_rng(1).normal(size=(20, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    pairs = [(level, order) for level in range(4) for order in range(-level, level + 1)]
    value = {pair: reference.harmonic(*pair, way) for pair in pairs}
    expected = np.empty((20, 7, 3))
    for channel in range(3):
        total = 0.5 + np.outer(value[0, 0], table[f"f_dc_{channel}"])
        for i, pair in enumerate(pairs[1:]):
            total = total + np.outer(value[pair], table[f"f_rest_{15 * channel + i}"])
        expected[..., channel] = np.maximum(total, 0)
    moved = jnp.moveaxis(found.harmonics, 0, -1)[..., None, :]
    seen = jax.jit(radiance)(jnp.broadcast_to(moved, (16, 3, 20, 7)), jnp.asarray(way.T)[..., None])
    np.testing.assert_allclose(jnp.moveaxis(seen, 0, -1), expected, atol=SUM)


def test_known_values_in_closed_form(tmp_path):
    table = np.zeros(1, [(name, "<f4") for name in names(0, normals=False)])
    table["scale_1"], table["rot_3"] = np.log(2), -0.25
    found = read_gaussians(write(tmp_path / "a.ply", table))
    assert found.opacity[0] == 0.5
    np.testing.assert_allclose(found.scale[0], [1, 2, 1], rtol=ROUNDED)
    np.testing.assert_array_equal(found.quat[0], [0, 0, 0, -1])
    table["rot_3"] = 0
    found = read_gaussians(write(tmp_path / "a.ply", table))
    np.testing.assert_array_equal(found.quat[0], [1, 0, 0, 0])


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_order_of_properties_format_and_what_is_unknown_do_not_matter(tmp_path, form):
    plain = read_gaussians(write(tmp_path / "plain.ply", model()))
    order = [*names(3, normals=False), "confidence", "semantic_0"]
    shuffled = list(np.random.default_rng(2).permutation(order))
    base, table = model(), np.zeros(7, [(str(name), "<f4") for name in shuffled])
    for name in names(3, normals=False):
        table[name] = base[name]
    tail = ["element face 0", "property list uchar int vertex_indices"]
    same(read_gaussians(write(tmp_path / "b.ply", table, form, tail=tail)), plain)


def test_elements_before_the_vertices_are_passed_over(tmp_path):
    path = write(tmp_path / "a.ply", model(0), head=["element camera 2", "property double fov"])
    content = path.read_bytes()
    split = content.index(b"end_header\n") + len(b"end_header\n")
    path.write_bytes(content[:split] + bytes(16) + content[split:])
    same(read_gaussians(path), read_gaussians(write(tmp_path / "b.ply", model(0))))


def test_double_precision_is_read_too(tmp_path):
    table = model(1)
    wide = table.astype([(name, "<f8") for name in table.dtype.names])
    same(
        read_gaussians(write(tmp_path / "a.ply", wide)),
        read_gaussians(write(tmp_path / "b", table)),
    )


@pytest.mark.parametrize("degree", range(4))
def test_a_round_trip_is_exact_to_rounding(tmp_path, degree):
    first = read_gaussians(write(tmp_path / "a.ply", model(degree, count=50)))
    write_gaussians(tmp_path / "deep" / "b.ply", first)
    again = read_gaussians(tmp_path / "deep" / "b.ply")
    same(again, first, rtol=LOGARITHM)
    np.testing.assert_array_equal(again.harmonics, first.harmonics)
    np.testing.assert_array_equal(again.mean, first.mean)


def test_what_is_written_has_the_standard_layout(tmp_path):
    path = tmp_path / "a.ply"
    write_gaussians(path, read_gaussians(write(tmp_path / "b.ply", model(3))))
    head, _, data = path.read_bytes().partition(b"end_header\n")
    listed = ["ply", "format binary_little_endian 1.0", "element vertex 7"]
    assert head.decode().splitlines() == listed + [f"property float {x}" for x in names(3)]
    table = np.frombuffer(data, [(name, "<f4") for name in names(3)])
    stored = model(3)
    for name in names(3):
        if name.startswith("rot_"):
            continue
        expected = 0 if name in ("nx", "ny", "nz") else stored[name]
        # exp and log of numbers around 1: the absolute error is that of the rounded exponential.
        np.testing.assert_allclose(table[name], expected, rtol=ROUNDED, atol=LOGARITHM)


def test_the_extremes_of_opacity_and_scale_stay_finite(tmp_path):
    one = jnp.ones((4, 3), jnp.float32)
    scale = one * jnp.asarray([0, 1e-38, 1, 3e38], jnp.float32)[:, None]
    opacity = jnp.asarray([0, 1, 1e-30, 1 - 2.0**-24], jnp.float32)
    quat = jnp.asarray([[0, 0, 0, 0], [1e-30, 0, 0, 0], [1e30, 0, 0, 0], [1, 0, 0, 0]], jnp.float32)
    write_gaussians(tmp_path / "a.ply", Gaussians(one, quat, scale, opacity, one[:, None]))
    found = read_gaussians(tmp_path / "a.ply")
    tiny = 2 * float(np.finfo(np.float32).tiny)
    # The largest logarithm of single precision is 89.
    np.testing.assert_allclose(found.scale[:, 0], [tiny, tiny, 1, 3e38], rtol=89 * ROUNDED)
    assert np.all(found.scale > 0)
    below = 1 - 2.0**-24
    np.testing.assert_allclose(found.opacity, [tiny, below, 1e-30, below], rtol=89 * ROUNDED)
    np.testing.assert_array_equal(found.quat, [[1, 0, 0, 0]] * 4)


@pytest.mark.parametrize("missing", ["y", "f_dc_1", "opacity", "scale_2", "rot_0"])
def test_a_missing_property_is_named(tmp_path, missing):
    order = [name for name in names(0) if name != missing]
    path = write(tmp_path / "a.ply", model(order=order))
    with pytest.raises(
        ValueError, match=f"a.ply: element vertex must have the property {missing},"
    ):
        read_gaussians(path)


@pytest.mark.parametrize("count", [1, 8, 44, 46, 72])
def test_a_number_of_harmonics_that_no_degree_has(tmp_path, count):
    order = names(0) + [f"f_rest_{i}" for i in range(count)]
    path = write(tmp_path / "a.ply", model(order=order))
    with pytest.raises(ValueError, match=f"f_rest must be 0, 9, 24 or 45 .* got {count}"):
        read_gaussians(path)


def test_harmonics_with_a_gap(tmp_path):
    order = names(0) + [f"f_rest_{i}" for i in range(10) if i != 4]
    with pytest.raises(ValueError, match="without gaps, got no f_rest_4"):
        read_gaussians(write(tmp_path / "a.ply", model(order=order)))


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
def test_truncated_data(tmp_path, form):
    path = write(tmp_path / "a.ply", model(1), form)
    content = path.read_bytes()
    cut = len(content) - 1 if form != "ascii" else content.rindex(b"\n", 0, -1)
    path.write_bytes(content[:cut])
    # The last line of text lost its newline alone, so that one more goes.
    if form == "ascii":
        path.write_bytes(content[: content.rindex(b"\n", 0, cut)])
    with pytest.raises(ValueError, match="7 rows of the header, got [56]; the file is truncated"):
        read_gaussians(path)


def test_a_count_beyond_the_file_takes_no_memory(tmp_path):
    path = write(tmp_path / "a.ply", model(0))
    path.write_bytes(path.read_bytes().replace(b"vertex 7", b"vertex 999999999999999"))
    with pytest.raises(ValueError, match="got 7; the file is truncated"):
        read_gaussians(path)


def test_rows_of_text_that_are_not_the_numbers_of_the_header(tmp_path):
    path = write(tmp_path / "a.ply", model(0, count=2), "ascii")
    good = path.read_bytes()
    for bad in (
        good[:-1] + b" 5\n",
        good[:-3] + b"x\n",
        good.replace(b"end_header\n", b"end_header\n\n"),
    ):
        path.write_bytes(bad)
        with pytest.raises(ValueError, match="must be 2 rows of 17 numbers"):
            read_gaussians(path)


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="none.ply: no such file"):
        read_gaussians(tmp_path / "none.ply")


@pytest.mark.parametrize("form", ["binary_little_endian", "ascii"])
@pytest.mark.parametrize(
    ("name", "value"),
    [("x", np.nan), ("opacity", np.inf), ("scale_1", 100), ("scale_1", -200), ("rot_2", np.inf),
     ("f_dc_0", -np.inf), ("f_rest_3", np.nan)],
)  # fmt: skip
def test_what_is_not_finite_is_dropped_and_counted(tmp_path, form, name, value):
    table = model(1)
    whole = read_gaussians(write(tmp_path / "a.ply", table))
    table[name][[2, 5]] = value
    with pytest.warns(UserWarning, match="2 of 7 Gaussians are not finite"):
        found = read_gaussians(write(tmp_path / "b.ply", table, form))
    same(found, jax.tree.map(lambda x: x[np.array([0, 1, 3, 4, 6])], whole))


@pytest.mark.parametrize("count", [0, 3])
def test_a_model_of_which_nothing_is_left_is_refused(tmp_path, count):
    table = model(0, count=count)
    table["z"] = np.nan
    with pytest.raises(
        ValueError, match=f"at least one Gaussian must be finite, got none of {count}"
    ):
        read_gaussians(write(tmp_path / "a.ply", table))


def test_what_the_layout_cannot_hold_is_refused(tmp_path):
    good = read_gaussians(write(tmp_path / "a.ply", model(0)))
    parts = {
        name: getattr(good, name) for name in ("mean", "quat", "scale", "opacity", "harmonics")
    }
    refused = {
        "without tint": {"tint": good.mean},
        "at one instant": {name: parts[name][None] for name in ("mean", "quat", "scale")},
        "opacity must be finite": {"opacity": good.opacity.at[3].set(jnp.nan)},
        "scale must be finite": {"scale": good.scale.at[3].set(jnp.inf)},
    }
    for message, changes in refused.items():
        with pytest.raises(ValueError, match=message):
            write_gaussians(tmp_path / "b.ply", Gaussians(**(parts | changes)))
    two = eqx.tree_at(lambda g: g.harmonics, good, jnp.tile(good.harmonics, (1, 2, 1)))
    with pytest.raises(ValueError, match="harmonics must be 1, 4, 9 or 16, got 2"):
        write_gaussians(tmp_path / "b.ply", two)
    assert os.listdir(tmp_path) == ["a.ply"]


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    good = read_gaussians(write(tmp_path / "a.ply", model(0)))
    before = (tmp_path / "a.ply").read_bytes()

    def full(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match="a.ply: cannot be written: disk full"):
        write_gaussians(tmp_path / "a.ply", good)
    assert (tmp_path / "a.ply").read_bytes() == before
    assert os.listdir(tmp_path) == ["a.ply"]
