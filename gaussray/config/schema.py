"""The words that each verb knows, as the YAML files have them: keys with defaults and meanings,
groups with choices."""

import functools
import re
from pathlib import Path
from typing import NamedTuple

from omegaconf import OmegaConf


_LINE = re.compile(r"^( *)([\w]+):(?: +(.*?))?(?: +# (.*))?$")
_MORE = re.compile(r"^ +# (.*)$")


class Key(NamedTuple):
    """What a YAML file says of a key: `???` is a default that must be given."""

    default: str
    meaning: str


def conf_folder() -> Path:
    """The configuration: beside the package in a checkout, inside it when installed."""
    package = Path(__file__).resolve().parents[1]
    inside, beside = package / "conf", package.parent / "conf"
    return inside if inside.is_dir() else beside


@functools.cache
def groups(verb: str) -> dict[str, str]:
    """The groups of a verb, and the choice that each has by default."""
    listed = OmegaConf.load(conf_folder() / f"{verb}.yaml").get("defaults")  # type: ignore[call-arg]
    return {group: chosen for one in listed if one != "_self_" for group, chosen in one.items()}


def choices(group: str) -> list[str]:
    """The choices of a group."""
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


@functools.cache
def keys(verb: str) -> dict[str, Key]:
    """All keys of a verb. What a choice says nothing of is said in the words of another."""
    found = _read((conf_folder() / f"{verb}.yaml").read_text().split("_self_", 1)[1])
    for group, chosen in groups(verb).items():
        told = {name: _read(_text(group, name)) for name in choices(group)}
        for name, key in told[chosen].items():
            meanings = [
                key.meaning,
                *(other[name].meaning for other in told.values() if name in other),
            ]
            meaning = next(filter(None, meanings), "")
            own = found.get(f"{group}.{name}", key)
            found[f"{group}.{name}"] = Key(own.default, own.meaning or meaning)
    return found


def _text(group: str, choice: str) -> str:
    return (conf_folder() / group / f"{choice}.yaml").read_text()


def _read(text: str) -> dict[str, Key]:
    """The keys of a YAML file, those of its groups by their full names; comments may go on in the
    lines below."""
    found, group, last = dict[str, Key](), "", ""
    for line in text.splitlines():
        if match := _LINE.match(line):
            indent, name, value, meaning = match.groups()
            if not value and not indent:
                group, last = name, ""
                continue
            last = f"{group}.{name}" if indent else name
            found[last] = Key(value or "", meaning or "")
        elif last and (match := _MORE.match(line)):
            found[last] = Key(found[last].default, f"{found[last].meaning} {match[1]}".strip())
    return found
