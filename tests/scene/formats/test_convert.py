"""Models come in as they are and go out as they look."""

import dataclasses
import math

import equinox as eqx
import foreign
import jax
import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest
import reference
import toy

import gaussray
from gaussray.cli.main import main
from gaussray.color import srgb_decode, srgb_encode
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.formats.any_file import export_format
from gaussray.scene.formats.color_space import convert_harmonics
from gaussray.scene.formats.convert import export_model, import_model
from gaussray.scene.formats.gaussian_ply import read_gaussians, write_gaussians
from gaussray.scene.gaussians import Gaussians, fold_tint
from gaussray.scene.scene import at
from gaussray.scene.store import load_scene, save_scene


pytestmark = pytest.mark.usefixtures("known_sizes")

# A few operations in single precision on numbers around 1.
SINGLE = 2e-6
# A stored logarithm of a scale or logit of an opacity is below 4 in size.
STORED = 4 * 2.0**-23
# The colours go through single precision twice, and the steepest part of the curve is 12.92.
CURVE = 12.92 * SINGLE
# Colours that vary by 0.034 (root mean square) around 0.5: its square, times half the curvature of
# the curve over its slope, which is at most 1.3, is what harmonics of degree 3 can miss.
SMOOTH = 1.3 * 0.034**2
# The same from directions by chance instead of all, and terms of higher order.
CHANCE = 0.3
# What was asked of an imported network: single precision leaves a few times 1e-6 after its layers.
LAYERS = 1e-5
# Single precision in the network, the harmonics and the sum of a few Gaussians.
SHADED = 1e-4
# A pixel between two of the 255 steps of a PNG may fall to either side.
CODE = 1


def random_gaussians(coefficients=16, count=9, tint=True, spread=0.3, seed=0):
    """Gaussians whose colours change with the direction."""
    draw = np.random.default_rng(seed)
    parts = (
        draw.normal(size=(count, 3)),
        draw.normal(size=(count, 4)),
        np.exp(draw.normal(size=(count, 3)) - 2),
        draw.uniform(0.1, 0.9, count),
        spread * draw.normal(size=(count, coefficients, 3)),
        np.exp(draw.normal(size=(count, 3))) if tint else None,
    )
    return Gaussians(*(None if x is None else toy.single(x) for x in parts))


def directions(count=40):
    way = np.random.default_rng(5).normal(size=(count, 3))
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def colors(gaussians):
    """What is seen from random directions, by the definition, in double precision."""
    seen = reference.light(np.asarray(gaussians.harmonics, np.float64), directions())
    return seen if gaussians.tint is None else seen * np.asarray(gaussians.tint, np.float64)


def same(a, b, rtol=STORED):
    """Equal shapes in space, whatever the length of the quaternions."""
    for name in ("mean", "scale", "opacity"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=rtol)
    units = (np.asarray(x.quat) / np.linalg.norm(x.quat, axis=1, keepdims=True) for x in (a, b))
    np.testing.assert_allclose(*units, atol=SINGLE)


MODEL_TIMES = (0.0, 0.4, 1.0)


def imported(tmp_path, *words, **how):
    """A model of 4DGaussians on disk, and the scene that the verb makes of it."""
    tensors, table = foreign.state(), foreign.cloud()
    folder = foreign.write_model(tmp_path / "model", tensors, table, **how)
    main(["import", f"source={folder}", f"out={tmp_path}/run", *words])
    return load_scene(tmp_path / "run"), tensors, table


@pytest.fixture
def moving(tmp_path):
    """A scene that moves and changes its light, on disk."""
    scene = toy.scene()
    light = jnp.full_like(scene.deformation.light, -0.3).at[0].set(0.5)
    scene = eqx.tree_at(lambda s: s.deformation.light, scene, light)
    save_scene(tmp_path / "run" / "scene.npz", scene)
    return scene


def test_a_folded_tint_looks_the_same_from_everywhere_also_where_black_is_clamped():
    plain = random_gaussians(spread=1.0)
    assert np.mean(colors(plain) == 0) > 0.1
    np.testing.assert_allclose(colors(fold_tint(plain)), colors(plain), atol=20 * SINGLE)
    assert fold_tint(plain).tint is None
    untinted = random_gaussians(tint=False)
    assert fold_tint(untinted) is untinted


@pytest.mark.parametrize("encode", [True, False])
@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_a_colour_that_is_the_same_from_everywhere_is_converted_exactly(encode, coefficients):
    harmonics = jnp.zeros((50, coefficients, 3), jnp.float32)
    harmonics = harmonics.at[:, 0].set(random_gaussians(1, 50, spread=2.0).harmonics[:, 0])
    result, error = convert_harmonics(harmonics, encode=encode)
    plain = np.maximum(0.5 + np.asarray(harmonics[:, 0], np.float64) / (2 * math.sqrt(math.pi)), 0)
    expected = srgb_encode(plain) if encode else srgb_decode(plain)
    seen = reference.light(np.asarray(result, np.float64), directions())
    np.testing.assert_allclose(seen, np.broadcast_to(expected, seen.shape), atol=CURVE)
    assert error < CURVE


@pytest.mark.parametrize("encode", [True, False])
def test_the_error_of_a_smooth_colour_is_small_and_of_second_order(encode):
    errors = []
    for spread in (0.03, 0.015):
        plain = random_gaussians(16, 30, tint=False, spread=spread)
        result, error = convert_harmonics(plain.harmonics, encode=encode)
        before, after = colors(plain), colors(eqx.tree_at(lambda g: g.harmonics, plain, result))
        off = after - srgb_encode(before) if encode else srgb_encode(after) - before
        np.testing.assert_allclose(error, np.sqrt(np.mean(off**2)), rtol=CHANCE)
        errors.append(error)
    assert 0 < errors[0] < SMOOTH
    np.testing.assert_allclose(errors[0] / errors[1], 4, rtol=CHANCE)


def test_the_conversion_does_not_depend_on_the_blocks(monkeypatch):
    harmonics = random_gaussians(9, 20).harmonics
    whole, error = convert_harmonics(harmonics, encode=True)
    monkeypatch.setattr("gaussray.scene.formats.color_space.CONVERSION_BLOCK", 7)
    parts, again = convert_harmonics(harmonics, encode=True)
    np.testing.assert_allclose(parts, whole, atol=SINGLE)
    assert math.isclose(error, again, rel_tol=SINGLE)


def test_an_imported_model_is_the_scene_that_is_loaded(tmp_path, capsys):
    plain = random_gaussians(tint=False)
    write_gaussians(tmp_path / "model.ply", plain)
    main(["import", f"source={tmp_path}/model.ply", f"out={tmp_path}/run", "color=linear"])
    scene = load_scene(tmp_path / "run")
    assert scene.deformation is None and scene.moving.count == 0
    np.testing.assert_array_equal(scene.time_range, [0, 1])
    found = at(scene, toy.single(0.5))
    for a, b in zip(
        jax.tree.leaves(found), jax.tree.leaves(read_gaussians(tmp_path / "model.ply")), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    same(found, plain)
    out = capsys.readouterr().out
    assert "9 Gaussians" in out and (tmp_path / "run" / "config.yaml").is_file()
    for assumed in ("linear light", "harmonics=center", "dilation=0.3", "trace.alpha_min"):
        assert assumed in out.replace("\n", " ")


def test_codes_become_light(tmp_path):
    """A model fitted to 8-bit pictures shows the code 0.5 where it says 0.5."""
    write_gaussians(tmp_path / "model.ply", random_gaussians(4, tint=False, spread=0.0))
    scene, said = import_model(tmp_path / "model.ply", tmp_path / "run")
    np.testing.assert_allclose(colors(scene.static), srgb_decode(np.array(0.5)), atol=CURVE)
    assert "sRGB values, now linear light, off by" in said


@pytest.mark.slow
def test_an_imported_model_of_4dgaussians_moves_as_it_did(tmp_path, capsys):
    scene, tensors, table = imported(tmp_path, "color=linear")
    for time in MODEL_TIMES:
        found, expected = at(scene, toy.single(time)), foreign.forward(tensors, table, time)
        for name in ("mean", "scale", "opacity", "harmonics"):
            np.testing.assert_allclose(getattr(found, name), expected[name], atol=LAYERS)
    out = capsys.readouterr().out
    assert "12 Gaussians" in out and "iteration_20/point_cloud.ply" in out
    assert "what changes over the times 0 to 1: place, rotation, size, opacity, colour." in out
    assert "render.chunk_rows=1" in out


def test_codes_that_change_become_light_at_every_time(tmp_path):
    scene, tensors, table = imported(tmp_path)
    assert scene.deformation.encoded
    for time in MODEL_TIMES:
        codes = toy.single(foreign.forward(tensors, table, time)["harmonics"])
        expected, _ = convert_harmonics(codes, encode=False)
        # The curve's slope reaches 4 where the codes reach 2.
        np.testing.assert_allclose(at(scene, toy.single(time)).harmonics, expected, atol=4 * LAYERS)
    assert np.abs(expected - codes).max() > 0.1


@pytest.mark.parametrize(
    "out, chosen, sequence, expected",
    [
        ("a.ply", None, False, "ply"),
        ("A.SPZ", None, False, "spz"),
        ("a.spz", "spz4", False, "spz4"),
        ("a.ftgs.ply", None, False, "ftgs"),
        ("a.usdc", None, True, "usd"),
        ("frames", None, True, "ply"),
        ("frames", "glb", True, "glb"),
        ("a.bin", "ply", False, "ply"),
    ],
)
def test_the_name_of_an_exported_file_says_its_format(out, chosen, sequence, expected):
    assert export_format(out, chosen, sequence=sequence) == expected


def test_a_name_without_a_format_and_a_format_against_the_name_are_refused(tmp_path, capsys):
    with pytest.raises(ValueError, match="names the format spz, got format=ply"):
        export_format("a.spz", "ply", sequence=False)
    with pytest.raises(SystemExit):
        main(["export", "scene=sample", f"out={tmp_path}/a.foo", "time=0.5"])
    assert "out must end in one of .ftgs.ply, .ply" in capsys.readouterr().err
    assert not (tmp_path / "a.foo").exists()


def test_codes_that_stay_become_light_once(tmp_path):
    scene, _, table = imported(tmp_path, no_dshs=True)
    assert not scene.deformation.encoded and scene.deformation.harmonics is None
    expected, _ = convert_harmonics(toy.single(foreign.columns(table)["shs"]), encode=False)
    for time in MODEL_TIMES:
        np.testing.assert_array_equal(at(scene, toy.single(time)).harmonics, expected)


def test_a_frame_of_a_model_goes_out_again(tmp_path):
    """What a viewer reads is the model's own forward at that time."""
    scene, tensors, table = imported(tmp_path, "color=linear", "iteration=20")
    for time in MODEL_TIMES:
        words = [f"scene={tmp_path}/run", f"time={time}", f"out={tmp_path}/a.ply"]
        main(["export", *words, "color=linear"])
        found, expected = read_gaussians(tmp_path / "a.ply"), foreign.forward(tensors, table, time)
        for name in ("mean", "scale", "quat", "opacity", "harmonics"):
            np.testing.assert_allclose(getattr(found, name), expected[name], atol=LAYERS)


def test_a_model_of_another_program_is_exported_to_another_format(tmp_path):
    """`export` reads what `render` reads: here a .ply file, written as .glb and read again."""
    write_gaussians(tmp_path / "a.ply", toy.gaussians([[1, 2, 3], [0, 1, 0]], 0.1, 0.5))
    for source, target in (("a.ply", "b.glb"), ("b.glb", "c.ply")):
        words = [f"scene={tmp_path / source}", f"out={tmp_path / target}", "degree=0"]
        main(["export", *words])
    found, expected = (read_gaussians(tmp_path / name) for name in ("c.ply", "a.ply"))
    for name in ("mean", "scale", "opacity", "harmonics"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=SHADED)


@pytest.mark.slow
def test_a_model_is_filmed_row_by_row_or_with_the_light_of_the_middle_row(tmp_path):
    scene, _, _ = imported(tmp_path)
    readout, last = 0.4, 14

    def renderer(**options):
        return Renderer(scene, options=RenderOptions(samples=1, **options), trace=toy.TRACE)

    rolling = toy.rolling(toy.camera(time=0.5, height=last + 1), readout)
    by_row, by_key = (renderer(**how)(rolling).color for how in ({"chunk_rows": 1}, {"keys": 3}))
    film = renderer()
    for row in (0, last // 2):
        still = film(toy.camera(time=0.3 + readout * row / last, height=last + 1)).color[row]
        assert np.ptp(still) > 100 * SHADED
        np.testing.assert_allclose(by_row[row], still, atol=SHADED)
    np.testing.assert_allclose(by_key[last // 2], still, atol=SHADED)
    assert np.abs(by_row - by_key).max() > 100 * SHADED


def test_an_export_is_the_scene_at_an_instant(moving, tmp_path, capsys):
    files = {}
    for time in (0.0, 0.3, 1.0):
        path = tmp_path / "frames" / f"{time}.ply"
        main(["export", f"scene={tmp_path}/run", f"time={time}", f"out={path}", "color=linear"])
        files[time] = read_gaussians(path)
        expected = at(moving, toy.single(time))
        assert np.ptp(expected.tint) > 0.1
        same(files[time], expected)
        np.testing.assert_allclose(colors(files[time]), colors(expected), atol=SINGLE)
        assert files[time].harmonics.shape[1] == 16 and files[time].tint is None
    assert np.max(np.abs(files[1.0].mean - files[0.0].mean)) > 0.5
    assert "27 Gaussians, colours as linear light" in capsys.readouterr().out


def test_an_export_shows_the_codes_of_the_light(tmp_path):
    scene = toy.scene(speed=0)
    written, said = export_model(scene, tmp_path / "a.ply", degree=0)
    expected = srgb_encode(colors(at(scene, toy.single(0))))
    np.testing.assert_allclose(colors(read_gaussians(tmp_path / "a.ply")), expected, atol=CURVE)
    assert written.harmonics.shape[1] == 1 and "sRGB values" in said


@pytest.mark.parametrize("color", ["srgb", "linear"])
def test_what_went_out_comes_in_again(tmp_path, color):
    scene = toy.scene(speed=0)
    export_model(scene, tmp_path / "a.ply", 0.7, color=color)
    again, _ = import_model(tmp_path / "a.ply", tmp_path / "run", color=color)
    before, after = (at(x, toy.single(0)) for x in (scene, again))
    same(before, after)
    np.testing.assert_allclose(colors(after), colors(before), atol=CURVE)


@pytest.mark.slow
def test_an_imported_model_is_filmed_by_the_cameras_of_a_capture(tmp_path):
    """The pictures are those of the scene that was exported."""
    scene = toy.scene(speed=0)
    capture = toy.write_capture(tmp_path / "capture", scene)
    export_model(scene, tmp_path / "a.ply")
    main(["import", f"source={tmp_path}/a.ply", f"out={tmp_path}/run"])
    trace = [f"trace.{name}={getattr(toy.TRACE, name)}" for name in ("levels", "group", "chunk")]
    words = [f"scene={tmp_path}/run", f"cameras={capture}", f"out={tmp_path}/film", "quiet=true"]
    main(["render", *words, "camera.times=[0.0]", "render.samples=1", *trace])
    name = toy.CAMERAS[-1]
    film = tmp_path / "film" / "images" / "pinhole" / name / "0000.png"
    truth = capture / "images" / name / "0000.png"
    ours, real = (
        oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8).astype(int) for path in (film, truth)
    )
    assert np.ptp(real) > 0
    np.testing.assert_allclose(ours, real, atol=CODE)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["time=1.5"], "time must be in the scene's range 0 ... 1, got 1.5"),
        (["time=-0.1"], "time must be in the scene's range 0 ... 1, got -0.1"),
        (["time=nan"], "time must be a number, got nan"),
        ([], "time must be given for a scene that changes, in its range 0 ... 1"),
        (["time=soon"], "time must be a number, got 'soon'"),
        (
            ["time=0", "format=obj"],
            "a.ply names the format",
        ),
        (["time=0", "color=red"], "color must be one of srgb, linear, got 'red'"),
        (["time=0", "degree=4"], "degree must be in 0 ... 3 for this scene, got 4"),
    ],
)
def test_an_export_that_cannot_be(moving, tmp_path, capsys, words, message):
    with pytest.raises(SystemExit):
        main(["export", f"scene={tmp_path}/run", f"out={tmp_path}/a.ply", *words])
    assert message in capsys.readouterr().err
    assert not (tmp_path / "a.ply").exists()


def test_a_degree_below_the_scenes_is_refused(tmp_path):
    write_gaussians(tmp_path / "a.ply", random_gaussians(9, tint=False))
    scene, _ = import_model(tmp_path / "a.ply", tmp_path / "run")
    with pytest.raises(ValueError, match=r"degree must be in 2 \.\.\. 3 for this scene, got 1"):
        export_model(scene, tmp_path / "b.ply", degree=1)


def test_an_import_that_cannot_be_leaves_nothing(tmp_path, capsys):
    (tmp_path / "a.ply").write_text("a text")
    for words, message in (
        (["source=none.ply"], "none.ply: no such file"),
        ([f"source={tmp_path}/a.ply"], "must begin with the line 'ply'"),
        ([f"source={tmp_path}/a.ply", "color=red"], "color must be one of"),
        ([f"source={tmp_path}"], "holds no point_cloud.ply"),
        ([f"source={tmp_path}/a.ply", "iteration=2"], "iteration must be null unless"),
        ([f"source={tmp_path}/a.ply", "iteration=new"], "iteration must be a whole number"),
    ):
        with pytest.raises(SystemExit):
            main(["import", f"out={tmp_path}/run", *words])
        assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_scene_is_not_overwritten(moving, tmp_path):
    write_gaussians(tmp_path / "a.ply", random_gaussians(1, tint=False))
    before = (tmp_path / "run" / "scene.npz").read_bytes()
    with pytest.raises(ValueError, match="holds a scene already"):
        import_model(tmp_path / "a.ply", tmp_path / "run")
    assert (tmp_path / "run" / "scene.npz").read_bytes() == before


@pytest.mark.parametrize("name", ["a.ply", "a.glb", "a.spz"])
def test_a_quaternion_of_zeros_is_no_rotation(tmp_path, name):
    made = gaussray.Gaussians.colored([[0, 0, 0], [1, 0, 0]], [1, 0, 0], scale=[0.1, 0.2, 0.3])
    scene = gaussray.Scene(dataclasses.replace(made, quat=np.array([[0.0] * 4, [1, 0, 0, 0]])))
    gaussray.save(tmp_path / name, scene)
    quat = np.asarray(gaussray.load(tmp_path / name).static.quat)
    np.testing.assert_allclose(np.abs(quat[0]), np.abs(quat[1]), atol=1e-3)


def test_a_scene_without_gaussians_is_not_exported(tmp_path):
    empty = gaussray.Scene(gaussray.Gaussians.colored(np.zeros((0, 3)), [1, 0, 0]))
    with pytest.raises(ValueError, match="scene must have Gaussians at this time"):
        gaussray.save(tmp_path / "a.ply", empty)
