"""One YAML leaf is one options class, with the same keys and the same defaults."""

import functools
import pathlib
import re
import tomllib

import jax
import pytest
from omegaconf import OmegaConf

from benchmarks.trade import PRESETS
from gaussray.calibrate.options import CalibrateOptions
from gaussray.camera.imu import ImuOptions
from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.capture.open import FORMATS
from gaussray.capture.selection import Selection
from gaussray.cli.help import COMMANDS
from gaussray.config.compose import Variations, compose_config
from gaussray.config.options import build_options
from gaussray.config.schema import choice_keys, conf_folder
from gaussray.evaluate.options import EvaluateOptions
from gaussray.io.safe.limits import Limits
from gaussray.prepare.options import FramesOptions, PosesOptions, SyncOptions
from gaussray.reconstruct import options as stage
from gaussray.render.options import RenderOptions
from gaussray.render.randomize.distributions import draw_values, read_distributions
from gaussray.render.randomize.options import DrawOptions
from gaussray.render.rig import rig
from gaussray.render.rig.physical_units import PhysicalOptions
from gaussray.runtime.devices import DevicesOptions
from gaussray.tracer.options import TraceOptions
from gaussray.viewer.options import ViewOptions


# Every group of conf/, its class, and the leaf that holds the defaults of the class.
GROUPS = {
    "fit": (stage.FitOptions, "auto"),
    "track": (stage.TrackOptions, "default"),
    "field": (stage.FieldOptions, "default"),
    "loss": (stage.LossOptions, "default"),
    "optimizer": (stage.OptimizerOptions, "default"),
    "density": (stage.DensityOptions, "default"),
    "prune": (stage.PruneOptions, "default"),
    "trace": (TraceOptions, "default"),
    "devices": (DevicesOptions, "default"),
    "render": (RenderOptions, "default"),
    "evaluate": (EvaluateOptions, "default"),
    "calibrate": (CalibrateOptions, "default"),
    "camera": (rig.CameraOptions, "default"),
    "lens": (rig.LensOptions, "keep"),
    "aperture": (rig.ApertureOptions, "keep"),
    "shutter": (rig.ShutterOptions, "keep"),
    "trajectory": (rig.TrajectoryOptions, "keep"),
    "film": (rig.FilmOptions, "keep"),
    "physical": (PhysicalOptions, "none"),
    "sensor": (SensorOptions, "none"),
    "dataset": (DrawOptions, "default"),
    "imu": (ImuOptions, "default"),
    "view": (ViewOptions, "default"),
    "limits": (Limits, "default"),
    "sync": (SyncOptions, "default"),
    "frames": (FramesOptions, "default"),
    "poses": (PosesOptions, "default"),
}
CHOICES = [
    (group, path.stem)
    for group in GROUPS
    for path in sorted((conf_folder() / group).glob("*.yaml"))
]
# What each command demands before it says anything else.
GIVEN = {
    "demo": [],
    "prepare": ["videos=x", "out=x"],
    "reconstruct": ["capture.path=x", "out=x"],
    "render": ["scene=x", "out=x"],
    "view": ["scene=x"],
    "evaluate": ["scene=x", "truth=x"],
    "calibrate": ["scene=x", "capture.path=x", "out=x"],
    "import": ["source=x", "out=x"],
    "export": ["scene=x", "out=x"],
    "pack": ["data=x", "out=x"],
}


@functools.cache
def group_of(group, choice):
    """What one YAML file says, in the words of a command."""
    fitted = "fit", "track", "field", "loss", "optimizer", "density", "prune"
    command = "reconstruct" if group in fitted else "render"
    command = "prepare" if group in ("sync", "frames", "poses") else command
    command = group if group in ("evaluate", "calibrate", "view") else command
    return compose_config(command, [*GIVEN[command], f"{group}={choice}"])[group]


def leaf(group, choice):
    """The options of one YAML file."""
    return build_options(GROUPS[group][0], group_of(group, choice))


def test_every_group_has_a_class():
    groups = {path.name for path in conf_folder().iterdir() if path.is_dir()}
    assert groups == {*GROUPS, "capture", "sample"}


@pytest.mark.parametrize("name", [path.stem for path in (conf_folder() / "sample").glob("*.yaml")])
def test_every_sample_holds_distributions_of_keys_that_there_are(name):
    cfg = compose_config("render", [*GIVEN["render"], f"sample={name}"])
    found = read_distributions(OmegaConf.to_container(cfg.sample) if "sample" in cfg else {})
    assert bool(found) == (name != "none")
    made = Variations("render", GIVEN["render"]).with_values(draw_values(0, 0, 0, found))
    assert all(OmegaConf.select(made, key) is not None for key in found)


def test_every_format_of_captures_is_a_choice_that_differs_in_nothing_else():
    choices = {path.stem for path in (conf_folder() / "capture").glob("*.yaml")}
    assert choices == {"auto", *FORMATS}
    auto = compose_config("reconstruct", GIVEN["reconstruct"]).capture
    for name in choices:
        chosen = compose_config("reconstruct", [*GIVEN["reconstruct"], f"capture={name}"]).capture
        assert chosen == {**auto, "format": name}
    assert set(auto) == {"path", "format", "background", *Selection.__dataclass_fields__}
    plain = {key: auto[key] for key in ("frames", "crop", "test")}
    lists = {key: tuple(value) for key, value in plain.items()}
    assert Selection(**lists, scale=auto.scale) == Selection()


@pytest.mark.parametrize("group", GROUPS)
def test_the_defaults_in_yaml_are_the_defaults_in_code(group):
    kind, choice = GROUPS[group]
    assert leaf(group, choice) == kind()


def test_a_reconstruction_traces_as_its_class_says():
    assert leaf("trace", "fit") == stage.ReconstructOptions().trace


def test_presets_of_the_trace_are_those_that_were_measured():
    for name, changes in PRESETS.items():
        assert leaf("trace", name) == TraceOptions(**changes)


@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_every_choice_has_every_key_with_a_meaning_and_builds_options_without_leaves(group, choice):
    built = leaf(group, choice)
    assert not jax.tree.leaves(built)
    assert hash(built) == hash(leaf(group, choice))
    fields = set(GROUPS[group][0].__dataclass_fields__)
    assert set(group_of(group, choice)) == fields == set(choice_keys(group, choice))
    assert all(key.meaning for key in choice_keys(group, choice).values())


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_configuration(command):
    assert compose_config(command, GIVEN[command])


@pytest.mark.parametrize("override", ["fit.steps=3", "+fit.steps=3"])
def test_an_unknown_key_fails_and_is_named(override):
    with pytest.raises(ValueError, match="fit.steps"):
        cfg = compose_config("demo", [override])
        build_options(stage.FitOptions, cfg.fit)


@pytest.mark.parametrize(
    ("command", "override", "message"),
    [
        ("demo", "fit.coarse=many", "fit.coarse must be a whole number, got 'many'"),
        ("demo", "fit.coarse=2.5", "fit.coarse must be a whole number, got 2.5"),
        ("demo", "fit.initial_opacity=null", "fit.initial_opacity must be a number, got None"),
        ("evaluate", "evaluate.images=3", "evaluate.images must be true or false, got 3"),
        ("render", "camera.names=cam_0", "camera.names must be a list, got 'cam_0'"),
        (
            "render",
            "aperture.focus_distances=[1.5,far]",
            "aperture.focus_distances must be a list of numbers, got 'far' in it",
        ),
        (
            "render",
            "lens.model=7",
            "lens.model must be a text, got 7. A name that reads as a number",
        ),
        (
            "render",
            "camera.names=[100_7105]",
            "camera.names must be a list of names, got 1007105 in it. A name that reads as a "
            "number, as 100_7 reads as 1007, needs quotes, and for the shell others around them: "
            "\"camera.names=['NAME']\".",
        ),
        ("render", "camera.names=[a,true]", "camera.names must be a list of names, got True in it"),
        ("evaluate", "evaluate.effects=[1e5]", "evaluate.effects must be a list of names, got 1"),
        ("prepare", "poses.lens=[500,a]", "poses.lens must be a list of numbers, got 'a' in it"),
        ("prepare", "poses.lens=[1,2]", "poses.lens must be"),
        ("demo", "limits.folders=[20_24]", "got 2024 in it. A name that reads as a number"),
        ("demo", "field.sides=[1]", "field.sides must hold"),
        ("demo", "density.start=0.9", "density.start and density.stop must satisfy"),
        ("demo", "devices.count=-1", "devices.count must be at least 0, got -1"),
        ("demo", "devices.hosts=2", "devices.process must be in 0 ... 1 with devices.hosts=2"),
        ("render", "devices.coordinator=here", "devices.coordinator must be HOST:PORT"),
        ("demo", "loss.l1=-1", "loss.l1 must be at least 0, got -1"),
        ("demo", "optimizer.decay=0", "optimizer.decay must be in"),
        ("render", "render.keys=1", "render.keys must be 0 (chosen"),
        ("render", "sensor.gain=0.5", "sensor.gain must be at least 1, got 0.5"),
        ("render", "sensor.gain=null", "sensor.gain must be a number, got None"),
        ("render", "physical.f_number=0", "physical.f_number must be above 0, got 0"),
        ("render", "physical.readout=fast", "physical.readout must be a number, got 'fast'"),
        ("render", "dataset.count=-1", "dataset.count must be at least 0, got -1"),
        ("render", "dataset.shard=2/2", "dataset.shard must be i/n with i from 0 to n - 1"),
        ("render", "dataset.shards=2", "dataset.shards = 2 needs dataset.count above 0"),
        ("view", "view.port=0", "view.port must be in 1 ... 65535, got 0"),
        ("view", "view.rate=0", "view.rate must be above 0 frames a second, got 0"),
        ("view", "view.keys=4", "view.keys must be 2 or odd from 3, got 4"),
        ("evaluate", "evaluate.split=both", "evaluate.split must be train, test or all"),
    ],
)
def test_a_bad_value_fails_with_key_rule_and_value(command, override, message):
    group = override.split(".")[0]
    cfg = compose_config(command, [*GIVEN[command], override])
    with pytest.raises(ValueError, match=re.escape(message)):
        build_options(GROUPS[group][0], cfg[group])


def test_a_whole_number_does_for_a_fraction():
    cfg = compose_config("demo", ["fit.initial_opacity=1"])
    assert build_options(stage.FitOptions, cfg.fit).initial_opacity == 1.0
    cfg = compose_config("render", [*GIVEN["render"], "physical.sensor=[36,24.0]"])
    sensor = build_options(PhysicalOptions, cfg.physical).sensor
    assert sensor == (36.0, 24.0) and {type(x) for x in sensor} == {float}


@pytest.mark.parametrize(
    ("word", "lens"), [("[5,5.5,3,2]", (5.0, 5.5, 3.0, 2.0)), ("a.yml", "a.yml"), ("null", None)]
)
def test_a_lens_is_a_file_or_numbers(word, lens):
    cfg = compose_config("prepare", ["videos=in", "out=out", f"poses.lens={word}"])
    assert build_options(GROUPS["poses"][0], cfg.poses).lens == lens


def test_a_page_begins_with_any_camera_that_can_be_rendered():
    cfg = [compose_config(command, GIVEN[command]) for command in ("render", "view")]
    groups = {"lens", "aperture", "shutter", "trajectory", "film", "physical", "sensor", "trace"}
    assert all(cfg[0][group] == cfg[1][group] for group in groups | {"camera", "render"})


def test_a_preset_is_every_kind_of_value_as_a_word(tmp_path):
    path = tmp_path / "a b.yaml"
    path.write_text(
        "lens: {k: [1.0e-8, -2], file: 'it''s, [a] \"b\"'}\ncameras: null\nquiet: true\n"
    )
    cfg = compose_config("render", [*GIVEN["render"], "cameras=y", f"preset={path}"])
    assert cfg.lens.k == [1e-8, -2] and cfg.lens.file == 'it\'s, [a] "b"'
    assert cfg.cameras is None and cfg.quiet is True


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "must hold keys and values"),
        ("lens: {fov: [", "is no YAML file of keys"),
        ("lens: {fog: 1}", "fog"),
        (None, "cannot be read"),
    ],
)
def test_a_preset_that_is_none_is_refused_by_its_name(tmp_path, text, message):
    path = tmp_path / "wrong.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises((ValueError, OSError), match=message):
        compose_config("render", [*GIVEN["render"], f"preset={path}"])


def test_null_is_for_what_may_be_left_out():
    given = [*GIVEN["render"], "physical.readout=0", "physical.f_number=null"]
    read = build_options(
        PhysicalOptions,
        compose_config("render", [*given, "physical.seconds_per_unit=2"]).physical,
    )
    assert (read.readout, read.f_number, read.seconds_per_unit) == (0.0, None, 2.0)


def test_the_wheel_carries_the_configuration():
    project = pathlib.Path(__file__).parents[2] / "pyproject.toml"
    if not project.is_file():
        pytest.skip("not a checkout")
    wheel = tomllib.loads(project.read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["force-include"]["conf"] == "gaussray/conf"
