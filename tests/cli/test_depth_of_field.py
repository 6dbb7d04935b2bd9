"""What `gaussray render` says about depth of field, and the numbers that its files hold."""

import json

import pytest
import rooms

from gaussray.cli.main import main


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return rooms.write_scene(tmp_path_factory.mktemp("run"))


def words(run, out, *more):
    trace = ("trace.levels=0", "trace.group=2", "trace.chunk=8")
    return ["render", f"scene={run}", f"out={out}", "camera.names=[cam_0]", "report=false",
            "progress=lines", *trace, *more]  # fmt: skip


def apertures(path):
    manifest = json.loads(path.read_text())
    return [frame.get("aperture") or manifest["aperture"] for frame in manifest["frames"]]


@pytest.mark.usefixtures("known_sizes")
def test_a_preset_is_told_in_scene_units_which_give_the_same_picture(run, tmp_path, capsys):
    main(words(run, tmp_path / "a", "aperture=cat_eye"))
    told = capsys.readouterr().out
    assert "(what the middle of the first picture shows)" in told and "(3.6%)" in told
    # The toy's camera is 3 from the origin, where its wall is 3.8 away.
    opened = apertures(tmp_path / "a" / "depth_of_field.json")
    assert len(opened) == 3 and all(x == opened[0] for x in opened)
    focus, radius = opened[0]["focus_distance"], opened[0]["radius"]
    assert 2.5 < focus < 4 and radius == pytest.approx(0.036 * focus, rel=5e-3)
    assert opened[0]["rim"]["distance"] == pytest.approx(0.06 * focus, rel=5e-3)
    assert f"focus_distance={focus:g} " in told and f"radius={radius:g} " in told
    numbers = [word.split(" ")[0] for word in told.split("scene units: ")[1].split(", ")]
    keys = [f"aperture.{number}" for number in numbers]
    main(words(run, tmp_path / "b", "aperture=cat_eye", *keys))
    assert "Depth of field" not in capsys.readouterr().out
    name = "images/depth_of_field/cam_0/0001.png"
    assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.usefixtures("known_sizes")
def test_few_rays_for_much_blur_are_told_once_with_the_keys(run, tmp_path, capsys):
    wide = ("aperture.radius=1.5", "aperture.focus_distance=0.5")
    main(words(run, tmp_path / "a", *wide))
    told = capsys.readouterr().out
    assert told.count("displaced copies") == 1
    assert "render.samples (about" in told and "aperture.radius (1.5)" in told
    narrow = ("aperture.radius=0.01", "aperture.focus_distance=3")
    main(words(run, tmp_path / "b", *narrow))
    assert "displaced copies" not in capsys.readouterr().out
    few = ("render.error=0.1", "render.samples_most=16")
    main(words(run, tmp_path / "c", *wide, *few))
    assert "displaced copies" not in capsys.readouterr().out


@pytest.mark.usefixtures("known_sizes")
def test_samples_of_a_dataset_hold_numbers(run, tmp_path):
    drawn = ("dataset.count=2", "aperture=wide", "sample.aperture.blades.choice=[0,6]")
    drawn += ("sample.aperture.focus_distance.choice=[auto,150%]", "dataset.clearance=0")
    main(words(run, tmp_path, *drawn))
    lines = (tmp_path / "manifest.jsonl").read_text().splitlines()
    for line in map(json.loads, lines):
        given = line["parameters"]["aperture"]
        assert given["radius"] == pytest.approx(0.036 * given["focus_distance"], rel=5e-3)
        assert not any(isinstance(given[key], str) for key in ("radius", "rim_radius"))
