"""SPZ and .splat files; other programs' readers agree where they are installed."""

import gzip
import shutil
import subprocess
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from splats import gaussians, turned

from gaussray.scene.formats.gaussian_folder import read_model
from gaussray.scene.formats.gaussian_ply import read_gaussians, write_gaussians
from gaussray.scene.formats.splat_file import read_splat
from gaussray.scene.formats.spz import MAGIC, read_spz, write_spz
from gaussray.scene.gaussians import Gaussians


# Half a step of each column: positions, opacities, log scales, colours, harmonics.
PLACE, LEVEL, THICKNESS, COLOR, REST = 2**-13, 0.5 / 255, 1 / 32, 0.5 / 255 / 0.15, 0.5 / 128
# Rounding of single precision, relative.
ROUNDING = 1e-6
# One minus the product of two quaternions of nine bits a component.
TURN = 1e-5
# Without the time of day: bytes name tests, and all processes must give them the same names.
packed = partial(gzip.compress, mtime=0)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_what_is_read_is_what_was_written_to_half_a_step(tmp_path, coefficients, version):
    if version == 4:
        pytest.importorskip("zstandard", reason="an extra")
    true = gaussians(coefficients=coefficients)
    write_spz(tmp_path / "a.spz", true, version)
    found = read_spz(tmp_path / "a.spz")
    assert np.abs(found.mean - true.mean).max() <= PLACE * (1 + ROUNDING) + ROUNDING
    assert np.abs(found.opacity - true.opacity).max() <= LEVEL + ROUNDING
    assert np.abs(np.log(found.scale / true.scale)).max() <= THICKNESS + 1e-5
    off = np.abs(found.harmonics - true.harmonics)
    assert off[:, 0].max() <= COLOR + ROUNDING and off[:, 1:].max(initial=0) <= REST + ROUNDING
    assert turned(found, true) < TURN


def test_version_2_has_three_bytes_of_rotation(tmp_path):
    head = MAGIC + np.array([2, 1], "<u4").tobytes() + bytes([0, 12, 0, 0])
    place = np.array([4096, 2 * 4096, -4096], "<i4").view(np.uint8).reshape(3, 4)[:, :3].tobytes()
    columns = place + bytes([128, 0, 128, 255, 160, 160, 160, 255, 128, 128])
    (tmp_path / "a.spz").write_bytes(packed(head + columns))
    found = read_spz(tmp_path / "a.spz")
    # Right, up, back becomes right, down, forward.
    assert found.mean[0] == pytest.approx([1, -2, 1])
    assert found.scale[0] == pytest.approx([1, 1, 1])
    assert found.quat[0] == pytest.approx([0, 1, 0, 0], abs=0.01)
    assert found.opacity[0] == pytest.approx(128 / 255)


@pytest.mark.parametrize("version", [2, 3])
def test_what_is_not_packed_is_read_as_what_is(tmp_path, version):
    rotation = np.random.default_rng(0).integers(0, 256, (5, 3 if version == 2 else 4), np.uint8)
    rotation[:, 0] |= 1
    head = MAGIC + np.array([version, 5], "<u4").tobytes() + bytes([1, 12, 0, 0])
    rest = [np.arange(5 * width, dtype=np.uint8).tobytes() for width in (9, 1, 3, 3)]
    content = head + b"".join([*rest, rotation.tobytes(), bytes(range(45))])
    (tmp_path / "a.spz").write_bytes(content)
    (tmp_path / "b.spz").write_bytes(packed(content))
    plain, unpacked = read_spz(tmp_path / "a.spz"), read_spz(tmp_path / "b.spz")
    for name in ("mean", "quat", "scale", "opacity", "harmonics"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(unpacked, name))
    for wrong in (content[:-1], content + b"x"):
        (tmp_path / "a.spz").write_bytes(wrong)
        with pytest.raises(ValueError, match="must hold 5 Gaussians, at least one; it is cut off"):
            read_spz(tmp_path / "a.spz")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (MAGIC + np.array([2, 2**31], "<u4").tobytes() + bytes(4), "millions of Gaussians"),
        (MAGIC + np.array([1, 1], "<u4").tobytes() + bytes(4), "got version 1"),
        (b"ply", "packed by gzip"),
        (packed(b"what is this, a file?"), "magic NGSP"),
        (packed(MAGIC + np.array([4, 1], "<u4").tobytes() + bytes(4)), "got version 4"),
        (packed(MAGIC + np.array([3, 9], "<u4").tobytes() + bytes(4)), "cut off"),
        (packed(b"x" * 1000)[:-12], "cut off"),
    ],
)
def test_what_is_no_spz_is_refused(tmp_path, content, message):
    (tmp_path / "a.spz").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_spz(tmp_path / "a.spz")


def test_positions_that_have_no_room_are_refused(tmp_path):
    far = gaussians(count=1)
    far = Gaussians(far.mean + 3000, far.quat, far.scale, far.opacity, far.harmonics)
    with pytest.raises(ValueError, match="within 2048 units"):
        write_spz(tmp_path / "a.spz", far)


def test_numbers_that_have_no_room_are_told(tmp_path):
    some = gaussians(count=2)
    large = Gaussians(
        some.mean, some.quat, some.scale.at[1].set(1000), some.opacity, some.harmonics
    )
    with pytest.warns(UserWarning, match=r"no room for scales \(4.5e-5 to 380\) of 50 %"):
        write_spz(tmp_path / "a.spz", large)


def splat_bytes(count=50):
    rng = np.random.default_rng(1)
    table = np.zeros(count, [("x", "<f4", 6), ("rgba", "u1", 4), ("quat", "u1", 4)])
    table["x"] = np.exp(rng.normal(size=(count, 6)))
    table["rgba"], table["quat"] = rng.integers(1, 255, (2, count, 4))
    return table


def test_a_splat_file_is_32_bytes_for_each_gaussian(tmp_path):
    table = splat_bytes()
    (tmp_path / "a.splat").write_bytes(table.tobytes())
    found, field, _ = read_model(tmp_path / "a.splat")
    assert field is None and found.mean == pytest.approx(table["x"][:, :3])
    assert found.scale == pytest.approx(table["x"][:, 3:])
    assert found.opacity == pytest.approx(table["rgba"][:, 3] / 255)
    shown = 0.5 + 0.28209479177387814 * np.asarray(found.harmonics[:, 0])
    assert shown == pytest.approx(table["rgba"][:, :3] / 255, abs=ROUNDING)
    (tmp_path / "a.splat").write_bytes(table.tobytes()[:-1])
    with pytest.raises(ValueError, match="32 bytes for each Gaussian"):
        read_splat(tmp_path / "a.splat")


def version_4(path):
    """The bytes of a file of version 4, whose table of columns begins at byte 32."""
    pytest.importorskip("zstandard", reason="an extra")
    write_spz(path, gaussians(count=3), 4)
    return bytearray(path.read_bytes())


def test_version_4_has_a_plain_header_and_a_table_of_its_columns(tmp_path):
    content = version_4(tmp_path / "a.spz")
    assert content[:4] == MAGIC and list(content[4:16]) == [4, 0, 0, 0, 3, 0, 0, 0, 3, 12, 0, 6]
    table = np.frombuffer(content, "<u8", 12, 32).reshape(6, 2)
    assert table[:, 1].tolist() == [27, 3, 9, 9, 12, 135]
    assert len(content) == 32 + 16 * 6 + table[:, 0].sum()


def test_extensions_of_version_4_are_skipped_but_other_axes_refused(tmp_path):
    content = version_4(tmp_path / "a.spz")
    true = read_spz(tmp_path / "a.spz")
    for kind, message in ((0xADBE0002, None), (0xADBE0003, "SPZ_ADOBE_coordinate_system")):
        record = np.array([kind, 4, 7], "<u4").tobytes()
        longer = content[:32] + record + content[32:]
        longer[14], longer[16] = 2, 32 + len(record)
        (tmp_path / "b.spz").write_bytes(longer)
        if message is None:
            np.testing.assert_array_equal(read_spz(tmp_path / "b.spz").mean, true.mean)
        else:
            with pytest.raises(ValueError, match=message):
                read_spz(tmp_path / "b.spz")


def test_a_damaged_version_4_is_refused(tmp_path):
    content, path = version_4(tmp_path / "a.spz"), tmp_path / "b.spz"
    for cut in (3, 20, 40, 130, len(content) - 1):
        path.write_bytes(content[:cut])
        with pytest.raises(ValueError, match="SPZ|cut off|damaged|gzip"):
            read_spz(path)
    for place, value in ((32 + 8, 1), (8, 200), (15, 9), (32 + 16 * 6 + 1, 255), (12, 4)):
        damaged = content.copy()
        damaged[place] = value
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="a column|cut off|must hold|version"):
            read_spz(path)


def half_turned(model):
    """Gaussians of other axes: y and z change sign."""
    flip = np.array([1, -1, -1])
    # Harmonics that are odd in y and z together, up to degree 3.
    odd = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])
    quat = np.asarray(model.quat) * [1, *flip]
    harmonics = np.asarray(model.harmonics) * odd[: model.harmonics.shape[1], None]
    parts = np.asarray(model.mean) * flip, quat, model.scale, model.opacity, harmonics
    return Gaussians(*(jnp.asarray(part, jnp.float32) for part in parts))


INSTALL = "npm install -g @playcanvas/splat-transform@3"


@pytest.mark.skipif(not shutil.which("splat-transform"), reason=INSTALL)
def test_version_4_of_another_writer_is_read(tmp_path):
    """splat-transform packs a PLY file in its own axes."""
    pytest.importorskip("zstandard", reason="an extra")
    true = gaussians()
    write_gaussians(tmp_path / "a.ply", true)
    command = ["splat-transform", "-w", str(tmp_path / "a.ply"), str(tmp_path / "a.spz")]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    found = half_turned(read_spz(tmp_path / "a.spz"))
    np.testing.assert_allclose(found.mean, true.mean, atol=2 * PLACE + ROUNDING)
    np.testing.assert_allclose(found.opacity, true.opacity, atol=2 * LEVEL)
    np.testing.assert_allclose(np.log(found.scale / true.scale), 0, atol=2.1 * THICKNESS)
    np.testing.assert_allclose(found.harmonics[:, 0], true.harmonics[:, 0], atol=2.1 * COLOR)
    # It keeps four or five bits of the others.
    np.testing.assert_allclose(found.harmonics[:, 1:], true.harmonics[:, 1:], atol=1 / 16 + 1 / 128)
    assert turned(found, true) < TURN


@pytest.mark.skipif(not shutil.which("splat-transform"), reason=INSTALL)
@pytest.mark.parametrize("kind", ["spz3", "spz4", "splat"])
def test_another_reader_reads_the_same(tmp_path, kind):
    """splat-transform keeps the axes that an SPZ file has: right, up, back."""
    path = tmp_path / f"a.{kind.rstrip('34')}"
    if kind != "splat":
        if kind == "spz4":
            pytest.importorskip("zstandard", reason="an extra")
        write_spz(path, gaussians(), int(kind[-1]))
        found = read_spz(path)
    else:
        path.write_bytes(splat_bytes().tobytes())
        found = read_splat(path)
    command = ["splat-transform", "-w", str(path), str(tmp_path / "a.ply")]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    other = read_gaussians(tmp_path / "a.ply")
    other = other if kind == "splat" else half_turned(other)
    for name in ("mean", "scale", "opacity", "harmonics"):
        expected = pytest.approx(np.asarray(getattr(other, name)), rel=1e-4, abs=1e-5)
        assert getattr(found, name) == expected
    # Readers differ by half a step in what a byte of a .splat's rotation means.
    assert turned(found, other) < (1e-3 if kind == "splat" else TURN)
