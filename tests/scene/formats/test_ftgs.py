"""`.ftgs.ply` files: written by hand as their description says, and back."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from splats import gaussians

from gaussray.cli.main import main
from gaussray.io.ply import comments_of, read_vertices
from gaussray.scene.formats.any_file import load
from gaussray.scene.formats.convert import import_model
from gaussray.scene.formats.export_transients import export_transients
from gaussray.scene.formats.ftgs import is_ftgs, read_ftgs, write_ftgs
from gaussray.scene.scene import Scene, at
from gaussray.scene.store import save_scene
from gaussray.scene.transient import Transients


# Single precision, through logarithm and logit.
SINGLE = 2e-5


def transients(count=9, plateau=0.0, seed=3):
    rng, still = np.random.default_rng(seed), gaussians(count, 4)
    fields = {"instant": rng.uniform(2, 4, count), "lifetime": rng.uniform(0.1, 1, count)}
    fields |= {"velocity": rng.normal(size=(count, 3)), "plateau": np.full(count, plateau)}
    fields = {name: jnp.asarray(x, jnp.float32) for name, x in fields.items()}
    own = {x: getattr(still, x) for x in ("mean", "quat", "scale", "opacity", "harmonics")}
    return Transients(**own, **fields)


def written(path, velocity=1, version=1):
    """One Gaussian as the description of version 1 has it."""
    values = {"x": 1, "y": 2, "z": 3, "nx": 0, "ny": 0, "nz": 0, "f_dc_0": 0.5, "f_dc_1": 0}
    values |= {"f_dc_2": -0.5, "opacity": 0.0, "scale_0": -1, "scale_1": -2, "scale_2": -3}
    values |= {"rot_0": 2, "rot_1": 0, "rot_2": 0, "rot_3": 0, "time": 0.25}
    values |= {"log_duration": np.log(0.1), "velocity_0": 10, "velocity_1": 0, "velocity_2": -10}
    lines = ["ply", "format binary_little_endian 1.0", f"comment ftgs_version {version}"]
    lines += ["comment time_units normalized", f"comment use_velocity {velocity}"]
    lines += ["element vertex 1", *(f"property float {name}" for name in values), "end_header", ""]
    path.write_bytes("\n".join(lines).encode() + np.array([*values.values()], "<f4").tobytes())
    return path


def test_a_gaussian_is_where_the_description_puts_it(tmp_path):
    path = written(tmp_path / "a.ftgs.ply")
    assert is_ftgs(path)
    scene, said = import_model(path, tmp_path / "out", color="linear")
    assert "transient Gaussians" in said and scene.static.count == 0
    found = at(scene, jnp.float32(0.35))
    np.testing.assert_allclose(found.mean[0], [2, 2, 2], atol=SINGLE)
    # A standard deviation after its instant.
    assert float(found.opacity[0]) == pytest.approx(0.5 * np.exp(-0.5), rel=SINGLE)
    np.testing.assert_allclose(found.scale[0], np.exp([-1, -2, -3]), rtol=SINGLE)
    assert load(path).transient.count == 1
    resting = read_ftgs(written(tmp_path / "b.ply", velocity=0))
    assert not np.any(resting.velocity)


def test_other_versions_are_refused(tmp_path):
    with pytest.raises(ValueError, match="ftgs_version must be 1, got 2"):
        read_ftgs(written(tmp_path / "a.ply", version=2))
    with pytest.raises(ValueError, match="got plateaus"):
        write_ftgs(tmp_path / "b.ply", transients(plateau=0.1))


def test_a_scene_is_itself_after_export_and_import(tmp_path):
    """At every time, in the time of the file: 2 to 4 becomes 0 to 1."""
    still = gaussians(5, 4, seed=1)
    scene = Scene(still, time_range=(2.0, 4.0), transient=transients())
    said = export_transients(scene, tmp_path / "a.ftgs.ply", color="linear", degree=1)
    assert said == "14 Gaussians, 5 of which stand still."
    assert comments_of(tmp_path / "a.ftgs.ply")["sh_degree"] == "1"
    assert {"time", "log_duration"} <= set(read_vertices(tmp_path / "a.ftgs.ply").dtype.names)
    back = Scene(still, transient=read_ftgs(tmp_path / "a.ftgs.ply"))
    for time in (2.0, 2.7, 4.0):
        true = at(scene, jnp.float32(time))
        found = at(dataclasses.replace(back, static=still), jnp.float32((time - 2) / 2))
        for name in ("mean", "scale", "opacity", "harmonics"):
            expected, value = getattr(true, name), getattr(found, name)[5:]
            np.testing.assert_allclose(value, expected, rtol=1e-4, atol=SINGLE)


def test_a_plateau_becomes_a_window_of_the_same_area(tmp_path):
    one = transients(count=1, plateau=0.4)
    scene = Scene(gaussians(1, 4), time_range=(2.0, 4.0), transient=one)
    said = export_transients(scene, tmp_path / "a.ply", color="srgb", degree=3)
    assert said.endswith("1 plateaus became Gaussian windows.")
    found = read_ftgs(tmp_path / "a.ply")
    assert found.harmonics.shape == (2, 16, 3)
    area = 2 * 0.4 + np.sqrt(2 * np.pi) * float(one.lifetime[0])
    assert np.sqrt(2 * np.pi) * 2 * float(found.lifetime[1]) == pytest.approx(area, rel=SINGLE)


def test_the_command_writes_all_times_and_refuses_one(tmp_path, capsys):
    scene = Scene(gaussians(2, 4), time_range=(2.0, 4.0), transient=transients(3))
    save_scene(tmp_path / "scene.npz", scene)
    words = ["export", f"scene={tmp_path}/scene.npz", f"out={tmp_path}/a.ftgs.ply", "format=ftgs"]
    main([*words, "progress=lines"])
    assert "5 Gaussians, 2 of which stand still" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main([*words, "time=2.5"])
    assert "leave time and count out" in capsys.readouterr().err
    with pytest.raises(ValueError, match="degree must be in 1"):
        export_transients(scene, tmp_path / "b.ply", color="srgb", degree=0)
