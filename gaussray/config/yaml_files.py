"""YAML files of keys and values: presets in and out, and the files of conf/."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from gaussray.config.schema import conf_folder
from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text


def to_plain(value: Any) -> Any:
    """A node of a configuration as dict or list; any other value as it is."""
    return OmegaConf.to_container(value) if OmegaConf.is_config(value) else value


def group_values(group: str, choice: str) -> dict[str, Any]:
    """Keys and values of a choice, such as conf/lens/fisheye.yaml with those of conf/lens/keep.yaml
    that it begins with.

    Args:
        group: name of the group (`lens`), which is the file's folder.
        choice: name of the choice (`fisheye`), which is the file's name.
    """
    own: Any = OmegaConf.to_container(OmegaConf.load(conf_folder() / group / f"{choice}.yaml"))
    values: dict[str, Any] = {}
    for base in own.pop("defaults", ()):
        values |= {} if base == "_self_" else group_values(group, base)
    return values | own


def yaml_text(values: Mapping[str, Any]) -> str:
    """Nested keys and values as the text of a YAML file."""
    return OmegaConf.to_yaml(OmegaConf.create(dict(values)))


def read_yaml(path: Path | str) -> Any:
    """The content of an untrusted YAML file: keys and values, or a list.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is no YAML, its aliases expand too far, or it is one single value.
    """
    text = read_text(path).decode()
    try:
        check_aliases(path, text)
        return OmegaConf.to_container(OmegaConf.create(text))
    except (YAMLError, OmegaConfBaseException, RecursionError) as error:
        raise ValueError(str(error)) from error
    except AssertionError:
        # OmegaConf's answer to a YAML that is one number.
        raise ValueError("must hold keys and values, got one value.") from None


def preset_words(path: Path | str) -> list[str]:
    """The keys of a YAML file as words of a command line.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file does not hold keys and values.
    """
    try:
        values = read_yaml(path)
    except OSError as error:
        raise OSError(f"preset={path}: cannot be read: {error}") from error
    except ValueError as error:
        raise ValueError(f"preset={path}: is no YAML file of keys: {error}") from error
    if not isinstance(values, dict):
        raise ValueError(f"preset={path}: must hold keys and values, got a list.")
    return [f"{key}={_word(value)}" for key, value in _flat(_upgrade_keys(values))]


def _upgrade_keys(values: Mapping[Any, Any]) -> dict[Any, Any]:
    """A preset of an earlier version in today's keys: those that did nothing are left out."""
    groups = {
        key: dict(value) if isinstance(value, dict) else value for key, value in values.items()
    }
    lens, film, aperture = (groups.get(key) or {} for key in ("lens", "film", "aperture"))
    if not all(isinstance(group, dict) for group in (lens, film, aperture)):
        return groups
    if "width" in film:
        width = film.pop("width")
        film["filter_width"] = None if film.get("filter") == "keep" else width
    if aperture.get("radius") == -1:
        aperture["radius"] = None
    if "crop" not in lens and lens.get("model") != "fisheye_polynomial":
        lens.pop("sensor", None)
    return groups


def _flat(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values by their full keys, `lens.fov` for `fov` in `lens`."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _word(value: Any) -> str:
    """A value in Hydra's grammar."""
    if isinstance(value, list):
        return f"[{','.join(map(_word, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return "null" if value is None else repr(value).lower()
