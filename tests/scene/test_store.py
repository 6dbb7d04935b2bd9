"""A scene that was written is read back bit by bit, or not at all."""

import dataclasses
import os
import pickle

import equinox as eqx
import foreign
import jax
import numpy as np
import pytest
import toy

from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.formats.gaussian_folder import read_model
from gaussray.scene.named_arrays import named_arrays
from gaussray.scene.scene import Scene, at
from gaussray.scene.store import load_scene, save_scene


def same(a, b):
    """Equal trees with equal bits and dtypes."""
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)


def rewritten(path, version=1, **changes):
    """The file with some arrays exchanged, or removed (None)."""
    header, array = read_arrays(path, "gaussray-scene", version)
    array = {name: x for name, x in (array | changes).items() if x is not None}
    write_arrays(path, header, array)


@pytest.fixture
def path(tmp_path):
    """A scene on disk."""
    save_scene(tmp_path / "scene.npz", toy.scene())
    return tmp_path / "scene.npz"


@pytest.mark.parametrize("speed", [0.4, 0.0])
def test_round_trip_is_exact_with_and_without_deformation(tmp_path, speed):
    scene = toy.scene(speed=speed)
    save_scene(tmp_path / "deep" / "scene.npz", scene, info={"by": "a test"})
    same(load_scene(tmp_path / "deep" / "scene.npz"), scene)
    same(load_scene(tmp_path / "deep"), scene)


def test_the_documented_names_are_the_names(path):
    _, array = read_arrays(path, "gaussray-scene", 1)
    assert {"static.mean", "moving.harmonics", "time_range", "deformation.planes.space.0",
            "deformation.planes.begin", "deformation.trunk.weight",
            "deformation.rotation.1.bias"} <= set(array)  # fmt: skip


@pytest.mark.parametrize("precision", ["full", "compact"])
def test_round_trip_with_control_points_needs_version_6(tmp_path, precision):
    scene = toy.scene(speed=0.4)
    field = toy.deformation(speed=0.4, control=toy.control_points())
    scene = dataclasses.replace(scene, deformation=field)
    save_scene(tmp_path / "scene.npz", scene, precision=precision)
    loaded = load_scene(tmp_path)
    same(loaded.deformation.control, field.control)
    header, array = read_arrays(tmp_path / "scene.npz", "gaussray-scene", 6)
    assert header["version"] == 6
    assert {f"deformation.control.{x}" for x in ("pivot", "path", "turn")} <= set(array)
    # Rounded Gaussians are where they were at every time.
    for time in (0.0, 0.3, 1.0):
        there, here = (at(s, toy.single(time)).mean for s in (scene, loaded))
        np.testing.assert_allclose(
            np.sort(here, axis=0), np.sort(there, axis=0), atol=0 if precision == "full" else 1e-2
        )


def test_control_points_without_width_are_refused(tmp_path):
    control = toy.control_points()
    control = dataclasses.replace(control, radius=control.radius.at[1].set(0))
    scene = dataclasses.replace(toy.scene(), deformation=toy.deformation(control=control))
    save_scene(tmp_path / "scene.npz", scene)
    with pytest.raises(ValueError, match="control.radius"):
        load_scene(tmp_path)


def residual_scene(folder, *, encoded=False, **how):
    """A scene that moves by residuals."""
    gaussians, field, _ = read_model(foreign.write_model(folder, **how))
    field = dataclasses.replace(field, encoded=encoded)
    none = jax.tree.map(lambda x: x[:0], gaussians)
    return Scene(none, gaussians, field, toy.single([0, 1]))


@pytest.mark.parametrize(
    "how",
    [{}, {"encoded": True}, {"no_do": True, "no_dshs": True}, dict.fromkeys(foreign.FLAGS, True)],
    ids=str,
)
def test_round_trip_is_exact_with_residuals(tmp_path, how):
    scene = residual_scene(tmp_path / "model", tensors=foreign.state(layers=2), **how)
    save_scene(tmp_path / "scene.npz", scene)
    same(load_scene(tmp_path), scene)


def test_residuals_are_kept_in_the_version_that_documents_them(tmp_path):
    save_scene(tmp_path / "scene.npz", residual_scene(tmp_path / "model", no_dr=True))
    header, array = read_arrays(tmp_path / "scene.npz", "gaussray-scene", 2)
    assert header["version"] == 2 and not any("rotation" in name for name in array)
    assert {"deformation.trunk.0.weight", "deformation.harmonics.1.bias", "deformation.encoded",
            "deformation.logit_opacity", "deformation.planes.time.1"} <= set(array)  # fmt: skip
    with pytest.raises(ValueError, match="is of version 2, this gaussray reads 1"):
        read_arrays(tmp_path / "scene.npz", "gaussray-scene", 1)


@pytest.mark.parametrize(
    "name", ["trunk.0.weight", "harmonics.0.bias", "mean.1.weight", "encoded", "planes.end"]
)
def test_a_missing_array_of_residuals_is_named(tmp_path, name):
    save_scene(tmp_path / "scene.npz", residual_scene(tmp_path / "model"))
    rewritten(tmp_path / "scene.npz", 2, **{f"deformation.{name}": None})
    with pytest.raises(ValueError, match=f"'deformation.{name}' is missing"):
        load_scene(tmp_path)


def test_residuals_that_make_no_field_are_refused_by_name(tmp_path):
    scene = residual_scene(tmp_path / "model")
    changes = {"logit_opacity": None, "encoded": np.zeros((2, 1), bool)}
    for name, x in changes.items():
        save_scene(tmp_path / "scene.npz", scene)
        rewritten(tmp_path / "scene.npz", 2, **{f"deformation.{name}": x})
        with pytest.raises(ValueError, match=f"(?i)scene.npz: .*{name}.*the scene is damaged"):
            load_scene(tmp_path)


def test_a_list_of_arrays_that_holds_another_list_is_refused(tmp_path):
    save_scene(tmp_path / "scene.npz", toy.scene(), precision="compact")
    header, array = read_arrays(tmp_path / "scene.npz", "gaussray-scene", 3)
    write_arrays(tmp_path / "scene.npz", header | {"arrays": [[], *header["arrays"]]}, array)
    with pytest.raises(ValueError, match=r"scene.npz: the array '\[\]' is missing"):
        load_scene(tmp_path)


def test_a_write_that_fails_leaves_the_old_file(path, monkeypatch):
    before = path.read_bytes()

    def torn(file, **_):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", torn)
    with pytest.raises(OSError, match="scene.npz: cannot be written: disk full"):
        save_scene(path, toy.scene(speed=0))
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == ["scene.npz"]


def test_a_pickle_is_never_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "owned"),))

    path = tmp_path / "scene.npz"
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ValueError, match="damaged"):
        load_scene(path)
    np.savez(path, header=np.array([Bomb()], object))
    with pytest.raises(ValueError, match="damaged"):
        load_scene(path)
    assert not (tmp_path / "owned").exists()


@pytest.mark.parametrize(
    "name", ["static.mean", "time_range", "deformation.trunk.bias", "deformation.planes.time.0"]
)
def test_a_missing_array_is_named(path, name):
    rewritten(path, **{name: None})
    with pytest.raises(ValueError, match=f"'{name}' is missing"):
        load_scene(path)


def test_arrays_that_do_not_fit_are_named(path):
    rewritten(path, **{"static.opacity": np.zeros(3, np.float32)})
    with pytest.raises(ValueError, match="'static' differ in length"):
        load_scene(path)


def test_values_that_are_not_finite_are_refused(path):
    scene = toy.scene()
    mean = np.array(scene.moving.mean)
    mean[1, 2] = np.nan
    save_scene(path, eqx.tree_at(lambda s: s.moving.mean, scene, jax.numpy.asarray(mean)))
    with pytest.raises(ValueError, match="'moving.mean' must be finite"):
        load_scene(path)


def test_named_follows_modules_tuples_and_named_tuples():
    tree = (np.zeros(1), (np.ones(2), None))
    assert set(named_arrays(tree)) == {"0", "1.0"}
