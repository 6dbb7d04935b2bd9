"""Compressed PLY files and SOG scenes, by hand and as another program writes them."""

import json
import shutil
import subprocess
import zipfile

import numpy as np
import OpenImageIO as oiio
import pytest
from splats import gaussians, turned

from gaussray.dataset.images import write_pixels
from gaussray.scene.formats.any_file import load
from gaussray.scene.formats.compressed_ply import is_compressed_ply, read_compressed_ply
from gaussray.scene.formats.gaussian_folder import read_model
from gaussray.scene.formats.gaussian_ply import read_gaussians, write_gaussians
from gaussray.scene.formats.sog import read_sog
from gaussray.scene.harmonics import C0


HALF = 0.5**0.5
ROUNDING = 1e-6


def packed_ply(path, colors=True, harmonics=9, drop=None, chunks=2):
    """Two chunks, 256 Gaussians and one; all words of the first chunk are 0, those of the other are
    full."""
    bounds = [f"{end}_{x}" for end in ("min", "max") for x in ("x", "y", "z")]
    bounds += [f"{end}_scale_{x}" for end in ("min", "max") for x in ("x", "y", "z")]
    bounds += [f"{end}_{x}" for end in ("min", "max") for x in ("r", "g", "b")] if colors else []
    words = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
    words = [word for word in words if word != drop]
    rows = np.array([range(18), range(40, 58)], "<f4")[:chunks, : len(bounds)]
    vertex = np.zeros((257, len(words)), "<u4")
    vertex[256] = 2**32 - 1
    lines = ["ply", "format binary_little_endian 1.0", "comment by hand", f"element chunk {chunks}"]
    lines += [f"property float {name}" for name in bounds]
    lines += ["element vertex 257", *(f"property uint {name}" for name in words)]
    rest = np.zeros((257, harmonics), "u1")
    rest[256] = np.arange(harmonics)
    if harmonics:
        lines += ["element sh 257", *(f"property uchar f_rest_{i}" for i in range(harmonics))]
    head = "\n".join([*lines, "end_header", ""]).encode()
    path.write_bytes(head + rows.tobytes() + vertex.tobytes() + rest.tobytes())
    return path


def test_words_of_a_compressed_ply_lie_between_the_bounds_of_their_chunk(tmp_path):
    path = packed_ply(tmp_path / "a.ply")
    assert is_compressed_ply(path)
    found = read_compressed_ply(path)
    np.testing.assert_allclose(
        np.asarray(found.mean)[[0, 255, 256]], [[0, 1, 2]] * 2 + [[43, 44, 45]]
    )
    np.testing.assert_allclose(np.log(found.scale[0]), [6, 7, 8], rtol=ROUNDING)
    np.testing.assert_allclose(
        np.asarray(found.opacity)[[0, 256]], [0.5 / 255, 1 - 0.5 / 255], rtol=ROUNDING
    )
    np.testing.assert_allclose(
        found.harmonics[0, 0], (np.array([12, 13, 14]) - 0.5) / C0, rtol=1e-5
    )
    # The largest is the first, and three others at -sqrt(1/2) are longer than 1 already.
    np.testing.assert_allclose(found.quat[0], [0, *[-(3**-0.5)] * 3], atol=ROUNDING)
    np.testing.assert_allclose(found.quat[256], [*[3**-0.5] * 3, 0], atol=ROUNDING)
    # Channel-major: 3 coefficients of red come first; a byte is 1/32, 0 the end of the range.
    np.testing.assert_allclose(found.harmonics[256, 1:, 0], [-4, 1.5 / 32 - 4, 2.5 / 32 - 4])
    np.testing.assert_allclose(found.harmonics[256, 1:, 1], np.array([3.5, 4.5, 5.5]) / 32 - 4)


def test_bits_of_a_word_are_11_10_and_11(tmp_path):
    path = packed_ply(tmp_path / "a.ply", colors=False, harmonics=0)
    content = bytearray(path.read_bytes())
    begin = len(content) - 16
    largest_w, largest_z = 0 << 30 | 1023 << 20 | 512 << 10, 3 << 30 | 512 << 20 | 511 << 10 | 512
    word = np.array([2047 << 21 | 512 << 11 | 3, largest_z, 0, 0x80402010], "<u4")
    content[begin:] = word.tobytes()
    path.write_bytes(content)
    found = read_compressed_ply(path)
    share = np.array([1, 512 / 1023, 3 / 2047])
    np.testing.assert_allclose(found.mean[256], [40, 41, 42] + 3 * share, rtol=ROUNDING)
    small = HALF / 1023
    np.testing.assert_allclose(found.quat[256, :3], [small, -small, small], atol=ROUNDING)
    assert found.quat[256, 3] == pytest.approx(1, abs=1e-5)
    levels = np.array([0x80, 0x40, 0x20]) / 255
    np.testing.assert_allclose(found.harmonics[256, 0], (levels - 0.5) / C0, rtol=1e-5)
    assert found.opacity[256] == pytest.approx(0x10 / 255)
    content[begin + 4 : begin + 8] = np.array([largest_w], "<u4").tobytes()
    path.write_bytes(content)
    quat = read_compressed_ply(path).quat[256]
    assert quat[1] == pytest.approx(HALF, abs=1e-3) and quat[0] == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"chunks": 1}, "a row of the element chunk for every 256"),
        ({"drop": "packed_scale"}, "property packed_scale"),
        ({"harmonics": 8}, "9, 24 or 45"),
    ],
)
def test_a_compressed_ply_that_lacks_something_is_refused(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read_model(packed_ply(tmp_path / "a.ply", **change))


def picture(path, pixels):
    """A PNG file of 4 channels, whose transparent pixels keep their colours."""
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 4, oiio.UINT8)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    write_pixels(path, pixels.astype(np.uint8), spec)


def sog(folder, bands=1, **change):
    """Three Gaussians in pictures of 2 x 2."""
    low, high = np.zeros((2, 2, 2, 4))
    low[0, 1, :3], high[0, 1, :3] = 255, 255
    high[1, 0, :3] = [128, 0, 64]
    quats = np.zeros((2, 2, 4)) + [128, 127, 128, 252]
    quats[0, 1] = [255, 128, 127, 254]
    scales = np.zeros((2, 2, 4)) + [0, 1, 255, 255]
    sh0 = np.zeros((2, 2, 4)) + [10, 20, 30, 0]
    labels = np.zeros((2, 2, 4)) + [1, 0, 0, 255]
    labels[0, 1, 0] = 65
    coefficients = (0, 3, 8, 15)[bands]
    palette = np.zeros((2, 64 * coefficients, 4)) + 255
    palette[1, coefficients : 2 * coefficients, 0] = np.arange(coefficients)
    book = np.linspace(-2, 2, 256).tolist()
    textures = {"ml": low, "mu": high, "q": quats, "s": scales, "c": sh0, "p": palette, "l": labels}
    for name, pixels in textures.items():
        picture(folder / f"{name}.png", pixels)
    meta = {
        "version": 2,
        "count": 3,
        "means": {"mins": [-1, 0, 0], "maxs": [1, 2, 3], "files": ["ml.png", "mu.png"]},
        "scales": {"codebook": book, "files": ["s.png"]},
        "quats": {"files": ["q.png"]},
        "sh0": {"codebook": book, "files": ["c.png"]},
        "shN": {"count": 66, "bands": bands, "codebook": book, "files": ["p.png", "l.png"]},
    }
    (folder / "meta.json").write_text(json.dumps(meta | change))
    return folder


def test_pixels_of_a_sog_scene_are_gaussians(tmp_path):
    found = read_sog(sog(tmp_path / "scene"))
    ends = np.array([[-1, 0, 0], [1, 2, 3]])
    share = np.array([[0, 0, 0], [1, 1, 1], np.array([128, 0, 64]) * 256 / 65535])
    bent = ends[0] + (ends[1] - ends[0]) * share
    np.testing.assert_allclose(
        found.mean, np.sign(bent) * np.expm1(np.abs(bent)), rtol=ROUNDING, atol=ROUNDING
    )
    np.testing.assert_allclose(np.log(found.scale[0]), [-2, 4 / 255 - 2, 2], rtol=1e-5)
    np.testing.assert_allclose(found.quat[0], [1, 0, 0, 0], atol=0.01)
    # The largest is y: w and x come before it, z behind it.
    np.testing.assert_allclose(found.quat[1], [HALF, 0, HALF, 0], atol=0.01)
    np.testing.assert_allclose(found.opacity, 0.5 / 255)
    book = np.linspace(-2, 2, 256)
    np.testing.assert_allclose(found.harmonics[2, 0], book[[10, 20, 30]], rtol=ROUNDING)
    np.testing.assert_allclose(found.harmonics[1, 1:, 0], book[[0, 1, 2]], rtol=ROUNDING)
    np.testing.assert_allclose(found.harmonics[0, 1:], 2, rtol=ROUNDING)


def test_a_sog_archive_is_its_folder(tmp_path):
    folder = sog(tmp_path / "scene", bands=2)
    with zipfile.ZipFile(tmp_path / "a.sog", "w") as archive:
        for path in folder.iterdir():
            archive.write(path, path.name)
    one, _, _ = read_model(folder)
    other, _, _ = read_model(tmp_path / "a.sog")
    assert one.harmonics.shape == (3, 9, 3)
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.harmonics, other.harmonics)
    assert load(folder / "meta.json").static.count == 3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 1}, "version 2, got 1"),
        ({"count": 5}, "must have 5 pixels, got 4"),
        ({"count": 0}, "at least 1, got 0"),
        ({"quats": {"files": ["s.png"]}, "count": 1}, None),
        ({"quats": {"files": ["ml.png"]}}, "fourth byte of quats"),
        ({"quats": {}}, "quats.files must name"),
        ({"quats": {"files": ["../../q.png"]}}, "q.png"),
        ({"sh0": {"codebook": [1.0], "files": ["c.png"]}}, "codebook must be 256"),
        ({"shN": {"bands": 1, "codebook": [0] * 256, "files": ["s.png", "l.png"]}}, "palette"),
        ({"shN": {"bands": 9}}, "bands must be 0 to 3"),
    ],
)
def test_a_damaged_sog_scene_is_refused(tmp_path, change, message):
    folder = sog(tmp_path / "scene", **change)
    if message is None:
        assert read_sog(folder).mean.shape == (1, 3)
        return
    with pytest.raises((ValueError, OSError), match=message):
        read_sog(folder)


def test_what_is_no_archive_is_refused(tmp_path):
    (tmp_path / "a.sog").write_bytes(b"what is this")
    with pytest.raises(ValueError, match="ZIP archive of a SOG scene"):
        read_sog(tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as archive:
        archive.writestr("other.json", "{}")
    with pytest.raises(ValueError, match=r"must hold meta\.json"):
        read_sog(tmp_path / "b.sog")


@pytest.mark.skipif(
    not shutil.which("splat-transform"), reason="npm install -g @playcanvas/splat-transform@3"
)
@pytest.mark.parametrize("coefficients", [1, 16])
@pytest.mark.parametrize("kind", ["compressed.ply", "sog", "meta.json"])
def test_files_of_another_program_are_read_as_it_reads_them(tmp_path, kind, coefficients):
    """600 Gaussians are three chunks, the last of which is not full. splat-transform packs them,
    and unpacks them again to a PLY file."""
    write_gaussians(tmp_path / "a.ply", gaussians(600, coefficients))
    packed, plain = tmp_path / "out" / f"a.{kind}", tmp_path / "b.ply"
    packed = tmp_path / "out" / "meta.json" if kind == "meta.json" else packed
    packed.parent.mkdir()
    for source, target in ((tmp_path / "a.ply", packed), (packed, plain)):
        command = ["splat-transform", "-w", "-g", "cpu", str(source), str(target)]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
    (found, _, _), other = read_model(packed), read_gaussians(plain)
    for name in ("mean", "scale", "harmonics"):
        expected = pytest.approx(np.asarray(getattr(other, name)), rel=1e-4, abs=1e-5)
        assert np.asarray(getattr(found, name)) == expected
    # It keeps opacities a millionth from 0 and 1, we half a level.
    np.testing.assert_allclose(found.opacity, other.opacity, atol=0.51 / 255)
    assert turned(found, other) < 1e-5
