"""The figures of the pages compute what the library computes."""

import json
import pathlib
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture
from gaussray.camera.camera import Camera
from gaussray.camera.circle_of_confusion import circle_of_confusion
from gaussray.camera.film import Film
from gaussray.camera.lens import (
    PROJECTIONS,
    DoubleSphere,
    Fisheye,
    KannalaBrandt,
    UnifiedSphere,
    pinhole,
)
from gaussray.camera.shutter import row_moments
from gaussray.render.rig.shutter import ShutterOptions, build_shutter


FIGURES = pathlib.Path(__file__).parents[1] / "docs" / "figures"
ANGLES = [0.0, 0.3, 0.9, 1.4]
# Double precision on both sides.
ROUNDING = 1e-12

pytestmark = pytest.mark.skipif(not shutil.which("node"), reason="no node")


@pytest.fixture(scope="module")
def told():
    """What the page's formulas give, by node."""
    code = f"""
    const f = require({json.dumps(str(FIGURES / "optics.js"))}), angles = {ANGLES};
    const all = (name) => angles.map((theta) => f.radius(name, theta));
    console.log(JSON.stringify({{
      lenses: Object.fromEntries(Object.keys(f.LENSES).map((name) => [name, all(name)])),
      k: Object.fromEntries(Object.entries(f.LENSES).map(([name, lens]) => [name, lens.k ?? []])),
      confusion: [0.5, 2.5, 7, Infinity].map((z) => f.confusion(0.09, 100, 2.5, z)),
      rows: [...Array(16).keys()].map((i) => f.rowTime(0.25, 16, i)),
      beyond: f.radius("pinhole", 1.6),
    }}, (key, value) => (Number.isNaN(value) ? "none" : value)));
    """
    done = subprocess.run(["node", "-e", code], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def lens_of(name, k):
    one, half = jnp.ones(2), jnp.asarray(jnp.pi / 2)
    middle, k = jnp.zeros(2), jnp.asarray(k, float)
    if name in PROJECTIONS:
        return Fisheye(one, middle, half, name)
    kinds = {"unified_sphere": UnifiedSphere, "double_sphere": DoubleSphere}
    return kinds.get(name, KannalaBrandt)(one, middle, k, half)


def test_lenses_are_the_library_s(told):
    for name, values in told["lenses"].items():
        if name == "pinhole":
            lens = pinhole(jnp.ones(2), jnp.zeros(2))
            points = jnp.stack(
                [jnp.sin(jnp.array(ANGLES)), jnp.zeros(4), jnp.cos(jnp.array(ANGLES))]
            )
            expected = jax.vmap(lens.project)(points.T)[:, 0]
        else:
            expected = jax.vmap(lens_of(name, told["k"][name]).radius)(jnp.array(ANGLES))
        np.testing.assert_allclose(values, expected, rtol=ROUNDING, atol=ROUNDING, err_msg=name)


def test_what_no_pinhole_sees_has_no_place(told):
    assert told["beyond"] == "none"


def test_the_circle_of_confusion_is_the_library_s(told):
    plain = toy.camera()
    number = jnp.asarray
    aperture = Aperture(number(0.09), number(2.5), number(0.0), number(1.0))
    lens = pinhole(jnp.full(2, 100.0), jnp.full(2, 64.5))
    camera = Camera(**(vars(plain) | {"film": Film(128, 128), "lens": lens, "aperture": aperture}))
    depths = [0.5, 2.5, 7.0, 1e12]
    found = [
        circle_of_confusion(camera, number([64.0, 64.0]), number(z), number(0.0)) for z in depths
    ]
    np.testing.assert_allclose(told["confusion"], np.array(found), rtol=1e-6, atol=1e-9)


def test_rows_look_when_the_library_s_do(told):
    shutter = build_shutter(toy.camera(), ShutterOptions(kind="rolling", readout=0.25), None)
    # The library keeps single precision.
    np.testing.assert_allclose(told["rows"], row_moments(shutter, (16, 16)), atol=1e-7)
