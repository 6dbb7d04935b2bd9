"""Words of a command line that Hydra's grammar has no room for."""

import pytest
from omegaconf import OmegaConf

from gaussray.config.compose import compose_config
from gaussray.config.run_folder import changed_keys


@pytest.mark.parametrize(
    "name",
    [
        "runs/näm",
        "a b (1)",
        "it's (1)",
        "C:\\ä\\b",
        "a (b)\\",
        "é\\'x",
        '(a)"b"',
        "plain/name",
        "файл",
        "a=b c=d",
    ],
)
def test_names_of_folders_may_hold_any_letter(name):
    cfg = compose_config("reconstruct", ["capture.path=DIR", f"out={name}"])
    assert cfg.out == name


def test_a_list_that_does_not_end_is_refused():
    with pytest.raises(ValueError, match=r"no viable alternative at input '\[pose'"):
        compose_config("reconstruct", ["capture.path=DIR", "out=o", "fit.refine=[pose"])


def test_a_home_folder_is_found(monkeypatch):
    monkeypatch.setenv("HOME", "/home/one")
    cfg = compose_config("reconstruct", ["capture.path=~/in", "out=~/runs/a"])
    assert (cfg.capture.path, cfg.out) == ("/home/one/in", "/home/one/runs/a")


@pytest.mark.parametrize("word", ["out=", "capture.path="])
def test_an_empty_name_is_refused(word):
    with pytest.raises(ValueError, match="must be the name of a file or folder, got an empty text"):
        compose_config("reconstruct", ["capture.path=DIR", "out=o", word])


def test_scores_of_the_sample_leave_no_folder_of_its_name():
    cfg = compose_config("evaluate", ["scene=sample", "truth=sample"])
    assert cfg.out == "runs/sample/evaluation"
    assert compose_config("evaluate", ["scene=a", "truth=b"]).out == "a/evaluation"


def test_keys_that_differ_from_a_finished_run_are_named(tmp_path):
    words = ["capture.path=DIR", f"out={tmp_path}"]
    cfg = compose_config("reconstruct", words)
    assert changed_keys(cfg) == []
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(cfg))
    assert changed_keys(cfg) == []
    other = compose_config("reconstruct", [*words, "fit.seed=9", "capture.scale=0.5", "quiet=true"])
    assert changed_keys(other) == ["capture.scale", "fit.seed"]
    assert changed_keys(other, most=1) == ["capture.scale"]
    (tmp_path / "config.yaml").write_text("{")
    assert changed_keys(other) == []


@pytest.mark.parametrize(
    ("command", "words", "key", "value"),
    [
        ("reconstruct", ["capture.path=x", "need.loss=0.5"], "prune.loss", 0.5),
        ("reconstruct", ["capture.path=x", "need=default"], "prune.loss", 0.02),
        ("reconstruct", ["capture.path=x", "need.weigh=9"], "prune.contribution_tiles", 9),
        ("reconstruct", ["capture.path=x", "fit.rise=7"], "fit.degree_interval", 7),
        ("reconstruct", ["capture.path=x", "loss.one=0.5"], "loss.time_planes_from_one", 0.5),
        ("render", ["scene=x", "factory.count=3"], "dataset.count", 3),
        ("render", ["scene=x", "dataset=euroc"], "dataset.layout", "euroc"),
        ("render", ["scene=x", "dataset=default"], "dataset.layout", ""),
        ("render", ["scene=x", "render.size=[4,6]"], "film.size", [4, 6]),
    ],
)
def test_names_of_earlier_versions_are_understood(command, words, key, value):
    assert OmegaConf.select(compose_config(command, words), key) == value


def test_a_preset_may_have_names_of_earlier_versions(tmp_path):
    preset = tmp_path / "old.yaml"
    preset.write_text("factory: {count: 3, frames: 2}\n")
    cfg = compose_config("render", ["scene=x", f"preset={preset}"])
    assert (cfg.dataset.count, cfg.dataset.frames) == (3, 2)


def test_a_mistake_in_a_name_of_an_earlier_version_is_told_in_todays():
    with pytest.raises(ValueError, match=r"^prune\.los is no key .*prune\.loss"):
        compose_config("reconstruct", ["capture.path=x", "need.los=0.5"])


@pytest.mark.parametrize("word", ["report=maybe", "quiet=2", "tensorboard=[]"])
def test_what_is_neither_true_nor_false_is_refused(word):
    with pytest.raises(ValueError, match=f"^{word.split('=')[0]} must be true or false, got"):
        compose_config("reconstruct", ["capture.path=x", word])
