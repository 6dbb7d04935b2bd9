"""`.ksplat` files, written by hand and by the library that the format is of."""

import shutil
import subprocess

import numpy as np
import pytest
from splats import gaussians

from gaussray.scene.formats.any_file import load
from gaussray.scene.formats.gaussian_ply import write_gaussians
from gaussray.scene.formats.ksplat import read_ksplat
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import Scene


SINGLE = 1e-6
# Half a step of 5 / 2 / 32767 in a bucket; half precision, which the library rounds down; bytes.
PLACE, HALF, BYTE = 5 / 4 / 32767, 2**-10, 1 / 255
BUCKET, WIDTH = 3, 5.0
FIELDS = ("mean", "quat", "scale", "opacity")
LIBRARY = "npm install -g @mkkellogg/gaussian-splats-3d three; NODE_PATH=$(npm root -g)"
WRITE = """
globalThis.window = globalThis;
const GS = require('@mkkellogg/gaussian-splats-3d'), THREE = require('three'), fs = require('fs');
const [from, to, level, degree] = process.argv.slice(1), data = fs.readFileSync(from);
const bytes = data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength);
GS.PlyLoader.loadFromFileData(bytes, 0, +level, true, +degree, 0, new THREE.Vector3(), 5.0, 256)
  .then((buffer) => fs.writeFileSync(to, Buffer.from(buffer.bufferData)));
"""


def by_color(harmonics, degree):
    """Coefficients above degree 0, of red, green and blue in turn, one degree after the other."""
    blocks = [harmonics[:, own**2 : (own + 1) ** 2] for own in range(1, degree + 1)]
    flat = [np.swapaxes(block, 1, 2).reshape(len(harmonics), -1) for block in blocks]
    return np.concatenate(flat, axis=1) if flat else np.zeros((len(harmonics), 0))


def section(model, level, degree, bounds):
    """The header and the bytes of a section, whose buckets hold three Gaussians, the last two."""
    count = len(model.opacity)
    sizes = [BUCKET] * (count // BUCKET) + ([count % BUCKET] if count % BUCKET else [])
    first = np.cumsum([0, *sizes[:-1]])
    mean = np.asarray(model.mean, np.float64)
    centers = np.array([mean[i : i + n].mean(axis=0) for i, n in zip(first, sizes, strict=True)])
    place, number, harmonic = [("f4",) * 3, ("u2", "f2", "f2"), ("u2", "f2", "u1")][level]
    values = by_color(np.asarray(model.harmonics), degree)
    if level:
        step = WIDTH / 2 / 32767
        mean = np.round((mean - np.repeat(centers, sizes, axis=0)) / step) + 32767
    if level == 2:
        low, high = bounds
        values = np.round((values - low) / (high - low) * 255)
    kinds = [("mean", place, 3), ("scale", number, 3), ("quat", number, 4), ("rgba", "u1", 4)]
    table = np.zeros(count, [*kinds, ("above", harmonic, values.shape[1])])
    table["mean"], table["above"] = mean, values
    table["scale"], table["quat"] = np.asarray(model.scale), np.asarray(model.quat)
    color = np.asarray(model.harmonics)[:, 0] * C0 + 0.5
    table["rgba"][:, :3] = np.round(color * 255)
    table["rgba"][:, 3] = np.round(np.asarray(model.opacity) * 255)
    head = np.zeros(1024, "u1")
    words, halves, floats = head.view("<u4"), head.view("<u2"), head.view("<f4")
    words[:2], halves[20], data = count, degree, b""
    if level:
        words[2:4], floats[4], halves[10] = (BUCKET, len(sizes)), WIDTH, 12
        words[6], words[8], words[9] = 32767, count // BUCKET, int(count % BUCKET > 0)
        data = np.array(sizes[count // BUCKET :], "<u4").tobytes() + centers.astype("<f4").tobytes()
    return head, data + table.tobytes()


def written(path, models, level, degrees, bounds=(-2.0, 2.0), change=lambda head, sections: None):
    """A file with a section for each model."""
    made = [section(m, level, d, bounds) for m, d in zip(models, degrees, strict=True)]
    head = np.zeros(4096, "u1")
    words, total = head.view("<u4"), sum(len(model.opacity) for model in models)
    head[1], words[1:5] = 1, (len(models), len(models), total, total)
    head.view("<u2")[10] = level
    head.view("<f4")[9:11] = bounds
    sections = np.stack([one for one, _ in made])
    change(head, sections)
    path.write_bytes(head.tobytes() + sections.tobytes() + b"".join(data for _, data in made))
    return path


def close_to(found, model, level, degree, bounds=(-2.0, 2.0)):
    """Whether a model is what was written, to the precision of the compression."""
    exact = level == 0
    quat = np.asarray(model.quat) / np.linalg.norm(model.quat, axis=1, keepdims=True)
    np.testing.assert_allclose(found.mean, model.mean, atol=SINGLE if exact else 1.01 * PLACE)
    np.testing.assert_allclose(found.scale, model.scale, rtol=SINGLE if exact else HALF)
    np.testing.assert_allclose(found.quat, quat, atol=SINGLE if exact else 2 * HALF)
    np.testing.assert_allclose(found.opacity, model.opacity, atol=BYTE)
    known, above = np.asarray(model.harmonics), (degree + 1) ** 2
    np.testing.assert_allclose(found.harmonics[:, 0], known[:, 0], atol=BYTE / C0)
    step = (bounds[1] - bounds[0]) * BYTE
    rounding = {0: SINGLE, 1: HALF, 2: 1.01 * step}[level]
    np.testing.assert_allclose(found.harmonics[:, 1:above], known[:, 1:above], atol=rounding)
    assert not np.any(found.harmonics[:, above:])


@pytest.fixture
def model():
    """Eleven Gaussians of degree 2 within a metre."""
    return gaussians(11, 9, seed=3)


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_what_is_written_is_read(tmp_path, model, level, degree):
    found = read_ksplat(written(tmp_path / "a.ksplat", [model], level, [degree]))
    assert found.harmonics.shape == (11, (degree + 1) ** 2, 3)
    close_to(found, model, level, degree)


def test_sections_follow_one_another_and_may_differ_in_degree(tmp_path, model):
    other = gaussians(4, 9, seed=4)
    path = written(tmp_path / "a.KSPLAT", [model, other], 1, [2, 1])
    scene = load(path)
    assert isinstance(scene, Scene) and scene.static.count == 15
    found = read_ksplat(path)
    close_to(_rows(found, slice(0, 11)), model, 1, 2)
    close_to(_rows(found, slice(11, 15)), other, 1, 1)


def _rows(found, rows):
    return type(found)(**{name: getattr(found, name)[rows] for name in (*FIELDS, "harmonics")})


def _set(kind, place, value, of_section=False):
    def change(head, sections):
        (sections[0] if of_section else head).view(kind)[place] = value

    return change


def test_a_count_in_use_stands_for_a_largest_count_that_is_left_out(tmp_path, model):
    def change(head, sections):
        head.view("<u4")[2:4] = 0

    close_to(
        read_ksplat(written(tmp_path / "a.ksplat", [model], 0, [2], change=change)), model, 0, 2
    )


def _total(most, used):
    def change(head, sections):
        head.view("<u4")[3:5] = most, used

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_total(0, 0), "at least one Gaussian"),
        (_total(0, 12), "12 Gaussians in its sections"),
        (_total(0, 2**32 - 1), "millions of Gaussians"),
        (_set("u1", 1, 0), "version 0.1 or newer"),
        (_set("<u2", 10, 3), "compression 0, 1 or 2, got 3"),
        (_set("<u4", 1, 0), "1 to 11 sections, got 0"),
        (_set("<u4", 3, 12), "12 Gaussians in its sections"),
        (_set("<u4", 3, 2**32 - 1), "millions of Gaussians"),
        (_set("<u2", 20, 3, True), "degree 2, got 3"),
        (_set("<u2", 10, 16, True), "centres of 12 bytes"),
        (_set("<u4", 3, 2**31, True), "at most one for each Gaussian"),
        (_set("<u4", 9, 2**31, True), "at most one for each Gaussian"),
        (_set("<u4", 8, 2, True), "11 Gaussians in the 4 buckets"),
        (_set("<u4", 8, 4, True), "at most one for each Gaussian"),
        (_set("<u4", 2, 2, True), "11 Gaussians in the 4 buckets"),
        (_set("<u4", 8, 2**31, True), "at most one for each Gaussian"),
        (_set("<f4", 4, np.nan, True), "at least one Gaussian must be finite"),
    ],
)
def test_a_damaged_file_is_refused_with_what_is_wrong(tmp_path, model, change, message):
    path = written(tmp_path / "a.ksplat", [model], 1, [1], change=change)
    with pytest.raises(ValueError, match=f"a.ksplat: .*{message}"):
        read_ksplat(path)


def test_what_is_not_finite_is_dropped_with_a_warning(tmp_path, model):
    mean = np.array(model.mean)
    mean[4] = np.nan
    broken = _rows(model, slice(None))
    broken = type(broken)(mean, *(getattr(broken, name) for name in (*FIELDS[1:], "harmonics")))
    path = written(tmp_path / "a.ksplat", [broken], 0, [1])
    with pytest.warns(UserWarning, match="1 of 11 Gaussians are not finite"):
        found = read_ksplat(path)
    close_to(found, _rows(model, np.delete(np.arange(11), 4)), 0, 1)


@pytest.mark.parametrize("size", [0, 100, 4096, 5000, -1])
def test_a_file_that_is_cut_short_is_refused(tmp_path, model, size):
    path = written(tmp_path / "a.ksplat", [model], 2, [2])
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(ValueError, match=r"a.ksplat: a .ksplat file must have"):
        read_ksplat(path)


def has_library():
    words = ["node", "-e", "require('@mkkellogg/gaussian-splats-3d')"]
    return shutil.which("node") and not subprocess.run(words, capture_output=True).returncode


@pytest.mark.skipif(not has_library(), reason=LIBRARY)
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("level", [0, 1, 2])
def test_files_of_its_own_library_are_read(tmp_path, level, degree):
    model = gaussians(700, 16, seed=5)
    write_gaussians(tmp_path / "a.ply", model)
    words = ["node", "-e", WRITE, "a.ply", "a.ksplat", str(level), str(degree)]
    subprocess.run(words, check=True, cwd=tmp_path, capture_output=True)
    found = read_ksplat(tmp_path / "a.ksplat")
    # The library sorts the Gaussians by bucket.
    away = np.linalg.norm(np.asarray(found.mean)[:, None] - np.asarray(model.mean), axis=2)
    order = np.argmin(away, axis=1)
    assert sorted(order) == list(range(700))
    close_to(found, _rows(model, order), level, degree, bounds=(-1.5, 1.5))
