"""Lenses of the user's options: what fov, crop and sensor mean; messages name keys there are."""

import ast
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from gaussray import camera
from gaussray.camera.film import Film
from gaussray.camera.lens.registry import lens_models, models_by_name
from gaussray.config.compose import compose_config
from gaussray.config.options import build_options
from gaussray.config.schema import choices, keys
from gaussray.render.rig.lens import LensOptions, build_lens


FILM = Film(96, 64)
CUBIC = (0.0, 9e-3, 0.0, 1e-8)


def preset(*words, film=FILM):
    """The lens of words of the command line."""
    cfg = compose_config("render", ["scene=x", "out=x", *words])
    return build_lens(film, build_options(LensOptions, cfg.lens))


def angles(lens, pixels):
    """Angle from the axis in degrees, of which NaN is black."""
    rays = np.asarray(jax.vmap(lens.direction)(jnp.asarray(pixels, jnp.float32)))
    angle = np.degrees(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]))
    return np.where(np.any(rays != 0, axis=-1), angle, np.nan)


TOP, CORNER, SIDE = [48.0, 0.0], [0.0, 0.0], [0.0, 32.0]


@pytest.mark.parametrize("choice", choices("lens"))
def test_a_field_of_view_is_seen_to_its_edge_whatever_the_preset_crops(choice):
    if choice in ("keep", "table"):
        return
    model = models_by_name()[
        compose_config("render", ["scene=x", "out=x", f"lens={choice}"]).lens.model
    ]
    fov = min(170.0, model.widest)
    edge = SIDE if model.perspective or choice == "equirectangular" else TOP
    inside = np.array(edge) + 0.01 * (np.array([48, 32]) - edge)
    seen = angles(preset(f"lens={choice}", f"lens.fov={fov}"), [inside])[0]
    if choice != "opencv":  # whose fov is that before the distortion
        assert seen == pytest.approx(fov / 2, abs=8 if choice == "orthographic" else 2)


def test_an_f_theta_alone_fills_its_picture():
    for film in (FILM, Film(300, 300), Film(2000, 1000)):
        lens = preset("lens=f_theta", film=film)
        middle, reach = np.array([film.width, film.height]) / 2, np.arange(1, 100) / 100
        seen = angles(lens, middle - reach[:, None] * middle)
        r = reach * np.hypot(*middle)
        expected = np.degrees(CUBIC[1] * r + CUBIC[3] * r**3)
        # Beyond the whole sphere there is nothing to show.
        expected = np.where(expected < 180, expected, np.nan)
        np.testing.assert_allclose(seen, expected, atol=0.02)
    cut = angles(preset("lens=f_theta", "lens.crop=40"), [TOP, CORNER])
    assert not np.isnan(cut).all() and np.isnan(cut[1])


def test_of_angles_an_f_theta_fills_its_picture_too():
    words = "lens=f_theta", "lens.polynomial=radius_of_angle", "lens.k=[0,60,0,-1]"
    middle = np.array([48.0, 32.0])
    seen = np.radians(angles(preset(*words), [middle * 0.01])[0])
    assert 60 * seen - seen**3 == pytest.approx(0.99 * np.hypot(48, 32), rel=1e-4)


@pytest.mark.parametrize(
    "k, polynomial, degrees",
    [("[0,0.02,0,-3e-6]", "angle_of_radius", "72"), ("[0,30,-10]", "radius_of_angle", "171.9")],
)
def test_an_f_theta_that_turns_back_in_the_picture_needs_a_crop(k, polynomial, degrees):
    words = "lens=f_theta", f"lens.k={k}", f"lens.polynomial={polynomial}"
    with pytest.raises(
        ValueError, match=f"turn back at {degrees}.* degrees across. Give lens.crop"
    ):
        preset(*words)
    assert np.isnan(angles(preset(*words, "lens.crop=60"), [CORNER])).all()


@pytest.mark.parametrize(
    "sensor, message",
    [
        ("[36]", r"lens.sensor must be \[width, height\] in mm, two .* got \[36.0\]"),
        ("[36,24,1]", "two numbers above 0"),
        ("[36,-24]", "two numbers above 0"),
        ("[36,.nan]", "two numbers above 0"),
        ("[inf,inf]", "two numbers above 0"),
        (
            "[36,36]",
            r"96 x 64 pixels, got \[36.0, 36.0\] mm. .*lens.sensor=\[36,24\], or a film.si",
        ),
        ("[24,36]", r"shape of the picture.*lens.sensor=\[24,16\]"),
    ],
)
def test_a_sensor_has_two_sides_and_the_shape_of_the_picture(sensor, message):
    sides = tuple(float(x.replace(".nan", "nan")) for x in sensor.strip("[]").split(","))
    options = LensOptions("fisheye_polynomial", 173.5, (0.0, -0.0745, 0.0, 0.0, 0.0), sides)
    with pytest.raises(ValueError, match=message):
        build_lens(FILM, options)


def test_a_sensor_sets_the_focal_length():
    words = "lens=fisheye", "lens.k=[0,-0.05,0,0,0]"
    lens = preset(*words, "lens.sensor=[36,24]")
    np.testing.assert_allclose(angles(lens, [TOP, SIDE]), np.degrees([0.6, 0.9]), rtol=1e-5)
    # 85 rows are 24.08 mm on 36: to half a pixel, the shape is the picture's.
    close = preset(*words, "lens.sensor=[36,24]", film=Film(128, 85))
    np.testing.assert_allclose(angles(close, [[64.0, 0.0]]), np.degrees(0.6), rtol=1e-5)


@pytest.mark.parametrize(
    "words, message",
    [
        (("lens=kannala_brandt", "lens.k=[-5,0,0,0]"), r"lens.k must be .* Lower lens.fov \(or"),
        (("lens=opencv", "lens.k=[1,2,3]"), "coefficients for pinhole and opencv, got 3"),
        (("lens=fisheye", "lens.k=[1,2,3]"), "lens.k must hold 5 coefficients for fisheye, got 3"),
        (
            ("lens=fisheye", "lens.fov=null"),
            r"lens.fov must be in \(0, 360\] for fisheye, got None",
        ),
    ],
)
def test_a_lens_that_cannot_be_is_named_as_the_user_wrote_it(words, message):
    with pytest.raises(ValueError, match=message):
        preset(*words)


REMEDY = re.compile(r"(?:^|\. )((?:Lower|Raise|Give|Use|Set|Write|Leave|Choose|Fit|Take)\b.*)")
KEY = re.compile(r"\b((?:lens|aperture|film|shutter|trajectory|sensor|camera|imu)\.[a-z_]+)\b")


def texts(tree):
    """All texts of a module, those of an f-string as one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(
                str(getattr(x, "value", "")) for x in node.values if isinstance(x, ast.Constant)
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_remedies_name_keys_that_there_are():
    named = set()
    for path in Path(camera.__path__[0]).rglob("*.py"):
        for text in texts(ast.parse(path.read_text())):
            for remedy in REMEDY.findall(" ".join(text.split())):
                named |= set(KEY.findall(remedy))
    # Keys of the command line, and of the lens block in the JSON of a capture.
    known = {*keys("render"), *keys("reconstruct")}
    known |= {f"lens.{key}" for model in lens_models() for key in model.block_keys}
    assert {"lens.fov", "lens.crop"} <= named and named <= known, named - known
