"""Effects are named after the cameras that show them, whoever gave them: options or a manifest."""

import dataclasses

import jax.numpy as jnp
import pytest
import toy

from gaussray.camera.lens import KannalaBrandt
from gaussray.camera.shutter import Shutter, interlaced_row_times
from gaussray.capture.formats.paired import read_views
from gaussray.dataset.manifest import write_manifest
from gaussray.render.rig import rig
from gaussray.render.rig.view_files import load_views


def manifest(folder, name="effect.json", **parts):
    """A manifest of two cameras, the first of which has other parts."""
    listed = toy.records()[2:4]
    camera = dataclasses.replace(listed[0].camera, **parts)
    listed = [dataclasses.replace(listed[0], camera=camera), listed[1]]
    effect = "pinhole" if name == "transforms.json" else name.removesuffix(".json")
    write_manifest(folder / name, [dataclasses.replace(one, effect=effect) for one in listed])
    return folder / name


def named(views, **groups):
    options = rig.RigOptions(camera=rig.CameraOptions(split="all"), **groups)
    (name,) = {one.effect for one in rig.frame_records(views, options=options, samples=1)}
    return name


def shutter(**parts):
    zero = toy.single(0)
    return Shutter(**({"row_offset": zero, "row_step": zero, "exposure": zero} | parts))


FIELDS = toy.single(interlaced_row_times(toy.SIZE, 0.1, "odd"))


@pytest.mark.parametrize(
    ("parts", "name"),
    [
        ({"shutter": shutter(row_step=toy.single(0.01))}, "rolling_shutter"),
        ({"shutter": shutter(row_times=jnp.linspace(0, 1, toy.SIZE) ** 2)}, "rolling_shutter"),
        ({"shutter": shutter(row_times=FIELDS)}, "interlaced"),
        (
            {"shutter": shutter(row_times=FIELDS, row_step=toy.single(0.01))},
            "rolling_shutter+interlaced",
        ),
        ({"shutter": shutter(exposure=toy.single(0.1))}, "motion_blur"),
        ({"shutter": shutter(trigger=toy.single(0.1))}, "pinhole"),
        ({}, "pinhole"),
    ],
)
def test_the_shutter_of_a_manifest_is_named(tmp_path, parts, name):
    assert named(read_views(manifest(tmp_path, **parts))) == name


def test_lens_and_aperture_of_a_manifest_are_named_unless_the_options_set_them(tmp_path):
    blurred = dataclasses.replace(toy.camera().aperture, radius=toy.single(0.1))
    lens = KannalaBrandt(
        toy.single([9.0, 9.0]), toy.single([8.0, 8.0]), toy.single([0.0] * 4), toy.single(1.0)
    )
    step = shutter(row_step=toy.single(0.01))
    views = read_views(manifest(tmp_path, lens=lens, aperture=blurred, shutter=step))
    assert named(views) == "fisheye+depth_of_field+rolling_shutter"
    assert named(views, lens=rig.LensOptions("pinhole", 60.0)) == "depth_of_field+rolling_shutter"
    assert named(views, aperture=rig.ApertureOptions(0.0)) == "fisheye+rolling_shutter"
    still = rig.ShutterOptions("global", exposure=0.1)
    assert named(views, shutter=still) == "fisheye+depth_of_field+motion_blur"
    fields = rig.ShutterOptions("table", row_times=tuple(FIELDS.tolist()))
    assert named(views, shutter=fields) == "fisheye+depth_of_field+interlaced"


def test_the_folder_that_a_render_wrote_is_read_from_its_only_manifest(tmp_path):
    path = manifest(tmp_path, "rolling_shutter.json", shutter=shutter(row_step=toy.single(0.01)))
    assert len(load_views("scene.npz", tmp_path)) == 2
    # The ground truth beside it is no other effect.
    truth = [dataclasses.replace(one, effect="sharp") for one in toy.records()[:2]]
    write_manifest(tmp_path / "sharp.json", truth)
    views = load_views("scene.npz", tmp_path)
    assert float(views[0].camera.shutter.row_step) == pytest.approx(0.01)
    manifest(tmp_path, "fisheye.json")
    with pytest.raises(ValueError, match=r"no transforms.json but .*: fisheye.json, rolling_shutt"):
        load_views("scene.npz", tmp_path)
    manifest(tmp_path, "transforms.json")
    assert named(load_views("scene.npz", tmp_path)) == "pinhole"
    assert path.is_file()
