"""Hydra in, typed options out: the only module that knows Hydra."""

import contextlib
import copy
import functools
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import equinox as eqx
from hydra import compose, initialize_config_dir
from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.errors import HydraException
from hydra.types import HydraContext
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from gaussray.config.schema import choices, conf_folder, groups, keys
from gaussray.config.suggest import meant
from gaussray.io.atomic import whole
from gaussray.io.safe.aliases import check_aliases
from gaussray.io.safe.files import read_text
from gaussray.io.sample_data import PARTS, WORD, sample
from gaussray.runtime.devices import leads
from gaussray.runtime.lock import lock_output
from gaussray.runtime.provenance import note_begin


T = TypeVar("T", bound=eqx.Module)

_HYDRAS = (HydraException, OmegaConfBaseException)
# Letters of a wrong word that are shown.
_SHOWN = 200
# The time of day in a text.
_NOW = re.compile(r"\$\{now:[^${}]*\}")

# What is said to Hydra of jobs, unless the user says otherwise. It writes nothing of its own;
# a cluster's files are in the folder of the output.
LAUNCH = {
    "hydra.sweep.dir": "${out}/jobs",
    "hydra.sweep.subdir": ".",
    "hydra.output_subdir": "null",
    "hydra/hydra_logging": "none",
    "hydra/job_logging": "none",
}


def configuration(verb: str, overrides: Sequence[str]) -> DictConfig:
    """The resolved configuration of a verb. Its folder of output is named by the time where none is
    given, and is not where processes must name the same one."""
    cfg = _resolved(verb, _composed(verb, tuple(overrides)))
    given = any(re.match(r"\+*out=", word) for word in overrides)
    shared = cfg.devices.hosts != 1 or (verb == "render" and cfg.factory.shard != "0/1")
    by_time = "out" in keys(verb) and "${now" in keys(verb)["out"].default
    if shared and by_time and not given:
        raise ValueError(
            f"out must be given where several processes share it, e.g. `gaussray {verb} out=DIR`."
        )
    return cfg


class Variations:
    """Configurations of a verb that differ in the values of some keys.

    A key that names a group (`lens`) chooses one of its files, and is composed; all others are
    set, before interpolations (`${shutter.readout}`) are resolved.
    """

    def __init__(self, verb: str, overrides: Sequence[str]):
        self.verb, self.overrides = verb, tuple(overrides)
        self._composed = functools.cache(_composed)

    def with_values(self, values: Mapping[str, Any]) -> DictConfig:
        """The resolved configuration with these values."""
        plain = self._composed(self.verb, self.overrides)
        groups = [key for key in values if OmegaConf.is_dict(_told(plain, key))]
        chosen = (f"{key}={values[key]}" for key in groups)
        cfg = copy.deepcopy(self._composed(self.verb, (*self.overrides, *chosen)))
        for key in values.keys() - groups:
            try:
                OmegaConf.update(cfg, key, values[key])
            except OmegaConfBaseException as error:
                raise ValueError(
                    f"sample.{key}: {key} is no key of `gaussray {self.verb}`."
                    f"{meant(key, keys(self.verb))} Its `--help=all` lists them."
                ) from error
        return _resolved(self.verb, cfg)


def leaf(group: str, choice: str) -> dict[str, Any]:
    """What one file of a group says."""
    told: Any = OmegaConf.to_container(OmegaConf.load(conf_folder() / group / f"{choice}.yaml"))
    return told


def launched(
    verb: str, overrides: Sequence[str], jobs: Sequence[Sequence[str]], task: Callable[..., Any]
) -> list[Any]:
    """What `task(cfg)` returns for each job, a list of words beside those of the command.

    Hydra's launcher runs them, as `hydra/launcher=` says: one after another (basic, its default),
    or by a plugin on the cores of a host (joblib) or on a cluster (submitit_local, submitit_slurm).
    """
    given = {word.split("=")[0] for word in overrides}
    defaults = [f"{key}={value}" for key, value in LAUNCH.items() if key not in given]
    with _hydra(verb, overrides):
        words = [*_spelled(overrides), *defaults]
        cfg = compose(verb, words, return_hydra_config=True)
        context = HydraContext(GlobalHydra.instance().config_loader(), Callbacks())
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=context, task_function=task, config=cfg
        )
        own = list(cfg.hydra.overrides.task)
        done = launcher.launch([[*own, *job] for job in jobs], initial_job_idx=0)
    return [job.return_value for job in done]


def options(kind: type[T], node: DictConfig) -> T:
    """One YAML leaf becomes one options object; an unknown key is an error. `null` is for keys
    that are `X | None`."""
    values: dict[str, Any] = OmegaConf.to_container(node, resolve=True)  # type: ignore[assignment]
    known = kind.__dataclass_fields__  # type: ignore[attr-defined]
    group = node._key() or kind.__name__
    for name, value in values.items():
        if name not in known:
            raise ValueError(
                f"{group}.{name} is unknown; known are {', '.join(known)}.{meant(name, known)}"
            )
        default, kinds = known[name].default, get_args(known[name].type)
        if isinstance(value, list) and float in kinds:
            for wrong in (x for x in value if type(x) not in (int, float)):
                raise ValueError(f"{group}.{name} must be a list of numbers, got {wrong!r} in it.")
            value = [float(x) if type(x) is int else x for x in value]
        if default is None and value is not None:
            values[name] = as_kind(kinds[0], value, f"{group}.{name}")
        else:
            values[name] = as_kind(type(default), value, f"{group}.{name}")
    return kind(**values)


def as_kind(kind: type, value: Any, key: str) -> Any:
    """A YAML value as the kind of its default; whole numbers do for fractions."""
    if kind is tuple and isinstance(value, list):
        return tuple(value)
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is kind:
        return value
    names = {int: "a whole number", float: "a number", bool: "true or false", tuple: "a list"}
    raise ValueError(f"{key} must be {names.get(kind, 'a text')}, got {value!r}.")


def run_folder(cfg: DictConfig, without: Sequence[str] = (), part: str = "") -> Path:
    """Make and lock the output folder (`lock_output`, its `part`) and write config.yaml into it.

    The keys `without` are left out of the configuration; if there are none of these, run.json
    (`provenance`) is written too."""
    out, told = Path(cfg.out), copy.deepcopy(cfg)
    lock_output(out, part)
    OmegaConf.set_struct(told, False)
    for key in without:
        parent, _, name = key.rpartition(".")
        (OmegaConf.select(told, parent) if parent else told).pop(name)
    try:
        out.mkdir(parents=True, exist_ok=True)
        if leads():
            with whole(out / "config.yaml") as partial:
                partial.write_text(OmegaConf.to_yaml(told))
            # What several processes write is the same of all: it says nothing of when, and by whom.
            if not without:
                note_begin(out)
    except OSError as error:
        raise OSError(f"out={out}: cannot be written: {error.strerror or error}") from error
    return out


@contextlib.contextmanager
def _hydra(verb: str, words: Sequence[str]) -> Iterator[None]:
    """Hydra at work in the configuration's folder; its errors are the user's."""
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(
            version_base="1.3", config_dir=str(conf_folder()), job_name="gaussray"
        ):
            yield
    except _HYDRAS as error:
        raise _wrong(verb, error, words) from error


def _composed(verb: str, overrides: Sequence[str]) -> DictConfig:
    with _hydra(verb, overrides), _in_words(verb, overrides):
        _check_searched(overrides)
        return compose(verb, _spelled(overrides))


def _check_searched(words: Sequence[str]) -> None:
    """Refuse files of other folders that Hydra would take for ever to read."""
    for word in words:
        name, _, value = word.lstrip("+").partition("=")
        places = re.findall(r"[^\[\],'\"]+", value) if name == "hydra.searchpath" else ()
        folders = (place.strip().removeprefix("file://") for place in places)
        for folder in (Path(x) for x in folders if "://" not in x):
            for path in (x for depth in ("", "*/", "*/*/") for x in folder.glob(f"{depth}*.yaml")):
                check_aliases(path, read_text(path).decode())


@contextlib.contextmanager
def _in_words(verb: str, words: Sequence[str]) -> Iterator[None]:
    """One message of whatever is wrong with words and files: also what YAML and Python say of texts
    that are none, and of numbers too long to be any, and Hydra of a package without a name."""
    try:
        yield
    except (*_HYDRAS, YAMLError, ValueError, OSError, RecursionError, LookupError) as error:
        raise _wrong(verb, error, words) from error


def _spelled(overrides: Sequence[str]) -> list[str]:
    """The words as Hydra wants them: keys of `sample` are new to the configuration, and a preset
    stands for the keys in its file."""
    words: list[str] = []
    for word in overrides:
        words.append(f"++{word}" if word.startswith("sample.") else word)
        if word.startswith("preset=") and word not in ("preset=", "preset=null"):
            words += preset_words(word.removeprefix("preset="))
    return words


def preset_words(path: Path | str) -> list[str]:
    """The keys of a YAML file as words of a command line."""
    try:
        text = read_text(path).decode()
        check_aliases(path, text)
        told = OmegaConf.to_container(OmegaConf.create(text))
    except OSError as error:
        raise OSError(f"preset={path}: cannot be read: {error}") from error
    except (YAMLError, OmegaConfBaseException, ValueError, RecursionError) as error:
        raise ValueError(f"preset={path}: is no YAML file of keys: {error}") from error
    # What OmegaConf makes of a YAML that is one number.
    except AssertionError:
        raise ValueError(f"preset={path}: must hold keys and values, got one value.") from None
    if not isinstance(told, dict):
        raise ValueError(f"preset={path}: must hold keys and values, got a list.")
    return [f"{key}={_word(value)}" for key, value in _flat(told)]


def _flat(told: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in told.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _word(value: Any) -> str:
    """A value as Hydra's grammar wants it."""
    if isinstance(value, list):
        return f"[{','.join(map(_word, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return "null" if value is None else repr(value).lower()


def _resolved(verb: str, cfg: DictConfig) -> DictConfig:
    _demand_values(OmegaConf.to_container(cfg), "")
    try:
        missing = sorted(OmegaConf.missing_keys(cfg))
        if missing:
            raise ValueError(
                f"{missing[0]} must be given, e.g. `gaussray {verb} {missing[0]}=DIR`."
            )
        OmegaConf.resolve(cfg)
    except (OmegaConfBaseException, RecursionError) as error:
        raise _wrong(verb, error) from error
    for key, part in PARTS.items():
        if _told(cfg, key) == WORD and not Path(WORD).exists():
            OmegaConf.update(cfg, key, str(sample(part)))
    return cfg


def _demand_values(node: Any, key: str) -> None:
    """Refuse what would call a program (a resolver, such as oc.env: a shared file could read the
    environment by it, and leave it in what is written) rather than name another key. The time of
    day tells nothing, and names folders."""
    if isinstance(node, dict | list):
        for name, inner in node.items() if isinstance(node, dict) else enumerate(node):
            _demand_values(inner, f"{key}.{name}" if key else str(name))
    elif isinstance(node, str) and _calls(_NOW.sub("", node)):
        raise ValueError(
            f"{key} must be a value, or name another key as ${{key}}, got {node!r}, which calls a "
            "resolver. Write the value instead."
        )


def _calls(text: str) -> bool:
    """Whether an interpolation in a text has a colon, as those of resolvers have."""
    depth = 0
    for part in re.findall(r"\$\{|[}:]", text):
        if part == ":" and depth:
            return True
        depth += {"${": 1, "}": -1, ":": 0}[part]
        depth = max(depth, 0)
    return False


def _wrong(verb: str, error: Exception, words: Sequence[str] = ()) -> ValueError:
    """What the user is told of an error of Hydra's: which word is wrong, if that is found."""
    told = (str(error).splitlines() or [type(error).__name__])[0][:300]
    if isinstance(error, LookupError) and not isinstance(error, _HYDRAS):
        told = "a file has a header (# @package NAME) or keys that cannot be understood."
    # Files of others may hold choices that are not known here.
    ours = not any(word.startswith("hydra.searchpath") for word in words)
    reasons = filter(None, (_misspelt(verb, word) for word in words if ours))
    reason = next(reasons, f"configuration: {told}")
    return ValueError(f"{reason} `gaussray {verb} --help` lists the keys.")


def _misspelt(verb: str, word: str) -> str:
    """Why a word is none of a verb's, with what was probably meant; nothing if it is."""
    name, equals, value = word.lstrip("+~").partition("=")
    if name.startswith(("hydra", "sample.")) or word.startswith("~"):
        return ""
    if not equals:
        chosen = [f"{group}={name}" for group in groups(verb) if name in choices(group)]
        hint = f" Did you mean {chosen[0]}?" if chosen else ""
        return f"the words after the verb must be key=value, got {name[:_SHOWN]!r}.{hint}"
    if name in groups(verb):
        if value in choices(name):
            return ""
        known = choices(name)
        got = value[:_SHOWN]
        return f"{name} must be one of {', '.join(known)}, got {got!r}.{meant(got, known)}"
    known = [*keys(verb), *groups(verb)]
    if name in known or any(key.startswith(f"{name}.") for key in known):
        return ""
    name = name[:_SHOWN]
    return f"{name} is no key of `gaussray {verb}`.{meant(name, known)}"


def _told(cfg: DictConfig, key: str) -> Any:
    """What the configuration has under a key, if anything."""
    return OmegaConf.select(cfg, key, throw_on_missing=False)
