"""Keys and groups of every command, as the YAML files of conf/ have them."""

import functools
import re
from pathlib import Path
from typing import NamedTuple

from omegaconf import OmegaConf


# Keys of earlier versions that now mean something else, and what they are called now.
RENAMED = {"film.width": "film.filter_width"}
# Keys of the command line that stand for another one, and groups of earlier versions by today's.
_ALIASES = {
    "render.size": "film.size",
    "fit.rise": "fit.degree_interval",
    "fit.error": "fit.error_share",
    "fit.balance": "fit.moving_share",
    "fit.moving": "fit.moving_threshold",
    "fit.spread": "fit.initial_scale",
    "fit.opacity": "fit.initial_opacity",
    "loss.nothing": "loss.backdrop_opacity",
    "loss.space": "loss.plane_variation",
    "loss.time": "loss.time_smoothness",
    "loss.one": "loss.time_planes_from_one",
    "optimizer.motion": "optimizer.mean_head",
    "prune.weigh": "prune.contribution_tiles",
    "calibrate.bend": "calibrate.huber_threshold",
    **{
        f"evaluate.{name}": f"evaluate.samples_{name}"
        for name in ("pinhole", "rolling_shutter", "fisheye", "depth_of_field", "other")
    },
}
_RENAMED_GROUPS = {"need": "prune", "factory": "dataset"}
# Keys whose values are paths.
PATH_KEYS = (
    *("capture.path", "out", "scene", "cameras", "truth", "source", "data", "videos"),
    *("lens.file", "trajectory.file", "poses.calibration"),
)
_KEY_LINE = re.compile(r"^( *)([\w]+):(?: +(.*?))?(?: +# (.*))?$")
_COMMENT_LINE = re.compile(r"^ +# (.*)$")


class Key(NamedTuple):
    """A key's default (`???`: it must be given) and the comment that explains it."""

    default: str
    meaning: str


def conf_folder() -> Path:
    """The folder conf/: inside the package when installed, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside, source_folder = package / "conf", package.parent / "conf"
    return inside if inside.is_dir() else source_folder


def commands() -> list[str]:
    """The commands that have keys."""
    return sorted(path.stem for path in conf_folder().glob("*.yaml"))


@functools.cache
def groups(command: str) -> dict[str, str]:
    """The groups of a command, each with its default choice."""
    defaults = OmegaConf.load(conf_folder() / f"{command}.yaml").get("defaults")  # type: ignore[call-arg]
    return {group: name for one in defaults if one != "_self_" for group, name in one.items()}


def choices(group: str) -> list[str]:
    """The choices of a group."""
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


@functools.cache
def keys(command: str) -> dict[str, Key]:
    """All keys of a command, those of its groups as the default choices have them."""
    top_level = (conf_folder() / f"{command}.yaml").read_text().split("_self_", 1)[1]
    all_keys = _keys_of(top_level)
    for group, default_choice in groups(command).items():
        for name, key in choice_keys(group, default_choice).items():
            overridden = all_keys.get(f"{group}.{name}", key)
            all_keys[f"{group}.{name}"] = Key(overridden.default, overridden.meaning or key.meaning)
    return all_keys


@functools.cache
def choice_keys(group: str, choice: str) -> dict[str, Key]:
    """The keys of a choice of a group by their short names: those of the choices that it begins
    with (`defaults`), and its own. A key without a comment has that of another choice.

    Args:
        group: a group of conf/.
        choice: one of its `choices`.
    """
    found: dict[str, Key] = {}
    for base in OmegaConf.load(conf_folder() / group / f"{choice}.yaml").get("defaults", ()):  # type: ignore[call-arg]
        if base != "_self_":
            found |= choice_keys(group, base)
    for name, key in _keys_of(_text(group, choice)).items():
        others = (_keys_of(_text(group, other)) for other in choices(group))
        meanings = (other[name].meaning for other in others if name in other)
        known = found[name].meaning if name in found else ""
        meaning = key.meaning or known or next(filter(None, meanings), "")
        found[name] = Key(key.default, meaning)
    return found


def todays_word(word: str) -> str:
    """A word of the command line with the key that it stands for: `prune.loss=0` for `need.loss=0`.

    Args:
        word: `key=value` or `group=choice`, in the names of this version or of an earlier one.
    """
    name, equals, value = word.partition("=")
    if name == "dataset" and value not in choices("dataset"):
        return f"dataset.layout{equals}{value}" if equals else word
    group, dot, key = name.partition(".")
    name = f"{_RENAMED_GROUPS.get(group, group)}{dot}{key}"
    return f"{_ALIASES.get(name, name)}{equals}{value}"


def _text(group: str, choice: str) -> str:
    return (conf_folder() / group / f"{choice}.yaml").read_text()


def _keys_of(text: str) -> dict[str, Key]:
    """The keys of a YAML file, those of its groups by their full names. A comment may continue in
    the lines below its key."""
    keys_here, group, last = dict[str, Key](), "", ""
    for line in text.splitlines():
        if match := _KEY_LINE.match(line):
            indent, name, value, meaning = match.groups()
            if not value and not indent:
                group, last = name, ""
                continue
            last = f"{group}.{name}" if indent else name
            keys_here[last] = Key(value or "", meaning or "")
        elif last and (match := _COMMENT_LINE.match(line)):
            previous = keys_here[last]
            keys_here[last] = Key(previous.default, f"{previous.meaning} {match[1]}".strip())
    return keys_here
