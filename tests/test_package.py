"""What is built and installed: the configuration, the sample, one version in every place."""

import json
import os
import pathlib
import re
import subprocess
import sys
import tomllib
import zipfile

import pytest

from gaussray.config.compose import compose_config
from gaussray.io.sample_data import PARTS, WORD, sample
from gaussray.scene.store import load_scene


ROOT = pathlib.Path(__file__).parents[1]
# PyPI takes 100 MB; a wheel is to be fetched in seconds.
MOST = 10e6


@pytest.fixture(scope="module")
def project():
    path = ROOT / "pyproject.toml"
    if not path.is_file():
        pytest.skip("not a checkout")
    return tomllib.loads(path.read_text())


def test_the_newest_version_has_its_changes(project):
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert headings[0] == "Unreleased" and headings[1] == project["project"]["version"]


def test_what_the_wheel_shall_hold_is_there(project):
    for source in project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]:
        assert any((ROOT / source).iterdir()), source


def test_the_recipe_copies_what_is_there():
    text = (ROOT / "Containerfile").read_text()
    for words in re.findall(r"^COPY (.+)$", text, re.M):
        *sources, _ = words.split()
        assert all((ROOT / source).exists() for source in sources), words


def test_the_sample_is_a_capture_and_a_scene_of_it():
    folder, scene = sample("capture"), load_scene(sample("scene"))
    assert (folder / "fisheye.json").is_file() and (folder / "rolling_shutter.json").is_file()
    assert scene.static.count + scene.moving.count == 12_000
    frames = json.loads((folder / "transforms.json").read_text())["frames"]
    assert len(frames) == 256 and all((folder / x["file_path"]).is_file() for x in frames)
    kept = json.loads((sample("scene") / "cameras.json").read_text())["frames"]
    assert [x["camera"] for x in kept] == [x["camera"] for x in frames]
    assert not any(x["file_path"].startswith("/") for x in kept)


def test_a_word_stands_for_the_sample_unless_a_folder_has_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["scene=sample", "cameras=sample", "out=OUT"]
    cfg = compose_config("render", words)
    assert cfg.scene == str(sample("scene")) and cfg.cameras == str(sample("capture"))
    assert (
        compose_config("evaluate", ["scene=sample", "truth=sample"]).out == "runs/sample/evaluation"
    )
    assert set(PARTS) == {"scene", "cameras", "truth", "capture.path"}
    (tmp_path / WORD).mkdir()
    assert compose_config("render", words).scene == WORD


@pytest.mark.slow
def test_a_wheel_holds_all_and_works_elsewhere(tmp_path):
    pytest.importorskip("hatchling")
    build = [
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        str(tmp_path),
        str(ROOT),
    ]
    subprocess.run([sys.executable, *build], check=True, capture_output=True)
    wheel = next(tmp_path.glob("*.whl"))
    assert wheel.stat().st_size < MOST
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "there")
    code = "from gaussray.io.sample_data import sample; print(sample('scene'), sample('capture'))"
    env = os.environ | {"PYTHONPATH": str(tmp_path / "there")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        check=True,
    )
    assert all(path.startswith(str(tmp_path / "there")) for path in done.stdout.split())
    assert all(pathlib.Path(path).is_dir() for path in done.stdout.split())
