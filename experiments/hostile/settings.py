"""What is said to a command: words, and files of YAML.

To compose a configuration takes Hydra a twentieth of a second. A file of a group is therefore read
in two ways: `yaml` loads, places and merges it, by Hydra's own functions, into a configuration that
was composed once; `yaml-command` is all that a command does.
"""

import copy
import functools
from pathlib import Path
from typing import Any

from experiments.hostile.reader import Reader


PLAIN = ["scene=x", "out=x"]
# What the sample speaks of, and what is looked at to know whose folder the output is.
GROUPS = [
    "lens",
    "aperture",
    "sample",
    "devices",
    "dataset",
    "scene",
    "camera",
    "trajectory",
    "out",
    "fps",
]
NAME = "sample/mine"


def _words(folder: Path) -> object:
    from gaussray.config.compose import compose_config

    words = (folder / "words").read_bytes().decode("latin-1").replace("\0", "").split("\n")
    return compose_config("render", [*PLAIN, *(word for word in words if word)])


def _preset(folder: Path) -> object:
    from gaussray.config.yaml_files import preset_words

    return preset_words(folder / "preset.yaml")


def _command(folder: Path) -> object:
    from gaussray.config.compose import compose_config
    from gaussray.config.samples import all_distributions

    return all_distributions(compose_config("render", [*PLAIN, "sample=mine", _search(folder)]))


def _yaml(folder: Path) -> object:
    from hydra.core.default_element import GroupDefault, ResultDefault

    from gaussray.config.compose import as_value_error, check_search_path, resolve_config
    from gaussray.config.samples import all_distributions

    with as_value_error("render", [_search(folder)]):
        check_search_path([_search(folder)])
        loader, repository, plain = _prepared(folder)
        repository.cache.clear()
        found = repository.load_config(NAME)
        # One that names further files.
        if any(not default.is_self() for default in found.defaults_list):
            return _command(folder)
        chosen = GroupDefault(group="sample", value="mine")
        chosen.update_parent("", "")
        chosen.set_package_header(found.header["package"])
        placed = ResultDefault(config_path=NAME, package=chosen.get_final_package())
        cfg = copy.deepcopy(plain)
        cfg.merge_with(loader._load_single_config(placed, repository).config)
    return all_distributions(resolve_config("render", cfg))


@functools.cache
def _prepared(folder: Path) -> tuple[Any, Any, Any]:
    """Hydra's loader, its files and those of a folder, and what they are merged into."""
    from hydra.core.global_hydra import GlobalHydra
    from omegaconf import OmegaConf

    from gaussray.config.compose import compose_unresolved, hydra_session

    cfg = OmegaConf.masked_copy(compose_unresolved("render", PLAIN), GROUPS)
    OmegaConf.set_struct(cfg, None)
    with hydra_session("render", ()):
        loader: Any = GlobalHydra.instance().config_loader()
        _, files = loader._parse_overrides_and_create_caching_repo("render", [_search(folder)])
    return loader, files, cfg


def _search(folder: Path) -> str:
    return f"hydra.searchpath=[file://{folder}]"


SAMPLE = b"""# @package _global_
sample:
  lens:
    fov:
      uniform: [90, 180]
  aperture:
    radius: {log_uniform: [0.01, 0.1]}
  fps: {choice: [8, 9], weights: &a [1, 2]}
  exposure: {uniform: *a}
"""
PRESET = b"""lens: fisheye
lens.fov: 90
camera: {names: &a [a, 'b c'], split: null}
labels: [*a, *a]
out: "x\\u00e9"
sample: {fps: {choice: [8, 9.5e0]}}
quiet: true
"""
WORDS = b"lens=fisheye\nlens.fov=90\ncamera.names=[a,'b c']\nfps=${render.samples}"
CONFIG = ("configuration:", "must be", "sample.", "is no key")


def _text(name: str, content: bytes, read: Any) -> Reader:
    return Reader(lambda: [{name: content}], read, {name: "text"}, CONFIG)


READERS = {
    "preset": _text("preset.yaml", PRESET, _preset),
    "yaml": _text(f"{NAME}.yaml", SAMPLE, _yaml),
    "words": _text("words", WORDS, _words),
    "yaml-command": _text(f"{NAME}.yaml", SAMPLE, _command),
}
