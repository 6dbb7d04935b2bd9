"""A compact scene is off by no more than it says, loses nothing twice, and damage is refused."""

import copy
import dataclasses
from pathlib import Path

import equinox as eqx
import foreign
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.color import srgb_encode
from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.compression import CURVES, compress_arrays, restore_arrays
from gaussray.scene.formats.gaussian_folder import read_model
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0
from gaussray.scene.named_arrays import named_arrays
from gaussray.scene.scene import Scene
from gaussray.scene.store import as_stored, load_scene, save_scene


# Values of single precision near the numbers in question.
SINGLE = 1e-6
# Rows of the random scene.
STATIC, MOVING = 200, 60


def crowd(count, seed, coefficients=4):
    """Gaussians of all sizes, one far away, with quaternions of any length."""
    dice = np.random.default_rng(seed)
    mean = dice.normal(size=(count, 3))
    mean[-1] = 1e4
    color = dice.uniform(0, 1.2, (count, 1, 3))
    rest = dice.normal(0, 0.2, (count, coefficients - 1, 3))
    return Gaussians(
        toy.single(mean),
        toy.single(dice.normal(size=(count, 4))),
        toy.single(np.exp(dice.normal(-4, 1, (count, 3)))),
        toy.single(dice.uniform(0, 1, count)),
        toy.single(np.concatenate([(color - 0.5) / C0, rest], axis=1)),
    )


@pytest.fixture(scope="module")
def scene():
    """Many Gaussians, a field that was filled with random numbers, and a body that moves."""
    dice = np.random.default_rng(2)
    field = jax.tree.map(lambda x: toy.single(dice.normal(size=x.shape)), toy.deformation())
    planes = eqx.tree_at(lambda p: (p.begin, p.end), field.planes, (toy.single(0), toy.single(1)))
    field = dataclasses.replace(field, planes=planes)
    return Scene(crowd(STATIC, 0), crowd(MOVING, 1, 1), field, toy.single([0, 1]))


def unit(quat):
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def in_order(array, wanted):
    """Rows of a restored table in the order of the original one, by the nearest mean."""
    found = dict(array)
    for prefix in ("static", "moving"):
        gap = np.abs(array[f"{prefix}.mean"][None] - wanted[f"{prefix}.mean"][:, None]).max(-1)
        row = gap.argmin(axis=1)
        assert len(set(row)) == len(row)
        found |= {n: x[row] for n, x in array.items() if n.startswith(f"{prefix}.")}
    return found


def test_every_value_is_within_half_a_step_on_its_curve(scene):
    wanted = named_arrays(scene)
    codes, kept = compress_arrays(wanted)
    found = in_order(restore_arrays(codes, kept, Path("a file")), wanted)
    assert {"static.mean", "moving.quat", "deformation.trunk.bias"} <= set(codes)
    for name, x in found.items():
        assert x.dtype == wanted[name].dtype and x.shape == wanted[name].shape
        if name not in codes:
            np.testing.assert_array_equal(x, wanted[name])
            continue
        half = 2.0 ** codes[name]["exponent"] / 2
        curve = CURVES[codes[name]["curve"]][0]
        a, b = (np.asarray(v, np.float64) for v in (wanted[name], x))
        if name.endswith(".quat"):
            a = unit(a)
        a, b = curve(a), curve(b)
        assert np.abs(a - b).max() <= half + SINGLE * np.abs(a).max(), name


def test_steps_are_those_that_are_told(scene):
    wanted = named_arrays(scene)
    codes, _ = compress_arrays(wanted)
    exponent = {name: code["exponent"] for name, code in codes.items()}
    assert exponent["static.quat"] == exponent["moving.quat"] == -10
    assert exponent["static.scale"] == -6 and exponent["static.opacity"] == -7
    assert exponent["static.harmonics"] == -8
    thin = np.sort(wanted["static.scale"].min(axis=1))[STATIC // 20]
    # Scales are rounded to 1/64 of a power of two before.
    assert 2**-0.01 / 32 <= 2.0 ** exponent["static.mean"] / thin <= 2**0.01 / 16
    for name, bits in (("planes.space.0", 7), ("trunk.weight", 8), ("mean.1.bias", 8)):
        largest = np.abs(wanted[f"deformation.{name}"]).max()
        step = 2.0 ** exponent[f"deformation.{name}"]
        assert largest <= step * 2**bits < 2 * largest
    # A colour is rounded as a code of sRGB, not as light.
    own = np.array([[[0.0, 0.1, 1.0]]])
    np.testing.assert_allclose(
        CURVES["color"][0](own)[0, 0], srgb_encode(C0 * own[0, 0] + 0.5), atol=SINGLE
    )


def test_what_moves_with_a_body_moves_as_exactly_as_before(scene):
    found, wanted = (
        as_stored(scene, precision="compact").deformation.bodies,
        scene.deformation.bodies,
    )
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("speed", [0.4, 0.0])
def test_a_scene_that_was_read_is_written_without_another_loss(tmp_path, scene, speed):
    for i, one in enumerate((scene, toy.scene(speed=speed))):
        once, twice = tmp_path / f"once_{i}.npz", tmp_path / f"twice_{i}.npz"
        save_scene(once, one, precision="compact")
        read = load_scene(once)
        save_scene(twice, read, precision="compact")
        again = load_scene(twice)
        assert jax.tree.structure(again) == jax.tree.structure(one)
        told = as_stored(one, precision="compact")
        for a, b, c in zip(*map(jax.tree.leaves, (read, again, told)), strict=True):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(a, c)


def test_neighbours_follow_each_other(scene):
    near = scene.static.mean[:-1]
    ordered = as_stored(
        eqx.tree_at(lambda s: s.static, scene, jax.tree.map(lambda x: x[:-1], scene.static)),
        precision="compact",
    ).static.mean
    step = [np.linalg.norm(np.diff(np.asarray(x), axis=0), axis=1).mean() for x in (near, ordered)]
    assert step[1] < step[0] / 2


def test_a_compact_file_is_much_smaller(tmp_path, scene):
    size = {}
    for precision in ("full", "compact"):
        path = tmp_path / f"{precision}.npz"
        save_scene(path, scene, precision=precision)
        with np.load(path) as file:
            size[precision] = sum(file.zip.getinfo(x).compress_size for x in file.zip.namelist()
                                  if "header" not in x)  # fmt: skip
    # Random numbers have no smooth planes, and no neighbours that are alike.
    assert size["compact"] < size["full"] / 2


@pytest.mark.parametrize("encoded", [False, True])
def test_residuals_are_kept_with_what_they_add_to(tmp_path, encoded):
    gaussians, field, _ = read_model(foreign.write_model(tmp_path / "model"))
    none = jax.tree.map(lambda x: x[:0], gaussians)
    field = dataclasses.replace(field, encoded=encoded)
    one = Scene(none, gaussians, field, toy.single([0, 1]))
    save_scene(tmp_path / "scene.npz", one, precision="compact")
    found = load_scene(tmp_path)
    assert jax.tree.structure(found) == jax.tree.structure(one)
    gap = np.abs(np.asarray(found.moving.mean)[:, None] - np.asarray(one.moving.mean)[None])
    row = gap.max(axis=-1).argmin(axis=1)
    np.testing.assert_array_equal(found.moving.quat, one.moving.quat[row])
    logit = one.deformation.logit_opacity[row]
    np.testing.assert_array_equal(found.deformation.logit_opacity, logit)


def test_heads_and_scales_that_are_missing_stay_missing(tmp_path):
    one = toy.scene()
    field = dataclasses.replace(one.deformation, rotation=None, tint=None)
    for precision in ("full", "compact"):
        lean = dataclasses.replace(one, deformation=field)
        save_scene(tmp_path / "scene.npz", lean, precision=precision)
        assert jax.tree.structure(load_scene(tmp_path)) == jax.tree.structure(lean)
    planes = eqx.tree_at(lambda p: (p.space, p.time), field.planes, ((), ()))
    trunk = jax.tree.map(lambda x: x[:0] if x.ndim == 2 else x, field.trunk)
    lean = dataclasses.replace(field, planes=planes, trunk=trunk)
    lean = dataclasses.replace(one, deformation=lean)
    save_scene(tmp_path / "scene.npz", lean)
    found = load_scene(tmp_path)
    assert jax.tree.structure(found) == jax.tree.structure(lean)
    moved, wanted = (toy.deformed(x.moving, x.deformation, toy.single(0.5)) for x in (found, lean))
    np.testing.assert_array_equal(moved.mean, wanted.mean)


def test_a_scene_that_is_not_finite_and_an_unknown_precision_are_refused(tmp_path):
    scene = toy.scene()
    bad = eqx.tree_at(lambda s: s.moving.scale, scene, scene.moving.scale.at[0, 0].set(jnp.nan))
    with pytest.raises(ValueError, match="'moving.scale' must be finite"):
        save_scene(tmp_path / "scene.npz", bad, precision="compact")
    with pytest.raises(ValueError, match="precision must be one of full, compact, got 'half'"):
        save_scene(tmp_path / "scene.npz", scene, precision="half")
    assert not list(tmp_path.iterdir())


def damaged(path, change):
    """The file of a compact scene with another header or other arrays."""
    save_scene(path, toy.scene(), precision="compact")
    header, array = read_arrays(path, "gaussray-scene", 3)
    header = copy.deepcopy(header)
    change(header, array)
    write_arrays(path, header, array)


NAME = "static.mean"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda h, a: a.pop(NAME), "'static.mean' is missing"),
        (lambda h, a: h.pop("arrays"), "does not list its arrays"),
        (lambda h, a: h.update(codes=[1]), "does not list its arrays"),
        (lambda h, a: h["codes"].update({NAME: 3}), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].pop("shape"), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(curve="cube"), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(dtype="object"), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(shape=[7, 3]), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(shape=[-1, 3]), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(difference=9), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(exponent="x"), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(exponent=10**9), "code of 'static.mean' is damaged"),
        (lambda h, a: h["codes"][NAME].update(exponent=900), "'static.mean' must be finite"),
        (lambda h, a: h["codes"].pop(NAME), "'static.mean' must hold real numbers"),
        (lambda h, a: a.update({NAME: a[NAME].astype(np.float32)}), "is damaged"),
        (lambda h, a: a.update({NAME: a[NAME][:, :-3]}), "code of 'static.mean' is damaged"),
        (lambda h, a: a.update({NAME: np.tile(a[NAME], (9, 1))}), "is damaged"),
        (lambda h, a: h["codes"][NAME].update(shape=[15, 5]), "'static' differ in length"),
        (
            lambda h, a: (
                a.update({"moving.quat": np.zeros((2, 3), np.float32)})
                or h["codes"].pop("moving.quat")
            ),
            "'moving.quat' has the shape",
        ),
    ],
)
def test_damage_is_one_clear_error(tmp_path, change, message):
    path = tmp_path / "scene.npz"
    damaged(path, change)
    with pytest.raises(ValueError, match=message) as caught:
        load_scene(path)
    assert str(path) in str(caught.value)


def test_bytes_that_do_not_inflate_are_damage(tmp_path):
    path = tmp_path / "scene.npz"
    save_scene(path, toy.scene(), precision="compact")
    content = bytearray(path.read_bytes())
    for at in range(200, len(content) - 200, 97):
        content[at] ^= 0x5A
    path.write_bytes(content)
    with pytest.raises(ValueError, match="damaged"):
        load_scene(path)
