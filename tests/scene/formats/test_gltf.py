"""glTF files with Gaussians: values come back; other programs agree where they are installed."""

import dataclasses
import json
import os
import shutil
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation
from splats import gaussians

from gaussray.scene.formats.any_file import load, save
from gaussray.scene.formats.convert import export_model, import_model
from gaussray.scene.formats.gaussian_folder import read_model
from gaussray.scene.formats.gaussian_ply import write_gaussians
from gaussray.scene.formats.glb_file import read_glb
from gaussray.scene.formats.gltf import EXTENSION, read_gltf, rotated_harmonics, write_gltf
from gaussray.scene.harmonics import harmonic_basis
from gaussray.scene.scene import at


# Rounding of single precision, relative; and of harmonics after a rotation.
ROUNDING, TURNED = 1e-6, 5e-6


def assert_same(found, expected, tolerance=TURNED):
    for name in ("mean", "scale", "opacity", "harmonics"):
        pair = np.asarray(getattr(found, name)), np.asarray(getattr(expected, name))
        np.testing.assert_allclose(*pair, rtol=tolerance, atol=tolerance, err_msg=name)
    cosine = np.abs(np.sum(np.asarray(found.quat) * np.asarray(expected.quat), axis=1))
    np.testing.assert_allclose(cosine, 1, atol=ROUNDING)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("color", ["srgb", "linear"])
def test_what_is_written_is_read(tmp_path, coefficients, color):
    true = gaussians(coefficients=coefficients)
    write_gltf(tmp_path / "a.glb", true, color)
    found, space = read_gltf(tmp_path / "a.glb")
    assert space == color
    assert_same(found, true)


def edited(path, change):
    """The same GLB file with a changed document."""
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    words = np.array([20 + len(text) + len(rest), len(text)], "<u4").tobytes()
    path.write_bytes(data[:8] + words + b"JSON" + text + rest)


def test_the_transforms_of_nodes_move_turn_and_scale_the_gaussians(tmp_path):
    true, path = gaussians(), tmp_path / "a.glb"
    turn = Rotation.from_rotvec([0.3, -0.9, 0.5])
    write_gltf(path, true, "srgb")

    def place(document):
        document["nodes"] = [
            {"children": [1], "translation": [1, 2, 3]},
            {"mesh": 0, "rotation": turn.as_quat().tolist(), "scale": [2, 2, 2]},
        ]

    edited(path, place)
    found, _ = read_gltf(path)
    # In axes of glTF files: a half turn about z before and after.
    half = np.diag([-1.0, -1.0, 1.0])
    linear = half @ turn.as_matrix() @ half
    mean = 2 * np.asarray(true.mean) @ linear.T + half @ [1, 2, 3]
    np.testing.assert_allclose(found.mean, mean, atol=TURNED)
    np.testing.assert_allclose(found.scale, 2 * true.scale, rtol=ROUNDING)
    covariance = [covariances(x) for x in (true, found)]
    turned = 4 * linear @ covariance[0] @ linear.T
    np.testing.assert_allclose(covariance[1], turned, rtol=1e-4, atol=1e-7)
    # The colour in a turned direction is that of the direction before.
    direction = np.array([0.48, -0.6, 0.64])
    pair = (colors(found, linear @ direction), colors(true, direction))
    np.testing.assert_allclose(*pair, atol=TURNED)


def covariances(g):
    axes = (
        Rotation.from_quat(np.roll(np.asarray(g.quat), -1, axis=1)).as_matrix()
        * np.asarray(g.scale)[:, None, :]
    )
    return axes @ axes.swapaxes(1, 2)


def colors(g, direction):
    values = np.stack(harmonic_basis(jnp.asarray(direction), g.harmonics.shape[1]))
    return np.einsum("c,nck->nk", values, np.asarray(g.harmonics))


def test_a_half_turn_about_z_changes_the_sign_of_odd_orders():
    signs = np.diag(rotated_harmonics(np.diag([-1.0, -1.0, 1.0]), 16))
    orders = np.concatenate([np.arange(-l, l + 1) for l in range(4)])  # noqa: E741
    np.testing.assert_allclose(signs, (-1.0) ** orders, atol=ROUNDING)


def test_integers_are_fractions_and_vertices_may_be_interleaved(tmp_path):
    path, true = tmp_path / "a.glb", gaussians(count=4, coefficients=1)
    write_gltf(path, true, "srgb")
    data = path.read_bytes()
    glb = read_glb(path)
    color = glb.accessor(glb.document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"])
    assert color.max() <= 1
    np.testing.assert_allclose(color[:, 3], true.opacity, atol=0.5 / 255 + ROUNDING)
    assert len(data) == int.from_bytes(data[8:12], "little")


def test_the_file_says_the_colour_space(tmp_path):
    scene = toy.scene(speed=0)
    _, text = export_model(scene, tmp_path / "linear.glb", color="linear", format="glb")
    assert "linear light" in text
    imported, text = import_model(tmp_path / "linear.glb", tmp_path / "run", color="srgb")
    assert "as the file says: colours are linear light" in text
    np.testing.assert_allclose(
        imported.static.harmonics[: len(scene.static.harmonics), :1],
        scene.static.harmonics,
        atol=TURNED,
    )
    save(tmp_path / "srgb.glb", scene)
    assert read_gltf(tmp_path / "srgb.glb")[1] == "srgb"
    back = load(tmp_path / "srgb.glb").static
    count = scene.static.count
    np.testing.assert_allclose(back.harmonics[:count, 0], scene.static.harmonics[:, 0], atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["meshes"][0]["primitives"][0].pop("extensions"), "hold Gaussians of KHR"),
        (lambda d: d["accessors"][0].update(count=10**9), "cut off"),
        (lambda d: d["accessors"][0].update(byteOffset=-4), "whole numbers as sizes"),
        (lambda d: d["accessors"][0].update(sparse={}), "plain accessors"),
        (lambda d: d["accessors"][2].update(type="VEC3"), "of one length and the right types"),
        (lambda d: d["nodes"][0].update(scale=[1, 2, 1]), "scale all axes alike"),
        (lambda d: d["nodes"][0].update(scale=[-1, 1, 1]), "without mirrors"),
        (lambda d: d["nodes"][0].update(children=[0]), "nodes in a tree"),
        (lambda d: d["nodes"][0].update(mesh=7), "have the entry 7 of meshes"),
        (lambda d: extension(d).update(colorSpace="none"), "a colorSpace among srgb_rec709"),
        (lambda d: extension(d).update(extensions={"KHR_x_spz_2": {}}), "uncompressed, got KHR_x"),
        (lambda d: attributes(d).pop(f"{EXTENSION}:SCALE"), f"have {EXTENSION}:SCALE"),
        (lambda d: attributes(d).pop(f"{EXTENSION}:SH_DEGREE_1_COEF_2"), "all harmonics of each"),
    ],
)
def test_what_is_no_file_of_gaussians_is_refused(tmp_path, change, message):
    path = tmp_path / "a.glb"
    write_gltf(path, gaussians(), "srgb")
    edited(path, change)
    with pytest.raises(ValueError, match=message):
        read_gltf(path)


def extension(document):
    return document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]


def attributes(document):
    return document["meshes"][0]["primitives"][0]["attributes"]


def test_what_is_cut_off_or_no_glb_is_refused(tmp_path):
    path = tmp_path / "a.glb"
    write_gltf(path, gaussians(), "srgb")
    whole = path.read_bytes()
    for length in (30, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="cut off|malformed JSON"):
            read_gltf(path)
    (tmp_path / "a.gltf").write_text("{}")
    with pytest.raises(ValueError, match="must be a binary glTF file.*as .glb"):
        read_model(tmp_path / "a.gltf")
    infinite = dataclasses.replace(gaussians(), mean=jnp.full((60, 3), jnp.inf))
    with pytest.raises(ValueError, match="POSITION must be finite"):
        write_gltf(path, infinite, "srgb")


INSTALL = "npm install -g gltf-validator @playcanvas/splat-transform@3"
VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then(report => console.log(JSON.stringify(report.issues)));
"""


def wrong(report):
    """Errors and warnings, but for names: the validator of 2024 knows no attributes of the
    extension."""
    return [
        one
        for one in json.loads(report)["messages"]
        if one["severity"] < 2
        and not (one["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE" and EXTENSION in one["pointer"])
    ]


def has_validator():
    words = ["node", "-e", "require('gltf-validator')"]
    return shutil.which("node") and not subprocess.run(words, capture_output=True).returncode


@pytest.mark.skipif(not has_validator(), reason=f"{INSTALL}; NODE_PATH=$(npm root -g)")
def test_the_validator_of_khronos_finds_nothing_wrong(tmp_path):
    write_gltf(tmp_path / "a.glb", gaussians(), "srgb")
    words = ["node", "-e", VALIDATE, str(tmp_path / "a.glb")]
    done = subprocess.run(words, check=True, capture_output=True, env={**os.environ})
    assert not wrong(done.stdout)
    edited(tmp_path / "a.glb", lambda document: document["accessors"][0].pop("min"))
    done = subprocess.run(words, check=True, capture_output=True, env={**os.environ})
    assert wrong(done.stdout)


@pytest.mark.skipif(not shutil.which("splat-transform"), reason=INSTALL)
def test_another_writer_writes_the_same(tmp_path):
    true = gaussians()
    write_gaussians(tmp_path / "a.ply", true)
    command = ["splat-transform", "-w", str(tmp_path / "a.ply"), str(tmp_path / "a.glb")]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    found, space = read_gltf(tmp_path / "a.glb")
    assert space == "srgb"
    # It writes log scales and logits of a PLY file back as values.
    assert_same(found, true, tolerance=2e-5)


def test_a_time_of_a_moving_scene_is_saved_in_the_wanted_colours(tmp_path):
    moving, time = toy.scene(), 0.5
    save(tmp_path / "a.glb", moving, time=time, color="linear", degree=0)
    there = at(moving, toy.single(time))
    np.testing.assert_allclose(load(tmp_path / "a.glb").static.mean, there.mean, atol=1e-5)
    assert load(tmp_path / "a.glb").static.harmonics.shape[1] == 1
    with pytest.raises(ValueError, match="time must be None for a file of all times, got 0.5"):
        save(tmp_path / "a.npz", moving, time=time)
