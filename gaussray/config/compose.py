"""Composes the configuration of a command from the files of conf/ and the words of a command line.

Hydra composes, OmegaConf holds the result. No module outside `config` and `cli` imports either.
"""

import contextlib
import copy
import functools
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from gaussray.config.messages import (
    CONFIGURATION_ERRORS,
    configuration_error,
    quotes_remedy,
)
from gaussray.config.schema import PATH_KEYS, conf_folder, keys, todays_word
from gaussray.config.suggest import did_you_mean
from gaussray.config.yaml_files import preset_words
from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text
from gaussray.io.sample_data import PARTS, WORD, sample


# What other packages call the type of a configuration.
Configuration = DictConfig

_SWITCHES = ("quiet", "report", "tensorboard")
# The time of day in a text.
_NOW = re.compile(r"\$\{now:[^${}]*\}")


def compose_config(command: str, overrides: Sequence[str]) -> Configuration:
    """Compose and resolve the configuration of a command.

    Args:
        command: a subcommand of gaussray, such as `render`.
        overrides: words of the command line: `key=value` or `group=choice`.

    Returns:
        The configuration, without missing values and interpolations.

    Raises:
        ValueError: A word is no key or choice of the command, a mandatory key is missing, or `out`
            is named by the time although several processes must share it.
    """
    cfg = resolve_config(command, compose_unresolved(command, tuple(overrides)))
    _check_switches(command, cfg)
    out_is_given = any(re.match(r"\+*out=", word) for word in overrides)
    shared = cfg.devices.hosts != 1 or (command == "render" and cfg.dataset.shard != "0/1")
    named_by_time = "out" in keys(command) and "${now" in keys(command)["out"].default
    if shared and named_by_time and not out_is_given:
        raise ValueError(
            "out must be given where several processes share it, e.g. `gaussray "
            f"{command} out=DIR`."
        )
    return cfg


def _check_switches(command: str, cfg: Configuration) -> None:
    """Refuse values other than true and false of switches that are in no group."""
    for name in _SWITCHES:
        if name in keys(command) and not isinstance(cfg[name], bool):
            raise ValueError(f"{name} must be true or false, got {cfg[name]!r}.")


class Variations:
    """Configurations of a command that differ in the values of some keys.

    A key that names a group (`lens`) chooses one of its files and is composed. All other keys are
    set before interpolations (`${shutter.readout}`) are resolved.
    """

    def __init__(self, command: str, overrides: Sequence[str]):
        self.command, self.overrides = command, tuple(overrides)
        self._composed = functools.cache(compose_unresolved)

    def with_values(self, values: Mapping[str, Any]) -> Configuration:
        """The resolved configuration with these values of keys and choices of groups.

        Raises:
            ValueError: a key does not exist, or a value breaks its rule.
        """
        base = self._composed(self.command, self.overrides)
        groups = [key for key in values if OmegaConf.is_dict(_value_at(base, key))]
        choices = (f"{key}={values[key]}" for key in groups)
        cfg = copy.deepcopy(self._composed(self.command, (*self.overrides, *choices)))
        for key in values.keys() - groups:
            try:
                OmegaConf.update(cfg, key, values[key])
            except OmegaConfBaseException as error:
                raise ValueError(
                    f"sample.{key}: {key} is no key of `gaussray {self.command}`."
                    f"{did_you_mean(key, keys(self.command))} Its `--help=all` lists them."
                ) from error
        return resolve_config(self.command, cfg)


@contextlib.contextmanager
def hydra_session(command: str, words: Sequence[str]) -> Iterator[None]:
    """Within the block, Hydra composes from conf/.

    Args:
        command: subcommand of `gaussray`, for messages.
        words: words of its command line, among which a message looks for the wrong one.

    Raises:
        ValueError: Hydra or OmegaConf refuses a word; the message names it.
    """
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(
            version_base="1.3", config_dir=str(conf_folder()), job_name="gaussray"
        ):
            yield
    except CONFIGURATION_ERRORS as error:
        raise configuration_error(command, error, words) from error


def compose_unresolved(command: str, overrides: Sequence[str]) -> Configuration:
    """The configuration as Hydra composes it, with its interpolations.

    Args:
        command: a subcommand of `gaussray`, whose file in conf/ is composed.
        overrides: words of the command line: `key=value` or `group=choice`.
    """
    with hydra_session(command, overrides), as_value_error(command, overrides):
        check_search_path(overrides)
        return compose(command, hydra_words(overrides))


def check_search_path(words: Sequence[str]) -> None:
    """Refuse YAML files of `hydra.searchpath` whose aliases would take Hydra for ever to expand."""
    for word in words:
        name, _, value = word.lstrip("+").partition("=")
        places = re.findall(r"[^\[\],'\"]+", value) if name == "hydra.searchpath" else ()
        folders = (place.strip().removeprefix("file://") for place in places)
        for folder in (Path(x) for x in folders if "://" not in x):
            for path in (x for depth in ("", "*/", "*/*/") for x in folder.glob(f"{depth}*.yaml")):
                check_aliases(path, read_text(path).decode())


@contextlib.contextmanager
def as_value_error(command: str, words: Sequence[str]) -> Iterator[None]:
    """Turn every error of words and files within the block into one ValueError.

    Beside Hydra's own errors these are what YAML and Python raise for malformed texts and for
    numbers with too many digits, and what Hydra raises for a package header without a name.

    Args:
        command: subcommand of `gaussray`, for messages.
        words: words of its command line, among which a message looks for the wrong one.

    Raises:
        ValueError: a word or a file is wrong; the message names the word if it is found.
    """
    try:
        yield
    except (
        *CONFIGURATION_ERRORS,
        YAMLError,
        ValueError,
        OSError,
        RecursionError,
        LookupError,
    ) as error:
        raise configuration_error(command, error, words) from error


def hydra_words(overrides: Sequence[str]) -> list[str]:
    """The words in Hydra's grammar: keys of `sample` are new to the configuration, a preset stands
    for the keys in its file, and other names of a key become its own (`todays_word`)."""
    words: list[str] = []
    for word in overrides:
        word = _quoted(todays_word(word))
        words.append(f"++{word}" if word.startswith("sample.") else word)
        if word.startswith("preset=") and word not in ("preset=", "preset=null"):
            words += map(todays_word, preset_words(word.removeprefix("preset=")))
    return words


def _quoted(word: str) -> str:
    """The word with its value in quotes, if it is a text that Hydra's grammar has no room for, such
    as a folder with an umlaut or brackets in its name."""
    parser = OverridesParser.create()
    try:
        parser.parse_override(word)
        return word
    except HydraException:
        name, equals, value = word.partition("=")
    # Lists and blocks stay: their own error says what is wrong in them.
    if not equals or not value or value[0] in "[{'\"":
        return word
    # Of backslashes, those before a quote, and before the last one, are written twice.
    escaped = re.sub(r"(\\*)'", r"\1\1\\'", value)
    escaped = re.sub(r"(\\+)$", r"\1\1", escaped)
    try:
        parser.parse_override(f"{name}='{escaped}'")
    except HydraException:
        return word
    return f"{name}='{escaped}'"


def resolve_config(command: str, cfg: Configuration) -> Configuration:
    """Resolve the references of a configuration in place, and check its paths.

    Args:
        command: subcommand of `gaussray`, for messages.
        cfg: configuration from `compose_unresolved`.

    Returns:
        The same configuration without references; `sample` as a path is that of the sample data.

    Raises:
        ValueError: A required key is missing, a reference leads nowhere, or a path is a number.
    """
    _refuse_resolvers(OmegaConf.to_container(cfg), "")
    try:
        missing = sorted(OmegaConf.missing_keys(cfg))
        if missing:
            raise ValueError(
                f"{missing[0]} must be given, e.g. `gaussray {command} {missing[0]}=DIR`."
            )
        OmegaConf.resolve(cfg)
    except (OmegaConfBaseException, RecursionError) as error:
        raise configuration_error(command, error) from error
    for key, part in PARTS.items():
        if _value_at(cfg, key) == WORD and not Path(WORD).exists():
            OmegaConf.update(cfg, key, str(sample(part)))
            # A folder of that name would stand for the sample from then on.
            if key == "scene" and cfg.out == f"{WORD}/evaluation":
                cfg.out = f"runs/{cfg.out}"
    _check_paths(command, cfg)
    for key in PATH_KEYS:
        value = _value_at(cfg, key)
        if isinstance(value, str) and value.startswith("~"):
            OmegaConf.update(cfg, key, str(Path(value).expanduser()))
    return cfg


def _check_paths(command: str, cfg: Configuration) -> None:
    """Refuse numbers, and nothing, where the name of a file or folder stands: in keys that must be
    given, and in out."""
    for key in ("out", *(key for key, (default, _) in keys(command).items() if default == "???")):
        value = _value_at(cfg, key)
        if not isinstance(value, str):
            remedy = quotes_remedy(value, f"{key}='NAME'")
            raise ValueError(f"{key} must be the name of a file or folder, got {value!r}.{remedy}")
        if not value:
            raise ValueError(f"{key} must be the name of a file or folder, got an empty text.")


def _refuse_resolvers(node: Any, key: str) -> None:
    """Refuse values that call a resolver, such as `oc.env`.

    A shared file could read the environment with one and leave it in the output. References to
    other keys and the time of day, which names folders, are harmless.
    """
    if isinstance(node, dict | list):
        for name, inner in node.items() if isinstance(node, dict) else enumerate(node):
            _refuse_resolvers(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(node, str) and _calls_resolver(_NOW.sub("", node)):
        raise ValueError(
            f"{key} must be a value, or name another key as ${{key}}, got {node!r}, which calls a "
            "resolver. Write the value instead."
        )


def _calls_resolver(text: str) -> bool:
    """Whether an interpolation in a text has a colon, as those of resolvers have."""
    depth = 0
    for part in re.findall(r"\$\{|[}:]", text):
        if part == ":" and depth:
            return True
        depth += {"${": 1, "}": -1, ":": 0}[part]
        depth = max(depth, 0)
    return False


def _value_at(cfg: Configuration, key: str) -> Any:
    """The value of a key, None if the configuration has none."""
    return OmegaConf.select(cfg, key, throw_on_missing=False)
