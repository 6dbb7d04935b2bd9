"""What the README and the pages say can be done: every block of code is run, or checked against the
keys that there are."""

import dataclasses
import functools
import importlib.util
import json
import os
import re
import shlex
import tomllib
from pathlib import Path

import jax
import pytest
import toy

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.cli.help import COMMANDS
from gaussray.cli.main import main
from gaussray.cli.reconstruct import reconstruct_options
from gaussray.config import compose as configurations
from gaussray.config.compose import compose_config
from gaussray.config.jobs import render_job
from gaussray.config.options import build_options
from gaussray.config.schema import choices, groups, keys
from gaussray.dataset.manifest import write_manifest
from gaussray.evaluate.options import EvaluateOptions
from gaussray.io import sample_data as samples
from gaussray.io.sample_data import sample
from gaussray.reconstruct import plan
from gaussray.reconstruct.auto.choice import AutoChoice
from gaussray.render.rig.view_files import load_views
from gaussray.scene.store import save_scene


ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.M | re.S)
SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
KEY = re.compile(r"([a-z_]+\.[a-z0-9_.]+)(?:=.*)?")
CHOICE = re.compile(r"([a-z_]+)=([a-z_0-9]+)")
KNOWN = {name for verb in COMMANDS for name in keys(verb)}
GROUPS = {group for verb in COMMANDS for group in groups(verb)}
# Programs of others; what follows `srun` and its flags is a line of its own.
OTHERS = ("colmap", "ffmpeg", "mkdir", "cd", "uv", "git", "podman", "pytest", "ruff", "pyright")
# Names in files, which look like keys.
IN_FILES = {"lens.shift", "aperture.rim", "sample.lens.choice"}
# Another name of film.size, which configuration reads before Hydra does.
ALIASES = {"render.size"}
# A file that is named as a key would be.
FILES = {"dataset.json"}

pytestmark = pytest.mark.usefixtures("known_sizes")


def blocks(language):
    """The blocks of code of all pages, each once, with the page it is on."""
    found = {}
    for page in PAGES:
        for tongue, text in FENCE.findall(page.read_text()):
            if tongue == language:
                found.setdefault(text, page.name)
    return [(page, text) for text, page in found.items()]


def lines(text):
    """The commands of a block, without their comments; a backslash goes on in the next line."""
    joined = re.sub(r"\\\n\s*", " ", text)
    listed = [shlex.split(line, comments=True) for line in joined.splitlines()]
    for words in filter(None, listed):
        while "&&" in words:
            yield words[: words.index("&&")]
            words = words[words.index("&&") + 1 :]
        yield words


def checked(words):
    """Raise unless a command is one that can be given."""
    program, *rest = words
    if program == "gaussray":
        checked_verb(rest)
    elif program == "srun":
        checked(words[words.index("gaussray") :])
    elif program in ("pip", "python") and "install" in rest:
        checked_install(rest)
    elif program == "python":
        checked_python(rest)
    else:
        assert program in OTHERS, f"{program} is no program that the pages may name"


def checked_verb(words):
    verb, *overrides = words
    if verb.startswith("-"):
        assert verb in ("--help", "--version", "--completion")
        return
    assert verb in COMMANDS
    plain = [word for word in overrides if not word.startswith("hydra")]
    if "..." in plain:
        plain[plain.index("...")] = "scene=RUN"
        plain.append("out=OUT")
    if any(word.startswith("-") for word in plain):
        return
    cfg = compose_config(verb, plain)
    if verb in ("reconstruct", "demo"):
        reconstruct_options(cfg)
    if verb == "evaluate":
        build_options(EvaluateOptions, cfg.evaluate)
    if verb == "render":
        build_options(SensorOptions, cfg.sensor)
        if not cfg.dataset.count:
            render_job(cfg, lambda _: toy.scene(), lambda *_: views())


@functools.cache
def views():
    """What the sample's held-out cameras see."""
    return [view for view in load_views(sample("scene"), None) if view.split == "test"]


def checked_install(words):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for match in re.findall(r"\[([\w,]+)\]", " ".join(words)):
        assert set(match.split(",")) <= set(extras["optional-dependencies"]), words


def checked_python(words):
    if words[0] == "-m":
        outside = ("pip", "mkdocs", "build", "venv", "jupytext")
        assert words[1] in outside or importlib.util.find_spec(words[1]), words
    else:
        assert (ROOT / words[0]).is_file(), words


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """A folder in which a toy stands for the sample and for what the pages call RUN and so on."""
    scene, capture = tmp_path / "scene", tmp_path / "experiments/quickstart/capture"
    names = dict(zip(toy.CAMERAS, ("cam00", "cam01", "cam02", "cam13"), strict=True))
    listed = [dataclasses.replace(r, camera_name=names[r.camera_name]) for r in toy.records()]
    scene.mkdir()
    save_scene(scene / "scene.npz", toy.scene())
    write_manifest(scene / "cameras.json", listed)
    there = {"scene": scene, "capture": capture}
    monkeypatch.setattr(samples, "sample", there.get)
    monkeypatch.setattr(configurations, "sample", there.get)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def named_files(tmp_path, monkeypatch):
    """The files that commands name."""
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    path = {"frames": [{"time": time, "transform_matrix": pose} for time in (0, 1)]}
    (tmp_path / "PATH.json").write_text(json.dumps(path))
    monkeypatch.chdir(tmp_path)


def python_blocks():
    """Those that fit or film a scene take long."""
    for page, text in blocks("python"):
        slow = [pytest.mark.slow] if "Renderer(" in text else []
        yield pytest.param(text, id=f"{page}: {text.splitlines()[-1][:40]}", marks=slow)


@pytest.mark.ci
@pytest.mark.parametrize("text", list(python_blocks()))
def test_a_block_of_python_runs(text, tiny, monkeypatch):
    if "gaussray.torch" in text:
        pytest.importorskip("torch", reason="an extra")
    if "reconstruct(" in text:
        toy.write_paired(tiny / "experiments/quickstart/capture", toy.scene())
        monkeypatch.setattr(
            plan, "auto_choice", lambda capture, *_: AutoChoice(capture, toy.SHORT, "")
        )
    exec(compile(text, "page", "exec"), {})  # noqa: S102


@pytest.mark.parametrize(
    "text", [pytest.param(text, id=f"{page}: {text[:40]}") for page, text in blocks("")]
)
def test_a_block_of_commands_has_keys_that_exist(text, named_files):
    for words in lines(text):
        checked(words)


def test_what_does_not_exist_is_found():
    for words in (
        "gaussray render scene=RUN lens.fow=100",
        "gaussray render scene=RUN lens=fishy",
        "gaussray reconstruct capture.path=DIR fit.fine=many",
        "gaussray rend scene=RUN",
        "python -m benchmarks.nothing",
        "python -m pip install -e '.[nothing]'",
        "curl x",
    ):
        with pytest.raises((ValueError, AssertionError)):
            checked(shlex.split(words))


def test_keys_and_choices_in_the_text_exist():
    wrong = []
    for page in PAGES:
        text = FENCE.sub("", page.read_text())
        for span in SPAN.findall(text):
            key, choice = KEY.fullmatch(span), CHOICE.fullmatch(span)
            if key and key[1].split(".")[0] in GROUPS - {"sample"}:
                known = key[1] in KNOWN or any(k.startswith(f"{key[1]}.") for k in KNOWN)
                known |= key[1] in IN_FILES | ALIASES | FILES
                wrong += [] if known else [f"{page.name}: {span}"]
            elif choice and choice[1] in GROUPS and choice[2] not in choices(choice[1]):
                wrong.append(f"{page.name}: {span}")
    assert not wrong


def test_links_and_pictures_are_there():
    wrong = []
    for page in PAGES:
        text = FENCE.sub("", page.read_text())
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
            inside = re.match(r"[a-z]+:", target) or (page.parent / target).exists()
            wrong += [] if inside else [f"{page.name}: {target}"]
    assert not wrong


def test_no_page_needs_a_build_to_be_read():
    for page in PAGES:
        text = page.read_text()
        assert not re.search(r"^:::", text, re.M), f"{page.name}: a line for a generator"
        assert not re.search(r"<div[^>]*></div>", text), f"{page.name}: an empty figure"


def test_the_reference_is_written_from_the_source():
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs/api_reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    assert reference.PAGE.read_text() == reference.page(), "run python docs/api_reference.py"


def test_every_page_is_in_the_menu():
    menu = (ROOT / "mkdocs.yml").read_text()
    assert all(f" {page.name}\n" in menu for page in PAGES[1:])


@pytest.mark.slow
def test_the_first_command_of_the_site_films_the_sample(tiny):
    words = next(lines(next(text for page, text in blocks("") if page == "index.md")))
    assert words[:3] == ["gaussray", "render", "scene=sample"]
    main([*words[1:], "quiet=true", "report=false", "render.samples=1"])
    assert (tiny / "runs/fisheye/fisheye.json").is_file()


@pytest.mark.ci
def test_the_tour_runs(tiny):
    text = (ROOT / "experiments" / "tour.py").read_text()
    assert text.count("\n# %%\n") == 10
    with jax.enable_x64(False):
        exec(compile(text, "tour", "exec"), {})  # noqa: S102
    assert (tiny / "tour.png").is_file()


def test_the_notebook_is_the_tour():
    jupytext = pytest.importorskip("jupytext")
    made = jupytext.read(ROOT / "experiments" / "tour.py")
    kept = jupytext.read(ROOT / "experiments" / "tour.ipynb")
    assert [c.source for c in made.cells] == [c.source for c in kept.cells]


@pytest.mark.slow
def test_the_site_builds_and_asks_for_nothing_from_elsewhere(tmp_path):
    pytest.importorskip("mkdocs")
    code = f"cd {ROOT} && python -m mkdocs build --strict --quiet --site-dir {tmp_path}"
    assert os.system(code) == 0
    for page in [*tmp_path.rglob("*.html"), *tmp_path.rglob("*.css")]:
        text = re.sub(r"<a [^>]*>|<link rel=\"canonical\"[^>]*>", "", page.read_text())
        assert not re.search(r"(src|href)=\"https?:|@import|url\(https?:", text), page
