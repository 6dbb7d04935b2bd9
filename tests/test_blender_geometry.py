"""Blender's own rays and times are ours, for every lens, aperture and shutter.

Blender is taken from the interpreter that GAUSSRAY_BLENDER_PYTHON names, or else from this one.
"""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.paired_benchmark.geometry import proof, samples
from experiments.paired_benchmark.geometry.cases import DIFFERS, cases
from gaussray.camera.aperture import Aperture, thin_lens
from gaussray.camera.film import Film, sample_offset
from gaussray.geometry import normalize


SIZE = 48
# Tables and polygons are inverted in double precision; the film's table is interpolated.
EXACT, INTERPOLATED = 1e-9, 1e-6

# What each recorded number is worth: a small error of it has to break a promise. The pixel
# centre's half row and the mirrored polygon are what other conventions would say.
WRONG = {
    "principal point": ("pinhole shifted", "cx", lambda cx: cx + 0.1, "image"),
    "focal length": ("pinhole landscape", "fl_x", lambda focal: focal * 1.005, "ray"),
    "polynomial": ("fisheye 290 degrees", "lens.k", lambda k: [0, 1.005 * k[1], 0, 0, 0], "ray"),
    "field of view": ("fisheye 166 degrees", "lens.fov", lambda fov: 0.98 * fov, "mask"),
    "fisheye shift": ("fisheye shifted", "lens.shift", lambda shift: [shift[0], 0], "image"),
    "radius": ("disc near focus", "aperture.radius", lambda radius: 0.99 * radius, "origin"),
    "focus": ("disc near focus", "aperture.focus_distance", lambda f: 1.01 * f, "image"),
    "focus on a plane": ("benchmark everything", "aperture.focus", lambda _: "plane", "image"),
    "blades": ("6 blades", "aperture.blades", lambda _: 0, "lens"),
    "rotation": ("5 blades", "aperture.rotation", lambda angle: -angle, "origin"),
    "ratio": ("ratio 2", "aperture.ratio", lambda ratio: 1.05 * ratio, "origin"),
    "row step": ("rolling 1 END", "shutter.row_step", lambda step: 1.001 * step, "time"),
    "middle of the row": (
        "rolling 1 END",
        "shutter.row_offset",
        lambda t: t - 0.5 / 72 / 49,
        "time",
    ),
    "direction": ("fisheye rolling", "shutter.direction", lambda _: "bottom_to_top", "time"),
    "exposure": ("rolling exposure 0.1", "shutter.exposure", lambda e: 1.005 * e, "width"),
    "filter": ("filter BOX", "film.filter", lambda _: "blackman_harris", "film"),
    "filter's width": ("filter GAUSSIAN", "film.filter_width", lambda w: 0.8 * w, "ray"),
    "motion": ("moving camera rolling", "frame.trajectory", lambda poses: poses[:1], "ray"),
}

without_blender = pytest.mark.skipif(
    proof.blender_python() is None,
    reason=f"{proof.PYTHON_KEY} names no Python that has bpy",
)


def of_blender(test):
    return pytest.mark.slow(without_blender(test))


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """The capture that Blender makes of all cases."""
    folder = tmp_path_factory.mktemp("geometry")
    proof.take_pictures(folder, SIZE)
    return folder


@of_blender
@pytest.mark.parametrize("name", [case.name for case in cases(SIZE)])
def test_our_rays_and_times_are_blenders(pictures, name):
    errors = proof.measure(pictures, name)
    assert errors["pixels"] > SIZE**2 / 2
    assert not proof.misses(name, errors), errors


@of_blender
@pytest.mark.parametrize("name", DIFFERS)
def test_what_is_said_to_differ_does(pictures, name):
    assert proof.measure(pictures, name)["ray"][2] > proof.PIXELS


@of_blender
@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_number_in_the_capture_breaks_a_promise(pictures, tmp_path, what):
    name, path, change, broken = WRONG[what]
    document = json.loads((pictures / f"{name}.json").read_text())
    (frame,) = document["frames"]
    *block, key = path.split(".")
    owner = frame if block == ["frame"] else document[block[0]] if block else document
    owner[key] = change(owner[key])
    frame["file_path"] = str(pictures / frame["file_path"])
    (tmp_path / f"{name}.json").write_text(json.dumps(document))
    assert broken in proof.misses(name, proof.measure(tmp_path, name))


@pytest.mark.parametrize("kind, width", [("blackman_harris", 3.0), ("gaussian", 4.5), ("box", 1.0)])
def test_a_place_in_the_filter_gives_back_its_numbers(kind, width):
    film = Film(8, 8, kind, width)
    u = jnp.asarray(np.random.default_rng(0).uniform(0.001, 0.999, (200, 2)))
    offset = jax.vmap(lambda u: sample_offset(film, u))(u)
    np.testing.assert_allclose(samples.of_film(film, np.asarray(offset)), u, atol=INTERPOLATED)


@pytest.mark.parametrize("blades", [0, 3, 6])
@pytest.mark.parametrize("focus", ["plane", "sphere"])
def test_a_place_of_the_opening_gives_back_its_numbers(blades, focus):
    values = (jnp.asarray(value) for value in (0.07, 2.3, 0.4, 1.6))
    aperture = Aperture(*values, blades=blades, focus=focus)
    random = np.random.default_rng(1)
    u = jnp.asarray(random.uniform(0, 1, (300, 2)))
    chief = jax.vmap(normalize)(jnp.asarray(random.normal(size=(300, 3))))
    origin, _ = jax.vmap(thin_lens, in_axes=(None, 0, 0))(aperture, chief, u)
    back = samples.of_opening(aperture, np.asarray(origin), np.asarray(chief))
    np.testing.assert_allclose(back, u, atol=EXACT)


def test_unevenness_is_the_largest_difference_of_shares():
    assert samples.unevenness(np.array([[0.125], [0.375], [0.625], [0.875]])) == 0.125
    assert samples.unevenness(np.array([[0.5, 0.1], [0.5, 0.2]])) == pytest.approx(0.8)


def test_without_blender_the_remedy_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(proof, "blender_python", lambda: None)
    with pytest.raises(RuntimeError, match=r"GAUSSRAY_BLENDER_PYTHON must name .*bpy==4.5"):
        proof.take_pictures(tmp_path, SIZE)


@pytest.mark.parametrize("size", [15, 8, 33])
def test_sizes_without_a_meaning_are_refused(size):
    with pytest.raises(ValueError, match="size must be even and at least 16"):
        cases(size)
