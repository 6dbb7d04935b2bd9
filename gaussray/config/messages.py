"""Error messages for words of the command line that the configuration does not accept."""

from collections.abc import Sequence

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from gaussray.config.schema import (
    PATH_KEYS,
    RENAMED,
    choices,
    commands,
    groups,
    keys,
    todays_word,
)
from gaussray.config.suggest import did_you_mean


# What Hydra and OmegaConf raise for wrong words.
CONFIGURATION_ERRORS = (HydraException, OmegaConfBaseException)
# Another key that a user may have meant by an old one.
_SIZE_HINT = {"film.width": "; the size of the pictures is film.size=[width,height]."}
# The remedy for a word without "=", by its last letter.
_WORD_HINTS = {"]": " A list has no spaces, or stands in quotes."}
# Letters of a wrong word that a message shows.
_SHOWN = 200
# Letters of another library's message that are shown.
_SHOWN_OF_ERROR = 300


def configuration_error(command: str, error: Exception, words: Sequence[str] = ()) -> ValueError:
    """The error that the user sees: it names the wrong word if one is found, otherwise it repeats
    the first line of the original error.

    Args:
        command: a subcommand of `gaussray`, whose keys and choices are suggested.
        error: what Hydra, OmegaConf, YAML or Python raised.
        words: words of the command line, among which the wrong one is looked for.
    """
    text = (str(error).splitlines() or [type(error).__name__])[0][:_SHOWN_OF_ERROR]
    if isinstance(error, LookupError) and not isinstance(error, CONFIGURATION_ERRORS):
        text = "a file has a header (# @package NAME) or keys that cannot be understood."
    # The files of a search path may define choices that are not known here.
    only_ours = not any(word.startswith("hydra.searchpath") for word in words)
    problems = filter(None, (_problem_of(command, word) for word in words if only_ours))
    problem = next(problems, f"configuration: {text}")
    return ValueError(f"{problem} `gaussray {command} --help` lists the keys.")


def quotes_remedy(value: object, example: str) -> str:
    """What to do about a number that was meant as a name; empty for other values.

    YAML reads 100_7105 as the number 1007105, so that nothing but quotes keeps such a name. A
    shell takes these away unless the word stands in quotes of the other kind.

    Args:
        value: the value as YAML read it, where a name is wanted.
        example: how to write the word, such as `out='NAME'`.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    return (
        " A name that reads as a number, as 100_7 reads as 1007, needs quotes, and for the shell "
        f'others around them: "{example}".'
    )


def _problem_of(command: str, word: str) -> str:
    """Why a command does not accept a word, with a suggestion; empty if it does."""
    name, equals, value = todays_word(word.lstrip("+~")).partition("=")
    if name.startswith(("hydra", "sample.")) or word.startswith("~"):
        return ""
    candidates = [*keys(command), *groups(command)]
    if not equals:
        choice = [f"{group}={name}" for group in groups(command) if name in choices(group)]
        hint = f" Did you mean {choice[0]}?" if choice else _WORD_HINTS.get(name[-1:], "")
        if name.startswith("-"):
            hint = f" Leave out {'--' if name.startswith('--') else '-'}."
        elif name in candidates:
            hint = f" Write {name}=VALUE without spaces."
        return f"the words after `{command}` must be key=value, got {name[:_SHOWN]!r}.{hint}"
    if name in groups(command):
        options = choices(name)
        if value in options:
            return ""
        short = value[:_SHOWN]
        return (
            f"{name} must be one of {', '.join(options)}, got {short!r}."
            f"{did_you_mean(short, options)}"
        )
    if name in RENAMED and RENAMED[name] in candidates:
        return f"{name} is now called {RENAMED[name]}{_SIZE_HINT.get(name, '.')}"
    if name in candidates and "," in value and not value.startswith(("[", "{", '"', "'")):
        short = value[:_SHOWN]
        if name in PATH_KEYS:
            return (
                f"{name}: a path with a comma needs quotes inside those of the shell. Write "
                f"\"{name}='{short}'\"."
            )
        return f"{name} must be one value or a list, got {short!r}. Write '{name}=[{short}]'."
    if name in candidates or any(key.startswith(f"{name}.") for key in candidates):
        return ""
    name = name[:_SHOWN]
    others = [f"`{other}`" for other in commands() if name in {**keys(other), **groups(other)}]
    hint = f" It is one of {', '.join(others)}." if others else did_you_mean(name, candidates)
    return f"{name} is no key of `gaussray {command}`.{hint}"
