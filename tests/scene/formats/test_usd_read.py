"""USD files are read with their transforms; what is no USD file is refused."""

import jax.numpy as jnp
import numpy as np
import pytest
from splats import gaussians, turned

from gaussray.scene.formats.convert import model_scene
from gaussray.scene.formats.gaussian_folder import read_model, stated_color
from gaussray.scene.formats.usd import read_usd, write_usd
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import harmonic_basis


pytest.importorskip("pxr", reason="an extra")

# Rounding of single precision; of half precision, of values of order 1.
SINGLE, HALF = 1e-5, 4e-3


def shown(harmonics, direction):
    """The colour in a direction, before it is clipped."""
    terms = harmonic_basis(jnp.asarray(direction, jnp.float32), len(harmonics))
    return 0.5 + np.stack([np.asarray(x) for x in terms]) @ np.asarray(harmonics)


def agree(found, true, tolerance=SINGLE):
    for name in ("mean", "scale", "opacity", "harmonics"):
        value = getattr(true, name)
        np.testing.assert_allclose(getattr(found, name), value, rtol=tolerance, atol=tolerance)
    assert turned(found, true) < max(1e-6, tolerance**2)


@pytest.mark.ci
@pytest.mark.parametrize("color", ["srgb", "linear"])
@pytest.mark.parametrize("coefficients", [1, 16])
def test_what_is_read_is_what_was_written(tmp_path, color, coefficients):
    true, path = gaussians(coefficients=coefficients), tmp_path / "a.usdc"
    write_usd(path, [true], color)
    found, stated = read_usd(path)
    assert stated == color == stated_color(path)
    agree(found, true)
    scene, _, _ = model_scene(path, color="linear" if color == "srgb" else "srgb")
    if color == "linear":
        agree(scene.static, true)


def test_transforms_axes_and_units_of_a_stage_are_applied(tmp_path):
    """A turn about x and a scale of 2 at (1, 2, 3), in a world of centimetres whose z is up: seen
    from anywhere, colours are those of the turned Gaussian."""
    from pxr import Gf, Usd, UsdGeom

    true = gaussians(count=5)
    write_usd(tmp_path / "a.usda", [true], "linear")
    stage = Usd.Stage.CreateNew(str(tmp_path / "b.usda"))
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    prim = UsdGeom.Xform.Define(stage, "/above")
    prim.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    prim.AddRotateXOp().Set(90.0)
    prim.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    below = stage.DefinePrim("/above/below")
    below.GetReferences().AddReference(str(tmp_path / "a.usda"), "/Gaussians")
    stage.Save()
    found, _ = read_usd(tmp_path / "b.usda")
    # From axes of PLY files to those of the file and back; a quarter turn about x undoes z up.
    flip = np.diag([-1.0, -1, 1])
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    whole = flip @ upright @ turn @ flip
    moved = 0.01 * flip @ upright @ [1, 2, 3]
    np.testing.assert_allclose(whole, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(found.mean, 0.02 * np.asarray(true.mean) + moved, atol=SINGLE)
    np.testing.assert_allclose(found.scale, 0.02 * true.scale, rtol=SINGLE)
    assert turned(found, true) < 1e-6
    np.testing.assert_allclose(found.harmonics, true.harmonics, atol=SINGLE)


def test_a_turned_prim_keeps_the_colour_of_each_side(tmp_path):
    from pxr import Usd, UsdGeom

    true = gaussians(count=3)
    write_usd(tmp_path / "a.usda", [true], "linear")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    UsdGeom.Xformable(stage.GetDefaultPrim()).AddRotateYOp().Set(90.0)
    stage.GetRootLayer().Export(str(tmp_path / "b.usda"))
    found, _ = read_usd(tmp_path / "b.usda")
    # About the upward y of the file, which is -y here: z comes to x, x to -z; signs of x change.
    turn = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(found.mean, np.asarray(true.mean) @ turn.T, atol=SINGLE)
    side = np.array([0.6, -0.48, 0.64], np.float32)
    for own, other in zip(true.harmonics, found.harmonics, strict=True):
        np.testing.assert_allclose(shown(other, turn @ side), shown(own, side), atol=1e-4)


def test_half_precision_and_time_samples_are_read(tmp_path):
    from pxr import Usd, UsdVol, Vt

    true = gaussians(count=7, coefficients=4)
    later = Gaussians(true.mean + 1, true.quat, true.scale, true.opacity, true.harmonics)
    write_usd(tmp_path / "a.usda", [true, later], "srgb")
    with pytest.warns(UserWarning, match="2 time samples, of which the first is read"):
        found, _, _ = read_model(tmp_path / "a.usda")
    agree(found, true)
    write_usd(tmp_path / "b.usda", [true], "srgb")
    stage = Usd.Stage.Open(str(tmp_path / "b.usda"))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    values = np.array(prim.GetPositionsAttr().Get())
    prim.CreatePositionshAttr(Vt.Vec3hArray.FromNumpy(values.astype(np.float16)))
    prim.GetPrim().RemoveProperty("positions")
    stage.GetRootLayer().Export(str(tmp_path / "c.usda"))
    agree(read_usd(tmp_path / "c.usda")[0], true, HALF)


def test_what_holds_no_gaussians_is_refused(tmp_path):
    from pxr import Usd, UsdGeom

    with pytest.raises(FileNotFoundError, match="no such file"):
        read_usd(tmp_path / "a.usda")
    (tmp_path / "a.usda").write_text("what is this")
    with pytest.raises(ValueError, match="must be a USD file"):
        read_usd(tmp_path / "a.usda")
    stage = Usd.Stage.CreateNew(str(tmp_path / "b.usda"))
    UsdGeom.Sphere.Define(stage, "/ball")
    stage.Save()
    with pytest.raises(ValueError, match="ParticleField3DGaussianSplat"):
        read_usd(tmp_path / "b.usda")
    write_usd(tmp_path / "c.usda", [gaussians(count=2)], "srgb")
    stage = Usd.Stage.Open(str(tmp_path / "c.usda"))
    UsdGeom.Xformable(stage.GetDefaultPrim()).AddScaleOp().Set((1, 2, 1))
    stage.GetRootLayer().Export(str(tmp_path / "d.usda"))
    with pytest.raises(ValueError, match="scale all axes alike"):
        read_usd(tmp_path / "d.usda")
    stage.GetDefaultPrim().GetAttribute("scales").Set([(1, 1, 1)])
    stage.GetDefaultPrim().RemoveProperty("xformOpOrder")
    stage.GetRootLayer().Export(str(tmp_path / "e.usda"))
    with pytest.raises(ValueError, match="for each position"):
        read_usd(tmp_path / "e.usda")
