"""What damaged and hostile files once did, and do no more."""

import json
import os
import struct
import tarfile
import warnings

import films
import foreign
import numpy as np
import pytest
from toy import scene as toy_scene

from experiments.hostile.captures import FRAME, LENS, TURN
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.colmap import read_colmap
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.paths import read_path
from gaussray.capture.videos import decode_frames, read_video
from gaussray.config.compose import compose_config
from gaussray.dataset.pack import pack
from gaussray.io.ply import read_vertices
from gaussray.io.safe.limits import Limits, limit, limits
from gaussray.render.rig.view_files import load_views
from gaussray.scene.array_file import write_arrays
from gaussray.scene.formats.gaussian_folder import read_model
from gaussray.scene.formats.pth import read_tensors
from gaussray.scene.store import load_scene, save_scene


CAPTURE = {**LENS, "frames": [FRAME]}
RENDER = ["scene=x", "out=x"]


def listed(folder, **changes):
    (folder / "transforms.json").write_text(json.dumps(CAPTURE | changes))
    return folder


def in_frame(**changes):
    return {"frames": [FRAME | changes]}


@pytest.fixture
def lowered():
    """Limits that a test may change; those before come back."""
    before = limits()
    yield lambda **changes: limit(Limits(**changes))
    limit(before)


def test_a_list_called_a_video_opens_no_other_file(tmp_path):
    """FFmpeg takes a text for a list of files, whatever its name."""
    films.film(tmp_path / "secret.mp4", films.shades(2))
    (tmp_path / "a.mp4").write_text("ffconcat version 1.0\nfile secret.mp4\n")
    with pytest.raises(OSError, match="a.mp4: the video is truncated or corrupt"):
        read_video(tmp_path / "a.mp4")


def test_frames_beyond_the_limits_are_not_decoded(tmp_path, lowered):
    films.film(tmp_path / "a.mp4", films.shades(3))
    lowered(picture=0.001)
    with pytest.raises(CaptureError, match="megapixels of a frame must be at most limits.picture"):
        read_video(tmp_path / "a.mp4")
    lowered(frames=2)
    with pytest.raises(CaptureError, match="the frames must be at most limits.frames=2"):
        list(decode_frames(tmp_path / "a.mp4", [0]))


def test_a_pipe_called_a_video_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.mp4")
    with pytest.raises(OSError, match="a.mp4: the video must be a file"):
        read_video(tmp_path / "a.mp4")


def test_a_list_in_a_ply_leads_forward_alone(tmp_path):
    """A negative length led back to itself for ever."""
    head = "ply\nformat binary_little_endian 1.0\nelement face 9999999999\n"
    head += "property list char char a\nelement vertex 1\nproperty float x\nend_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + b"\xff" * 64)
    with pytest.raises(ValueError, match="a.ply: the PLY data must hold the 9999999999 rows"):
        read_vertices(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("form", "count", "rest"),
    [
        ("ascii", 10**30, "property float x\n"),
        ("binary_little_endian", 10**30, "property float x\n"),
        ("ascii", 2, ""),
        ("binary_big_endian", 2, ""),
    ],
)
def test_a_ply_of_any_count_is_refused_by_name(tmp_path, form, count, rest):
    text = f"ply\nformat {form} 1.0\nelement vertex {count}\n{rest}end_header\n1\n"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(ValueError, match="a.ply: "):
        read_vertices(tmp_path / "a.ply")


def test_elements_before_the_points_of_any_count_are_passed_over_or_refused(tmp_path):
    text = f"ply\nformat binary_little_endian 1.0\nelement face {10**30}\nproperty int x\n"
    text += "element vertex 1\nproperty float x\nend_header\n1234"
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(ValueError, match="a.ply: the PLY data must hold the 1 rows"):
        read_vertices(tmp_path / "a.ply")


def test_a_pickle_takes_no_more_memory_than_it_has_bytes(tmp_path):
    """A memo of the index 2^31 - 1 had sixteen gigabytes made ready for it."""
    pickled = b"\x80\x02N" + b"r" + struct.pack("<I", 2**31 - 1) + b"."
    foreign.write_archive(tmp_path / "a.pth", pickled, {})
    with pytest.raises(ValueError, match="must hold a dictionary of tensors .* a NoneType"):
        read_tensors(tmp_path / "a.pth")


@pytest.mark.parametrize("place", ["name", "reference", "shape", "value"])
def test_tuples_within_tuples_are_neither_printed_nor_compared(tmp_path, place):
    """Forty of two each hold 2^40: to print or hash one takes for ever."""
    laughs = b")" + b"q\x01h\x01\x86" * 40
    zero = foreign.storage("0", "f4", 1)
    none = foreign.series(zero, foreign.number(0), laughs, laughs) + b"R"
    values = {
        "name": laughs + b"N",
        "reference": foreign.text("x") + laughs + b"Q",
        "shape": foreign.text("x") + foreign.name_of("torch._utils", "_rebuild_tensor_v2") + none,
        "value": foreign.text("x") + laughs,
    }
    foreign.write_archive(tmp_path / "a.pth", foreign.dictionary([values[place]]), {"0": b"1234"})
    with pytest.raises(ValueError, match="a.pth: ") as caught:
        read_tensors(tmp_path / "a.pth")
    assert len(str(caught.value)) < 1000


def test_entries_of_a_pth_whose_names_are_no_text_are_refused(tmp_path):
    path = tmp_path / "a.pth"
    foreign.write_archive(path, b"\x80\x02N.", {"\u00e9": b"1234"})
    path.write_bytes(path.read_bytes().replace("\u00e9".encode(), b"\xb3\xb3"))
    with pytest.raises(ValueError, match="a.pth: must be a file of torch.save"):
        read_tensors(path)


def test_arguments_without_end_are_refused(tmp_path):
    foreign.write_model(tmp_path, foreign.state(side=2, rows=2), foreign.cloud(2))
    for text in ("Namespace(a=" + "(" * 10_000, "Namespace(a=" + "-" * 90_000 + "1)", "a" * 10**6):
        (tmp_path / "cfg_args").write_text(text)
        with pytest.raises(
            ValueError, match="cfg_args: must be a text Namespace|cfg_args: must hold"
        ):
            read_model(tmp_path)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"w": 10**400}, "w must be a whole number"),
        ({"w": 1e300}, "w must be a whole number"),
        ({"w": 10**6, "h": 10**6}, "its megapixels must be at most limits.picture=200"),
        ({"fl_x": 10**400}, "fl_x must be a finite number"),
        (in_frame(time=10**400), "time must be a finite number"),
        (in_frame(transform_matrix=[[10**400] * 4] * 4), "transform_matrix must be finite"),
        (in_frame(transform_matrix=[*TURN[:2], [0, 0, 1, 1e300], TURN[3]]), "must be finite"),
        ({"test_filenames": 7, "w": "x"}, "w must be a whole number"),
        (in_frame(file_path="9" * 5000), "file_path must be the name of a file"),
        (in_frame(file_path="a\0b"), "file_path must be the name of a file"),
    ],
)
def test_numbers_and_names_of_any_size_are_refused_by_key(tmp_path, changes, says):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(CaptureError, match=f"transforms.json.*{says}"):
            read_capture(listed(tmp_path, **changes))


def test_cameras_are_read_though_their_pictures_are_elsewhere(tmp_path):
    """As cameras.json of a run, which names the pictures where they were."""
    top = CAPTURE | in_frame(file_path="/data/a/0.png", mask_path="../m.png")
    (tmp_path / "cameras.json").write_text(json.dumps(top))
    (view,) = load_views(tmp_path / "scene.npz", None)
    assert (view.camera_name, view.width, view.mask) == ("a", 4, None)


@pytest.mark.parametrize(
    ("camera", "picture"),
    [
        ("1 PINHOLE 4 3 4 4 2 1.5", "9" * 5000),
        (f"1 {'9' * 7000} 4 3 4 4 2 1.5", "a.png"),
        (f"1 PINHOLE 4 {'9' * 7000} 4 4 2 1.5", "a.png"),
    ],
)
def test_words_of_any_length_in_a_model_of_colmap_are_cut(tmp_path, camera, picture):
    (tmp_path / "cameras.txt").write_text(f"{camera}\n")
    (tmp_path / "images.txt").write_text(f"1 1 0 0 0 0 0 0 1 {picture}\n\n")
    (tmp_path / "points3D.txt").write_text("")
    with pytest.raises(CaptureError, match=r"(cameras|images).txt: ") as caught:
        read_colmap(tmp_path)
    assert len(str(caught.value)) < 1000


def test_a_path_that_turns_by_nothing_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text(f"0 0 0 0 0 0 0 1\n1 0 0 0 {'9' * 5000} 0 0 1\n")
    with pytest.raises(CaptureError, match="a.txt, line 2: must be time x y z") as caught:
        read_path(tmp_path / "a.txt")
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("key", ["trajectory", "camera_path"])
def test_a_path_without_poses_is_refused(tmp_path, key):
    told = {"trajectory": {"poses": []}, "camera_path": {"poses": []}}
    (tmp_path / "a.json").write_text(json.dumps({key: told[key]}))
    with pytest.raises(CaptureError, match=f"a.json: {key} must be a list of blocks"):
        read_path(tmp_path / "a.json")


@pytest.mark.parametrize(
    "changes",
    [
        {"folder": "../.."},
        {"folder": "/etc"},
        {"frames": [{"file_path": "../../../secret"}]},
        {"frames": [{"file_path": "a.png", "labels": {"x": "/etc/passwd"}}]},
        {"frames": [{"file_path": "link.png"}]},
        {"frames": [{"file_path": "pipe.png"}]},
        {"frames": [{"file_path": "a.png", "labels": {"../../evil": "a.png"}}]},
        {"frames": [{"file_path": "a.png", "labels": {"a" * 5000: "a.png"}}]},
        {"frames": 3},
        {"frames": [{"file_path": 3}]},
        {"index": "0"},
    ],
)
def test_what_is_packed_lies_in_the_data_set(tmp_path, changes):
    """A manifest could pack any file of whoever packs it."""
    (tmp_path / "secret").write_text("secret")
    data = tmp_path / "data"
    folder = data / "takes/000000"
    folder.mkdir(parents=True)
    (folder / "a.png").write_bytes(b"1")
    (folder / "link.png").symlink_to(tmp_path / "secret")
    os.mkfifo(folder / "pipe.png")
    line = {"version": 1, "index": 0, "folder": "takes/000000", "frames": [{"file_path": "a.png"}]}
    (data / "manifest.jsonl").write_text(json.dumps(line) + "\n")
    (path,) = pack(data, tmp_path / "good")
    with tarfile.open(path) as tar:
        assert tar.getnames() == ["000000_0000.png", "000000_0000.json"]
    (data / "manifest.jsonl").write_text(json.dumps(line | changes) + "\n")
    with pytest.raises((ValueError, OSError), match="manifest.jsonl|pipe.png: must be a file"):
        pack(data, tmp_path / "bad")


def test_a_scene_whose_arrays_do_not_fit_is_refused_when_it_is_read(tmp_path):
    from gaussray.scene.named_arrays import named_arrays

    scene = toy_scene()
    save_scene(tmp_path / "good.npz", scene)
    load_scene(tmp_path / "good.npz")
    array = named_arrays(scene)
    header = {"format": "gaussray-scene", "version": 1, "info": {}}
    width = array["deformation.trunk.weight"].shape[1]
    wrong = {
        "deformation.trunk.weight": np.zeros((3, width), np.float32),
        "static.harmonics": np.zeros((len(array["static.mean"]), 5, 3), np.float32),
        "time_range": np.array([1.0, 0.0], np.float32),
    }
    for name, x in wrong.items():
        assert name in array
        write_arrays(tmp_path / "bad.npz", header, array | {name: x})
        with pytest.raises(ValueError, match="bad.npz: .*the scene is damaged"):
            load_scene(tmp_path / "bad.npz")


@pytest.mark.parametrize("header", ["[]", "3", "{", "[" * 5000, '{"format": [1]}', '{"info": 3}'])
def test_a_header_of_another_kind_is_refused(tmp_path, header):
    np.savez(tmp_path / "scene.npz", header=np.array(header))
    with pytest.raises(ValueError, match="scene.npz"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    "word",
    [
        "camera.split=${oc.env:SECRET}",
        "camera.names=['${oc.env:SECRET}']",
        "camera.split='${oc.decode:${oc.env:SECRET}}'",
        "camera.split='${oc.create:{a:1}}'",
        "camera.split=a${${camera.split}:SECRET}",
    ],
)
def test_a_value_calls_no_program(monkeypatch, word):
    """Of a file that is shared, the environment is none of its business."""
    monkeypatch.setenv("SECRET", "a secret")
    with pytest.raises(ValueError, match="which calls a resolver|configuration: ") as caught:
        compose_config("render", [*RENDER, word])
    assert "a secret" not in str(caught.value)


def test_a_value_may_be_another_and_hold_a_colon():
    told = ["devices.coordinator=host:7777", "camera.split=${lens.model}", "out='${scene}: x'"]
    cfg = compose_config("render", ["scene=s", *told])
    assert (cfg.devices.coordinator, cfg.camera.split) == ("host:7777", cfg.lens.model)
    assert cfg.out == "s: x"


def test_a_value_makes_no_object(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="_target_"):
        compose_config("render", [*RENDER, "lens._target_=os.mkdir"])
    cfg = compose_config("render", [*RENDER, "+lens._target_=os.mkdir", "+lens._args_=[owned]"])
    from gaussray.config.jobs import render_job

    with pytest.raises(ValueError, match="lens._target_ is unknown"):
        render_job(cfg)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "text",
    [
        "sample: !!python/object/apply:os.mkdir [owned]",
        "sample: !!python/name:os.system",
        "sample: [",
        "sample: \xff",
        "# @package _global_ a b c d\nsample: 1",
        "# @package [global_\nsample: 1",
    ],
)
def test_a_yaml_of_others_runs_nothing_and_ends_in_one_message(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample").mkdir()
    (tmp_path / "sample/mine.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match="configuration: ") as caught:
        compose_config("render", [*RENDER, "sample=mine", f"hydra.searchpath=[file://{tmp_path}]"])
    assert "index out of range" not in str(caught.value)
    assert os.listdir(tmp_path) == ["sample"]


@pytest.mark.parametrize("text", ["-1", "9" * 40, "[1, 2]", "[", "\0"])
def test_a_preset_that_is_no_block_is_refused(tmp_path, text):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(ValueError, match="preset=.*a.yaml: (must hold keys|is no YAML)"):
        compose_config("render", [*RENDER, f"preset={tmp_path / 'a.yaml'}"])


def test_aliases_of_aliases_in_a_file_of_others_are_refused(tmp_path):
    """Nine of nine of nine: each level took Hydra ten times as long."""
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for i in range(9):
        lines.append(f"a{i + 1}: &a{i + 1} [{', '.join(9 * [f'*a{i}'])}]")
    (tmp_path / "sample").mkdir()
    path = tmp_path / "sample/mine.yaml"
    path.write_text("\n".join(lines))
    for words in ([f"preset={path}"], ["sample=mine", f"hydra.searchpath=[file://{tmp_path}]"]):
        with pytest.raises(ValueError, match="mine.yaml: must hold at most 100000 values"):
            compose_config("render", [*RENDER, *words])


def test_no_module_imports_pickle():
    import ast
    import pathlib

    import gaussray

    unsafe = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal"}
    root = pathlib.Path(gaussray.__file__).parent
    # Machine code that this package wrote into the user's own folder: pickle adds no power to it.
    machine_code = root / "runtime/program_content.py"
    for path in set(root.rglob("*.py")) - {machine_code}:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {alias.name for alias in node.names} | {getattr(node, "module", None)}
                assert not names & unsafe, path
