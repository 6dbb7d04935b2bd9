"""One command, `gaussray <verb> [overrides]`: how it is called, and how its errors are told."""

import os
import sys
import time
import traceback
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gaussray.cli.commands import RUN, view
from gaussray.cli.completion import script
from gaussray.cli.help import VERBS, full_help, short_help, usage
from gaussray.config.compose import compose_config
from gaussray.config.options import build_options
from gaussray.config.suggest import did_you_mean
from gaussray.io.safe.limits import Limits, limit
from gaussray.runtime import provenance
from gaussray.runtime.devices import DevicesOptions, begin, leads, leave, together
from gaussray.runtime.lock import release_locks
from gaussray.runtime.progress import (
    STYLES,
    check_style,
    end_line,
    plain_warnings,
    say,
    style,
    told_as,
)
from gaussray.runtime.provenance import asked_by
from gaussray.runtime.resource_errors import is_full, is_memory, memory_message


# How an interrupted verb is gone on with.
AGAIN = {
    "reconstruct": "The same command with resume=auto",
    "render": "The same command",
    "demo": "The same command",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point. Errors of the user end in one line and exit code 2 (`usage.EXITS`)."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    with told_as(_style(words)), asked_by(words), plain_warnings():
        _guarded(words)


def _guarded(words: list[str]) -> None:
    try:
        _main(words)
    except KeyboardInterrupt:
        if words[0] == "view":
            return
        _fail(f"interrupted. {_again(words[0])}", 130)
    except (ValueError, OSError, RuntimeError, MemoryError) as error:
        if is_memory(error) and not os.environ.get("GAUSSRAY_TRACEBACK"):
            _fail(memory_message(words[0], error, _again(words[0])))
        unknown = isinstance(error, RuntimeError) and type(error).__name__ != "NonFiniteLoss"
        if unknown or os.environ.get("GAUSSRAY_TRACEBACK"):
            _raise(error)
        told = str(error)
        if is_full(error):
            told = f"{told.rstrip('. ')}. The disk is full: make room. {_again(words[0])}"
        _fail(told)
    except Exception as error:
        _raise(error)
    finally:
        release_locks()


def _again(verb: str) -> str:
    """How a verb that was stopped is gone on with."""
    return f"{AGAIN[verb]} goes on where it stopped." if verb in AGAIN else ""


def _main(words: list[str]) -> None:
    if not words or words[0] in ("-h", "--help"):
        print(usage())
    elif words[0] == "--version":
        print(f"gaussray {version('gaussray')}")
    elif words[0] in ("--completion", "-sc"):
        # Hydra's own way to ask for it is -sc install=bash.
        print(script(words[1].removeprefix("install=") if len(words) > 1 else "bash"), end="")
    elif words[0] not in VERBS:
        known, hint = ", ".join(VERBS), did_you_mean(words[0], VERBS)
        raise ValueError(
            f"the command must be one of {known}, got {words[0]!r}.{hint} See `gaussray --help`."
        )
    elif "--help=all" in words:
        print(full_help(words[0]))
    elif "-h" in words or "--help" in words:
        print(short_help(words[0]))
    else:
        _run(words[0], words[1:])


def _run(verb: str, overrides: Sequence[str]) -> None:
    began = time.monotonic()
    cfg = compose_config(verb, overrides)
    check_style(str(cfg.get("progress", "auto")))
    limit(build_options(Limits, cfg.limits))
    if verb == "render" and cfg.factory.count:
        from gaussray.config.jobs import generate_dataset
        from gaussray.dataset.takes import MANIFEST

        told = generate_dataset(cfg, overrides)
        if cfg.report and (Path(str(cfg.out)) / MANIFEST).is_file():
            _page("takes", Path(str(cfg.out)), {})
        say(told, "result", verb=verb, out=cfg.out)
        return
    if verb == "view":
        view(cfg, overrides)
        return
    had = RUN[verb](cfg, begin(build_options(DevicesOptions, cfg.devices))) or {}
    out = Path(str(cfg.out))
    if leads() and (out / provenance.FILE).is_file():
        provenance.note_end(out, time.monotonic() - began)
        if cfg.get("report"):
            _page(verb, out, had)


def _style(words: Sequence[str]) -> str:
    """How the work is to be told of, also if another word is wrong."""
    told = [word.split("=", 1)[1] for word in words if word.startswith("progress=")]
    told = [name for name in told if name in STYLES]
    return (told or ["quiet" if "quiet=true" in words else "auto"])[-1]


def _page(verb: str, out: Path, had: dict[str, Any]) -> None:
    """The page to look at; if it cannot be made, the work is none the less done."""
    from gaussray.report import write_page

    try:
        write_page(verb, out, **had)
    except Exception as error:
        warnings.warn(
            f"{out / 'report.html'}: the page could not be made ({type(error).__name__}: {error}). "
            "Everything else is there.",
            stacklevel=2,
        )


def _fail(message: str, code: int = 2) -> None:
    message = " ".join(message.split())
    end_line()
    print(f"gaussray: {message}", file=sys.stderr)
    if style() == "json":
        say(message, "error", code=code)
    leave(code)


def _raise(error: Exception) -> None:
    """An error that is not the user's."""
    end_line()
    if not together():
        raise error
    traceback.print_exception(error)
    leave(1)


if __name__ == "__main__":
    main()
