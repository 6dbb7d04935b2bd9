"""What the user does wrong ends in one line that names key or file, and in exit code 2."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import toy
from omegaconf import OmegaConf

from gaussray.capture.open import open_capture
from gaussray.cli.commands import RUN
from gaussray.cli.help import COMMANDS, EXITS, MOST_USED
from gaussray.cli.main import main
from gaussray.cli.reconstruct import should_resume
from gaussray.config.schema import keys
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import write_manifest
from gaussray.reconstruct.same_capture import write_capture_facts
from gaussray.scene.array_file import write_arrays
from gaussray.scene.store import save_scene


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    """A scene with the cameras that filmed it."""
    folder = tmp_path_factory.mktemp("run")
    save_scene(folder / "scene.npz", toy.scene())
    write_manifest(folder / "cameras.json", toy.records())
    return folder / "scene.npz"


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    """A capture of grey pictures."""
    folder = tmp_path_factory.mktemp("capture")
    for record in toy.records():
        write_image(folder / record.file_path, np.full((toy.SIZE, toy.SIZE, 3), 128, np.uint8))
    write_manifest(folder / "transforms.json", toy.records(), extra={"time_unit": "s"})
    return folder


@pytest.fixture
def capture(original, tmp_path):
    """A copy to be broken."""
    import shutil

    return shutil.copytree(original, tmp_path / "capture")


@pytest.fixture
def fails(capsys):
    """Runs a command that must fail; returns its one line on stderr."""

    def run(*words, code=2):
        with pytest.raises(SystemExit) as stop:
            main([str(word) for word in words])
        assert stop.value.code == code
        out, err = capsys.readouterr()
        # A busy machine tells how far it is, too.
        lines = [line for line in err.splitlines() if not line.endswith(" spent")]
        assert len(lines) == 1, err
        assert lines[0].startswith("gaussray: ")
        return lines[0]

    return run


def edited(capture, change):
    """The capture after a change of its JSON document."""
    path = capture / "transforms.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    return capture


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("reconstruct capture.path=CAPTURE capture.test=[100_7105]", "capture.test must be a list"),
        ("evaluate scene=SCENE truth=CAPTURE truth_test=[100_7105]", "truth_test must be a list"),
        ("reconstruct capture.path=100_7105", "capture.path must be the name of a file or folder"),
        ("render scene=SCENE out=100_7105", "out must be the name of a file or folder"),
        ("prepare videos=100_7105 out=new", "videos must be the name of a file or folder"),
    ],
)
def test_a_name_that_reads_as_a_number_needs_quotes(fails, scene_file, original, words, named):
    places = {"CAPTURE": str(original), "SCENE": str(scene_file)}
    for word, place in places.items():
        words = words.replace(word, place)
    line, key = fails(*words.split()), named.split()[0]
    assert named in line and "got 1007105" in line and "needs quotes" in line
    quoted = f"{key}=['NAME']" if "list" in named else f"{key}='NAME'"
    assert line.endswith(f'"{quoted}".')


def test_quotes_keep_a_name_that_reads_as_a_number(fails, original):
    line = fails("reconstruct", f"capture.path={original}", "capture.test=['100_7105']")
    assert "must be a list of the capture's cameras" in line and "100_7105" in line


@pytest.mark.parametrize(("word", "code"), [("--version", 0), ("nonsense", 2)])
def test_the_process_of_a_command_ends_with_its_code(word, code):
    words = [sys.executable, "-m", "gaussray", word]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == code
    assert done.stdout.startswith("gaussray ") if code == 0 else done.stderr.count("\n") == 1


def test_no_word_and_help_print_the_verbs(capsys):
    for words in ([], ["--help"], ["-h"]):
        main(words)
        text = capsys.readouterr().out
        assert all(command in text for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command_prints_its_groups_with_choices(command, capsys):
    main([command, "--help"])
    text = capsys.readouterr().out
    several = command in ("demo", "reconstruct", "render", "view", "evaluate")
    assert ("devices.count" in text) == several and f"gaussray {command} --help=all" in text
    lines = text.splitlines()
    assert len(lines) <= 72 and max(map(len, lines)) <= 100
    if command == "render":
        assert "aperture.focus_distance   auto          scene units" in text
        assert "fisheye, kannala_brandt, opencv, orthographic, pinhole" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_all_help_of_a_command_prints_every_key(command, capsys):
    main([command, "--help=all"])
    text = capsys.readouterr().out
    assert "devices." in text and "choices:" in text
    assert all(f"{key} " in text or f"{key.split('.')[-1]}:" in text for key in keys(command))
    if command == "render":
        assert "fisheye, kannala_brandt, keep, opencv, orthographic, pinhole" in text
        main([command, "lens=f_theta", "--help=all"])
        text = capsys.readouterr().out
        assert "lens=f_theta" in text and "lens.k                    [0.0, 9.0e-3, 0.0" in text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--help=all", "write `gaussray COMMAND --help=all`"),
        ("render --help=foo", "`gaussray render --help` or `gaussray render --help=all`."),
    ],
)
def test_help_that_does_not_exist_names_what_does(fails, words, told):
    assert told in fails(*words.split())


def test_help_says_how_the_command_ends(capsys):
    main(["--help"])
    text = capsys.readouterr().out
    assert all(f"{code}  {word}" in text for code, word in EXITS.items())
    assert set(EXITS) == {0, 1, 2, 130}


def test_every_key_that_is_used_most_is_a_key_with_a_meaning():
    for command, named in MOST_USED.items():
        known = keys(command)
        assert all(known[name].meaning for name in named.split())


def test_an_unknown_command(fails):
    line = fails("paint")
    assert "'paint'" in line and all(command in line for command in COMMANDS)
    assert "Did you mean render?" in fails("rendr")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["apertur.radius=1"], "apertur.radius is no key of `gaussray render`"),
        (["apertur.radius=1"], "Did you mean aperture.radius?"),
        (
            ["capture.path=x"],
            "capture.path is no key of `gaussray render`. It is one of `calibrate`, ",
        ),
        (["aperture.focus_distanc=1"], "Did you mean aperture.focus_distance?"),
        (["+shutter.exposur=1"], "shutter.exposur is unknown"),
        (["+shutter.exposur=1"], "Did you mean exposure?"),
        (["lens=fisheey"], "got 'fisheey'. Did you mean fisheye?"),
        (["scene=a,b"], "scene: a path with a comma needs quotes inside those of the shell"),
        (["labels=depth,time"], "labels must be one value or a list, got 'depth,time'. Write 'la"),
        (["--lens", "fisheye"], "must be key=value, got '--lens'. Leave out --."),
        (["lens", "=", "fisheye"], "must be key=value, got 'lens'. Write lens=VALUE without sp"),
        (["camera.names=[a,", "b]"], "must be key=value, got 'b]'. A list has no spaces, or st"),
        (["render.size=[4,4]", "aperture.f_number=2"], "aperture.f_number is no key of `gaussray"),
        (["fisheye"], "must be key=value, got 'fisheye'. Did you mean lens=fisheye?"),
        (["progress=loud"], "progress must be one of auto, bar, lines, json, quiet, got 'loud'"),
        (["sample.lens.fov.uniform=[1,2]", "devices.hosts=2"], "devices"),
    ],
)
def test_a_word_that_was_probably_meant(fails, scene_file, words, named):
    assert named in fails("render", f"scene={scene_file}", "out=x", *words)


@pytest.mark.parametrize("word", ["{}", "{}=1", "lens={}"])
def test_of_a_long_word_the_beginning_is_shown(fails, scene_file, word):
    line = fails("render", f"scene={scene_file}", "out=x", word.format("9" * 5000))
    assert "9" * 200 in line and "9" * 201 not in line


def test_a_folder_named_by_the_time_is_not_shared_by_processes(fails, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["scene=x", "dataset.count=4", "dataset.shard=0/2"]
    assert "out must be given where several processes share it" in fails("render", *words)
    hosts = ["capture.path=x", "devices.hosts=2", "devices.process=0"]
    assert "out must be given" in fails("reconstruct", *hosts)


def test_an_error_is_told_in_json_too(capsys):
    with pytest.raises(SystemExit):
        main(["render", "scene=none", "out=x", "progress=json"])
    out, err = capsys.readouterr()
    told = json.loads(out)
    assert (told["event"], told["code"]) == ("error", 2) and told["text"] in err


def test_a_fault_of_ours_is_raised_and_ends_with_one(monkeypatch):
    def stumble(*_):
        raise TypeError("a fault")

    monkeypatch.setitem(RUN, "render", stumble)
    with pytest.raises(TypeError, match="a fault"):
        main(["render", "scene=x", "out=x"])


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["reconstruct", "out=x"], "capture.path must be given"),
        (["import", "source=x"], "out must be given"),
        (["render", "out=x"], "scene must be given"),
        (["evaluate", "scene=x"], "truth must be given"),
        (["reconstruct", "capture.path=x", "out=x", "fit.steps=3"], "fit.steps"),
        (["reconstruct", "capture.path=x", "out=x", "+fit.steps=3"], "fit.steps is unknown"),
        (
            ["reconstruct", "capture.path=x", "out=x", "trace=quick"],
            "trace must be one of default, exact, fast, fit, fit_far",
        ),
        (["reconstruct", "capture.path=x", "out=x", "--fast"], "--fast"),
        (
            ["reconstruct", "capture.path=x", "out=x", "trace.k=0"],
            "trace.k must be at least 1, got 0",
        ),
        (["demo", "out=x", "fit.coarse=many"], "fit.coarse must be a whole number"),
    ],
)
def test_a_wrong_key(fails, tmp_path, monkeypatch, words, named):
    monkeypatch.chdir(tmp_path)
    assert named in fails(*words)
    assert not (tmp_path / "x").exists()


def test_a_capture_that_is_not_there(fails, tmp_path):
    line = fails("reconstruct", f"capture.path={tmp_path}/none", f"out={tmp_path}/out")
    assert f"{tmp_path}/none" in line
    assert not (tmp_path / "out").exists()
    assert "capture.path" in fails("demo", f"capture.path={tmp_path}/none", f"out={tmp_path}/out")


@pytest.mark.parametrize("command", ["render", "evaluate"])
def test_a_scene_that_is_not_there_or_not_one(fails, tmp_path, capture, command):
    rest = [f"out={tmp_path}/out"] + [f"truth={capture}"] * (command == "evaluate")
    assert "no such file" in fails(command, f"scene={tmp_path}/none.npz", *rest)
    other = tmp_path / "other.npz"
    other.write_text("a text")
    assert "is not a gaussray-scene file" in fails(command, f"scene={other}", *rest)
    np.savez(other, a=np.zeros(3))
    assert "is not a gaussray-scene file" in fails(command, f"scene={other}", *rest)


def test_a_scene_of_another_version_or_kind(fails, tmp_path):
    path = tmp_path / "scene.npz"
    write_arrays(path, {"format": "gaussray-scene", "version": 99}, {})
    assert "version 99" in fails("render", f"scene={path}", f"out={tmp_path}/out")
    write_arrays(path, {"format": "gaussray-checkpoint", "version": 2}, {})
    assert "gaussray-checkpoint" in fails("render", f"scene={path}", f"out={tmp_path}/out")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.98])
def test_a_truncated_scene(fails, tmp_path, scene_file, share):
    path = tmp_path / "scene.npz"
    content = scene_file.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "damaged" in fails("render", f"scene={path}", f"out={tmp_path}/out")


def test_a_scene_without_cameras(fails, tmp_path):
    save_scene(tmp_path / "scene.npz", toy.scene())
    line = fails("render", f"scene={tmp_path}/scene.npz", f"out={tmp_path}/out")
    assert "cameras.json" in line and "cameras=DIR" in line


@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("aperture.radius=-0.5", "aperture.radius must be at least 0, got -0.5"),
        ("shutter.exposure=-1 shutter.kind=global", "shutter.exposure must be at least 0"),
        ("shutter.kind=sideways", "shutter.kind must be keep, global, rolling"),
        ("shutter.kind=rolling shutter.direction=up", "shutter.direction must be one of"),
        ("lens.model=mirror", "lens.model must be"),
        ("lens=pinhole lens.fov=180", "lens.fov must be in (0, 180)"),
        (
            "lens=kannala_brandt lens.k=[1.0]",
            "lens.k must hold 4 coefficients for kannala_brandt, got 1",
        ),
        ("film.filter=sharp", "film.filter must be one of"),
        ("trajectory.kind=fly", "trajectory.kind must be keep, between, path"),
        ("trajectory=between", "needs at least two cameras"),
        ("trajectory=between trajectory.steps=0 camera.split=train", "trajectory.steps"),
        ("camera.names=[cam_9]", "camera.names must be among"),
        ("camera.times=[0.25]", "got 0.25; the nearest are 0, 0.5."),
        ("camera.split=validation", "camera.split"),
        ("camera.split=validation camera.names=[cam0]", "camera.split must be train, test or all"),
        ("camera.times=[0,inf]", "camera.times must be finite, got [0.0, inf]. Give times in"),
        ("camera=look_at camera.times=[inf]", "camera.times must be finite, got [inf]."),
        ("render.samples=0", "render.samples must be at least 1"),
        ("shutter=rolling shutter.readout=-1", "shutter.readout must be at least 0, got -1"),
        ("shutter=rolling shutter.readout=inf", "shutter.readout must be finite, got inf. Give"),
        ("shutter=rolling shutter.row_step=-inf", "shutter.row_step must be finite, got -inf."),
        ("shutter=interlaced shutter.field_time=inf", "shutter.field_time must be finite, got inf"),
        ("shutter=global shutter.exposure=inf", "shutter.exposure must be finite, got inf. Give"),
        (
            "aperture=wide aperture.focus_distance=0",
            "aperture.focus_distance must be above 0, got 0",
        ),
        ("aperture.radius=-1", "aperture.radius must be at least 0, got -1"),
        ("lens.fov=120", "lens.fov has no effect with lens=keep. Choose a lens"),
        (
            "film.width=256",
            "film.width is now called film.filter_width; the size of the pictures is",
        ),
        ("film.size=[64]", "film.size must be [width,height] in pixels, such as [1920,1080], got"),
        (
            "dataset.count=3 aperture.radius=0.1 sample.aperture.focus_distance.choice=[0,-1]",
            "sample 0 is impossible: aperture.focus_distance must be above 0, got",
        ),
        (
            "dataset.count=2 sample.lens.choice=[kannala_brandt] sample.lens.k.choice=[[-9,0,0,0]]",
            "sample 0 is impossible: lens.",
        ),
        (
            "dataset.count=2 dataset.frames=0 shutter.kind=global "
            "sample.shutter.exposure.uniform=[0.6,0.7]",
            "sample 0 is impossible: shutter.exposure must be at most the 0.5 from one frame",
        ),
        (
            "dataset.count=1 dataset.layout=euroc lens=equidistant",
            "sample 0 is impossible: dataset.layout=euroc must have a pinhole lens with k1 k2 p1 "
            "p2 or a Kannala-Brandt fisheye, got equidistant. Render with lens=pinhole",
        ),
        (
            "dataset.count=1 dataset.layout=carla_rs imu.rate=100",
            "imu.rate has no effect with dataset.layout=carla_rs. Choose dataset.layout=euroc, or",
        ),
        (
            "dataset.count=1 imu.gravity=[0,0,-1]",
            "imu.gravity has no effect without dataset.layout",
        ),
        (
            "imu.units_per_metre=2",
            "imu.units_per_metre needs dataset.count of at least 1, got 0",
        ),
        ("dataset.frames=3", "dataset.frames needs dataset.count of at least 1, got 0"),
        ("dataset.seed=3", "dataset.seed needs dataset.count of at least 1, got 0"),
        ("camera=look_at camera.times=[nan]", "camera.times must be a list of numbers, got nan in"),
        ("shutter=rolling shutter.readout=nan", "shutter.readout must be a number, got nan."),
        ("dataset.count=2 sample.fps=3", "sample.fps must be a distribution"),
        ("dataset.count=2 sample.lens.fog.uniform=[0,1]", "sample.lens.fog: lens.fog is no key"),
        ("dataset.count=2 sample.lens.choice=[mirror]", "got 'mirror'"),
        ("fps=0", "fps"),
        ("sensor.tone=filmic format=exr", "sensor.tone must be srgb with format=exr"),
        ("sensor.bits=8", "sensor.bits needs sensor.white above 0"),
        ("physical.f_number=2", "physical.f_number needs physical.focal_length"),
        (
            "physical.focal_length=50 physical.sensor=[36,24]",
            "physical.sensor must have the shape of the picture",
        ),
        (
            "shutter=rolling physical.readout=10 physical.seconds_per_unit=1",
            "shutter.readout = 0.25 and physical.readout = 10.0 both set it",
        ),
    ],
)
def test_a_camera_that_cannot_be(fails, tmp_path, scene_file, override, named):
    words = override.split()
    assert named in fails("render", f"scene={scene_file}", f"out={tmp_path}/out", *words)


def test_a_page_without_its_package_says_what_to_install(fails, scene_file, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install -e '.[viewer]'" in fails("view", f"scene={scene_file}")


@pytest.mark.parametrize("command", ["reconstruct", "render", "evaluate"])
def test_an_output_folder_that_cannot_be_made(fails, tmp_path, scene_file, capture, command):
    (tmp_path / "file").write_text("")
    given = {
        "reconstruct": [f"capture.path={capture}"],
        "render": [f"scene={scene_file}"],
        "evaluate": [f"scene={scene_file}", f"truth={capture}"],
    }
    line = fails(command, *given[command], f"out={tmp_path}/file/out")
    assert f"out={tmp_path}/file/out: cannot be written" in line


def reconstruct_of(capture):
    return ["reconstruct", f"capture.path={capture}", f"out={capture}/out"]


def test_a_malformed_json(fails, capture):
    (capture / "transforms.json").write_text('{"frames": [')
    line = fails(*reconstruct_of(capture))
    assert "transforms.json" in line and "malformed JSON at line 1" in line


def test_a_pose_that_is_not_finite(fails, capture):
    def spoil(document):
        document["frames"][2]["transform_matrix"][0][3] = float("nan")

    line = fails(*reconstruct_of(edited(capture, spoil)))
    assert "frame 2" in line and "transform_matrix must be finite" in line


def test_a_capture_without_training_views(fails, capture):
    def spoil(document):
        for frame in document["frames"]:
            frame["split"] = "test"
        document.pop("split", None)

    assert "train" in fails(*reconstruct_of(edited(capture, spoil)))


def test_a_picture_that_is_missing(fails, capture):
    path = capture / "images" / "cam_1" / "0001.png"
    path.unlink()
    line = fails(*reconstruct_of(capture), "capture.missing=error")
    assert str(path) in line and "1 of 12 frames have no picture" in line


def test_a_picture_that_is_truncated(fails, capture):
    path = capture / "images" / "cam_1" / "0001.png"
    path.write_bytes(path.read_bytes()[:-30])
    line = fails(*reconstruct_of(capture))
    assert str(path) in line and "truncated or corrupt" in line


def test_a_picture_of_another_size(fails, capture):
    path = capture / "images" / "cam_1" / "0001.png"
    write_image(path, np.zeros((8, 20, 3), np.uint8))
    line = fails(*reconstruct_of(capture))
    assert str(path) in line and "got 20 x 8" in line and "16 x 16" in line


def test_a_bundle_larger_than_the_picture(fails, capture):
    assert "trace.bundle must be at most" in fails(*reconstruct_of(capture), "trace.bundle=32")


def test_resuming_where_nothing_was_left(fails, capture):
    line = fails(*reconstruct_of(capture), "resume=true")
    assert "checkpoint.npz" in line and "resume" in line
    assert not (capture / "out").exists()


def test_a_refused_run_leaves_the_settings_of_the_unfinished_one(fails, capture):
    out = capture / "out"
    out.mkdir()
    (out / "checkpoint.npz").touch()
    (out / "config.yaml").write_text("as it was")
    assert "holds an unfinished reconstruction" in fails(*reconstruct_of(capture))
    assert (out / "config.yaml").read_text() == "as it was"


def test_a_truth_without_frames_of_the_split(fails, capture, scene_file):
    def spoil(document):
        for frame in document["frames"]:
            frame["split"] = "train"

    line = fails("evaluate", f"scene={scene_file}", f"truth={edited(capture, spoil)}",
                 f"out={capture}/out")  # fmt: skip
    assert "evaluate.split=all" in line


def test_an_interruption_says_how_to_go_on(fails, capture, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("gaussray.reconstruct.pipeline.reconstruct", stop)
    assert "resume=auto" in fails(*reconstruct_of(capture), code=130)


@pytest.mark.parametrize(
    ("resume", "left", "told"),
    [
        ("auto", [], False),
        ("auto", ["checkpoint.npz"], True),
        ("auto", ["checkpoint.npz", "scene.npz", "requirement.json"], True),
        ("auto", ["scene.npz", "requirement.json"], None),
        (False, ["checkpoint.npz"], False),
    ],
)
def test_the_same_words_serve_a_run_at_every_moment(tmp_path, resume, left, told):
    for name in left:
        (tmp_path / name).touch()
    assert should_resume(OmegaConf.create({"out": str(tmp_path), "resume": resume})) is told


def test_any_other_resumption_is_refused(capture, fails):
    line = fails(*reconstruct_of(capture), "resume=perhaps")
    assert "resume must be true, false or auto, got 'perhaps'" in line


# A program whose compilation XLA complains about: it evaluates a constant for seconds.
SLOW_COMPILATION = """
from importlib import import_module


def compile_slowly():
    import jax
    import numpy as np

    values = np.random.default_rng(0).random((220, 220), np.float32)

    def sums():
        return jax.lax.reduce_window(
            jax.numpy.asarray(values), 0.0, jax.lax.add, (8, 8), (1, 1), "VALID"
        )

    jax.jit(sums).lower().compile()


command = import_module("gaussray.cli.main")
command.main = compile_slowly
command.program()
"""


@pytest.mark.ci
@pytest.mark.parametrize("level", [None, "1"])
def test_the_compilers_own_log_is_not_shown_unless_it_is_asked_for(level):
    environment = {k: v for k, v in os.environ.items() if k != "TF_CPP_MIN_LOG_LEVEL"}
    environment |= {"TF_CPP_MIN_LOG_LEVEL": level} if level else {}
    environment["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    words = [sys.executable, "-c", SLOW_COMPILATION]
    told = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert ("Constant folding" in told.stderr) == (level == "1")


def test_a_refused_render_leaves_the_record_of_what_is_there(fails, tmp_path, scene_file):
    words = ["render", f"scene={scene_file}", f"out={tmp_path}/a", "report=false"]
    words += ["render.samples=1", "camera.times=[0]", "progress=quiet"]
    main([*words, "lens=pinhole", "lens.fov=60"])
    record = (
        (tmp_path / "a" / "config.yaml").read_bytes(),
        (tmp_path / "a" / "run.json").read_bytes(),
    )
    assert "of another scene, camera or option" in fails(*words, "lens=pinhole", "lens.fov=50")
    kept = (tmp_path / "a" / "config.yaml").read_bytes(), (tmp_path / "a" / "run.json").read_bytes()
    assert kept == record


def test_a_run_is_not_resumed_with_other_pictures(fails, tmp_path, capture):
    write_capture_facts(tmp_path, open_capture(capture))
    (tmp_path / "checkpoint.npz").touch()
    (tmp_path / "config.yaml").write_text("as it was")
    words = ["reconstruct", f"capture.path={capture}", f"out={tmp_path}", "resume=true"]
    assert "of other pictures" in fails(*words, "capture.scale=0.5")
    assert (tmp_path / "config.yaml").read_text() == "as it was"
