"""A moving scene as a sequence of files, and as one USD file with time samples."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.cli.main import main
from gaussray.color import srgb_encode
from gaussray.scene.formats.convert import gaussians_at
from gaussray.scene.formats.gaussian_ply import read_gaussians
from gaussray.scene.formats.sequence import export_sequence
from gaussray.scene.scene import at
from gaussray.scene.store import save_scene


# Rounding of single precision, through log and logit.
SINGLE = 1e-5


@pytest.fixture(scope="module")
def moving():
    return toy.scene(speed=1.0)


def test_a_sequence_has_a_file_for_each_timestamp(moving, tmp_path, capsys):
    save_scene(tmp_path / "scene.npz", moving)
    words = [f"scene={tmp_path}/scene.npz", f"out={tmp_path}/frames", "count=3"]
    main(["export", *words, "color=linear", "progress=lines"])
    listed = json.loads((tmp_path / "frames/times.json").read_text())["frames"]
    assert [one["time"] for one in listed] == [0.0, 0.5, 1.0]
    for one in listed:
        found = read_gaussians(tmp_path / "frames" / one["file"])
        expected = at(moving, jnp.float32(one["time"]))
        np.testing.assert_allclose(found.mean, expected.mean, atol=SINGLE)
    assert listed[2]["file"] == "frame_0002.ply"
    assert "3 files, at the times 0 to 1" in capsys.readouterr().out


def test_a_shorter_sequence_leaves_no_file_of_a_longer_one(moving, tmp_path):
    export_sequence(moving, tmp_path, 3)
    (tmp_path / "frame_0009.ply").write_text("of somebody else")
    export_sequence(moving, tmp_path, 2)
    names = sorted(path.name for path in tmp_path.glob("frame_*"))
    assert names == ["frame_0000.ply", "frame_0001.ply", "frame_0009.ply"]


def test_a_file_of_times_names_no_other_file(moving, tmp_path):
    (tmp_path / "keep.txt").write_text("")
    listed = {"frames": [{"file": "keep.txt"}, {"file": "../frame_0007.ply"}, {"file": 1}]}
    (tmp_path / "times.json").write_text(json.dumps(listed))
    export_sequence(moving, tmp_path, 1)
    assert (tmp_path / "keep.txt").exists()


def test_a_time_and_a_count_exclude_each_other(moving, tmp_path, capsys):
    save_scene(tmp_path / "scene.npz", moving)
    words = [f"scene={tmp_path}/scene.npz", f"out={tmp_path}/frames", "count=3", "time=0.5"]
    with pytest.raises(SystemExit):
        main(["export", *words])
    assert "time must be null with count=3, got 0.5" in capsys.readouterr().err
    with pytest.raises(ValueError, match="count must be at least 1, got -1"):
        export_sequence(moving, tmp_path / "frames", -1)


@pytest.mark.parametrize("count", [1, 3])
def test_openusd_reads_the_gaussians_of_every_time_code(moving, tmp_path, count):
    pxr = pytest.importorskip("pxr", reason="an extra")
    from pxr import Usd, UsdGeom, UsdVol

    assert pxr
    export_sequence(moving, tmp_path / "a.usdc", count, format="usd")
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and prim
    flip = np.array([-1, -1, 1])
    for code, time in enumerate(np.linspace(0, 1, count)):
        expected, _ = gaussians_at(moving, float(time), color="srgb", degree=3)
        mean = np.array(prim.GetPositionsAttr().Get(code))
        np.testing.assert_allclose(mean, np.asarray(expected.mean) * flip, atol=SINGLE)
        coefficients = prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(code)
        shown = 0.5 + 0.28209479177387814 * np.array(coefficients).reshape(-1, 16, 3)[:, 0]
        light = np.maximum(
            0.5 + 0.28209479177387814 * np.asarray(at(moving, jnp.float32(time)).harmonics[:, 0]), 0
        )
        np.testing.assert_allclose(shown, srgb_encode(light), atol=1e-4)
        for quat, own in zip(prim.GetOrientationsAttr().Get(code), expected.quat, strict=True):
            w, x, y, z = (np.asarray(own) / np.linalg.norm(own)).tolist()
            told = [quat.GetReal(), *quat.GetImaginary()]
            # The half turn about z times the quaternion, up to the sign.
            assert abs(np.dot(told, [-z, -y, x, w])) == pytest.approx(1, abs=SINGLE)
    space = prim.GetRadianceSphericalHarmonicsCoefficientsAttr().GetColorSpace()
    assert space == "srgb_rec709_scene"
    assert prim.GetRadianceSphericalHarmonicsDegreeAttr().Get() == 3
    low, high = prim.GetExtentAttr().Get(0)
    assert np.all(np.array(low) < mean.min(axis=0)) and np.all(np.array(high) > mean.max(axis=0))


def test_openusd_finds_nothing_wrong(moving, tmp_path):
    pytest.importorskip("pxr", reason="an extra")
    from pxr import Usd, UsdValidation

    export_sequence(moving, tmp_path / "a.usda", 2, format="usd")
    context = UsdValidation.ValidationContext(
        UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    )
    errors = context.Validate(Usd.Stage.Open(str(tmp_path / "a.usda")))
    assert not [error.GetMessage() for error in errors]


def test_another_ending_is_refused(moving, tmp_path):
    with pytest.raises(ValueError, match="out must end in .usd, .usdc or .usda"):
        export_sequence(moving, tmp_path / "a.ply", 2, format="usd")
