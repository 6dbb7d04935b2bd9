"""Photographs as phones store them: sizes, tags of orientation, HEIC."""

import os

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from gaussray.capture.orientation import upright_pixels
from gaussray.capture.picture_file import read_levels
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.photographs import copied_photograph, copy_stems, photograph_size


# Levels between a picture and its JPEG of quality 97, or its HEIC of quality 95: of smooth colours.
NEAR = 3


def colours(width=64, height=48):
    """A smooth picture without any symmetry."""
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    return (255 * np.stack([x, y, 0.5 * x * x + 0.2 * y], -1) + 0.5).astype(np.uint8)


def with_tag(path, stored, orientation):
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(stored).save(path, quality=97, subsampling=0, exif=exif)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_put_upright_as_pillow_does(tmp_path, orientation):
    path = tmp_path / "a.jpg"
    with_tag(path, colours(), orientation)
    with Image.open(path) as stored:
        turned = Image.Image.transpose
        ways = {
            2: Image.Transpose.FLIP_LEFT_RIGHT,
            3: Image.Transpose.ROTATE_180,
            4: Image.Transpose.FLIP_TOP_BOTTOM,
            5: Image.Transpose.TRANSPOSE,
            6: Image.Transpose.ROTATE_270,
            7: Image.Transpose.TRANSVERSE,
            8: Image.Transpose.ROTATE_90,
        }
        seen = turned(stored, ways[orientation]) if orientation > 1 else stored
        expected = np.asarray(seen)
    assert photograph_size(path) == expected.shape[1::-1]
    copy = copied_photograph(path, tmp_path / "out")
    levels = read_levels(copy, *photograph_size(path))
    assert np.abs(levels.astype(int) - expected).max() <= NEAR
    # The copy has no tag any more, and is made once.
    assert photograph_size(copy) == photograph_size(path)
    before = copy.stat()
    assert copied_photograph(path, tmp_path / "out") == copy
    assert copy.stat().st_ino == before.st_ino


def test_an_unknown_orientation_is_upright():
    pixels = colours()
    assert (upright_pixels(pixels, 0) == pixels).all() and (
        upright_pixels(pixels, 9) == pixels
    ).all()


def test_an_upright_photograph_is_copied_as_it_is(tmp_path):
    path = tmp_path / "a.jpg"
    Image.fromarray(colours()).save(path)
    copy = copied_photograph(path, tmp_path / "out")
    assert copy.name == "a.jpg" and copy.read_bytes() == path.read_bytes()


def test_copies_are_called_as_their_photographs_whether_or_not_they_are_turned(tmp_path):
    turned, upright = tmp_path / "IMG_1.JPG", tmp_path / "IMG_2.JPG"
    with_tag(turned, colours(), 6)
    Image.fromarray(colours()).save(upright)
    copies = [copied_photograph(path, tmp_path / "out") for path in (turned, upright)]
    assert [copy.name for copy in copies] == ["IMG_1.jpg", "IMG_2.JPG"]
    # Beside the photograph itself, which stays, a copy has another name.
    (tmp_path / "a.jpg").write_bytes(turned.read_bytes())
    assert copied_photograph(tmp_path / "a.jpg", tmp_path).name == "a.jpg.jpg"
    assert (tmp_path / "a.jpg").read_bytes() == turned.read_bytes()


def test_photographs_that_differ_in_their_suffix_alone_keep_two_names(tmp_path):
    paths = [tmp_path / name for name in ("a.jpg", "A.png", "b.jpg")]
    assert copy_stems(paths) == ["a.jpg", "A.png", "b"]
    longer = [tmp_path / name for name in ("a.jpg", "a.png", "a.jpg.jpg", "a.jpg.jpg.png")]
    assert copy_stems(longer) == ["a.jpg", "a.png", "a.jpg.jpg", "a.jpg.jpg.png"]
    with_tag(paths[0], colours(), 6)
    Image.fromarray(colours()).save(paths[1])
    copies = [
        copied_photograph(path, tmp_path / "out", stem)
        for path, stem in zip(paths[:2], copy_stems(paths), strict=False)
    ]
    assert [copy.stem for copy in copies] == ["a.jpg", "A.png"]


def test_photographs_of_the_output_folder_stay_as_they_are(tmp_path):
    paths = [tmp_path / name for name in ("a.jpg", "a.png", "b.jpg")]
    for path, orientation in zip(paths, (1, 1, 6), strict=True):
        with_tag(path, colours(), orientation)
    before = [path.read_bytes() for path in paths]
    copies = [
        copied_photograph(path, tmp_path, stem)
        for path, stem in zip(paths, copy_stems(paths), strict=True)
    ]
    assert copies == [*paths[:2], tmp_path / "b.jpg.jpg"]
    assert [path.read_bytes() for path in paths] == before


def test_a_photograph_that_was_turned_since_is_copied_anew(tmp_path):
    path, out = tmp_path / "a.jpg", tmp_path / "out"
    with_tag(path, colours(), 1)
    times = path.stat()
    copied_photograph(path, out)
    with_tag(path, colours(), 6)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert photograph_size(copied_photograph(path, out)) == (48, 64)


def test_heic_becomes_jpeg(tmp_path):
    heif, path = pytest.importorskip("pillow_heif"), tmp_path / "IMG_1.HEIC"
    heif.from_bytes("RGB", (64, 48), colours().tobytes()).save(path, quality=95, chroma=444)
    assert photograph_size(path) == (64, 48)
    copy = copied_photograph(path, tmp_path / "out")
    assert copy.name == "IMG_1.jpg"
    assert np.abs(read_levels(copy, 64, 48).astype(int) - colours()).max() <= 2 * NEAR


def test_a_damaged_heic_is_refused_with_its_name(tmp_path):
    heif, path = pytest.importorskip("pillow_heif"), tmp_path / "a.heic"
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), np.uint8)
    heif.from_bytes("RGB", (640, 480), noise.tobytes()).save(path, quality=95)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(OSError, match="a.heic: the picture"):
        copied_photograph(path, tmp_path / "out")


def test_heic_without_its_reader_is_refused_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pillow_heif", None)
    (tmp_path / "a.heic").write_bytes(b"ftypheic")
    with pytest.raises(PrepareError, match=r"pip install 'gaussray\[prepare\]'"):
        photograph_size(tmp_path / "a.heic")


def phone_tags():
    exif = Image.Exif()
    exif[271], exif[272], exif[274] = "Maker", "Phone", 6
    exif[0x8769] = {37386: IFDRational(399, 100), 41989: 28}
    return exif


@pytest.mark.parametrize("suffix", ["jpg", "heic"])
def test_copies_keep_the_focal_length(tmp_path, suffix):
    # COLMAP starts from it; without it, the focal length is a guess.
    if suffix == "heic":
        pytest.importorskip("pillow_heif").register_heif_opener()
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(colours()).save(path, quality=95, exif=phone_tags())
    with Image.open(copied_photograph(path, tmp_path / "out")) as copy:
        exif = copy.getexif()
    assert (exif[271], exif[272]) == ("Maker", "Phone")
    assert exif.get(274, 1) == 1
    block = exif.get_ifd(0x8769)
    assert (float(block[37386]), int(block[41989])) == (pytest.approx(3.99, abs=1e-3), 28)
