"""Runs a command: parses its words, runs it, reports its errors."""

import contextlib
import os
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

from gaussray.cli.commands import RUN, generate, view
from gaussray.cli.completion import script
from gaussray.cli.help import COMMANDS
from gaussray.cli.result import write_report
from gaussray.config.compose import compose_config
from gaussray.config.options import build_options
from gaussray.config.suggest import did_you_mean
from gaussray.io.safe.limits import Limits, limit
from gaussray.runtime.devices import (
    DevicesOptions,
    exit_process,
    is_distributed,
    is_primary,
    start_devices,
)
from gaussray.runtime.errors import FitError
from gaussray.runtime.lock import release_locks
from gaussray.runtime.output import emit
from gaussray.runtime.progress import (
    STYLES,
    Progress,
    check_style,
    end_line,
    plain_warnings,
    progress_style,
    say,
    style,
)
from gaussray.runtime.provenance import RUN_RECORD, command_arguments, record_duration
from gaussray.runtime.resource_errors import is_full, is_memory, memory_message


# How to resume each command after an interruption; others start anew.
RESUME = {
    "reconstruct": "The same command with resume=auto",
    "render": "The same command",
    "demo": "The same command",
}
# Commands that keep large temporary files in the output folder: SIGTERM ends them as an interrupt
# does, so that these are removed.
_CLEANS_UP_ON_SIGTERM = ("prepare",)


def run_and_report(words: list[str]) -> None:
    """Run the command of a command line; errors become messages and exit codes (`cli.help.EXITS`).

    Raises:
        SystemExit: The command failed.
    """
    with progress_style(_style(words)), command_arguments(words), plain_warnings():
        _run_and_report(words)


def _run_and_report(words: list[str]) -> None:
    """Run the command; turn errors into messages and exit codes."""
    try:
        with _terminated_as_interrupted(words[0]):
            _dispatch(words)
    except KeyboardInterrupt:
        if words[0] == "view":
            return
        hint = _resume_hint(words[0]) or "The same command starts anew."
        _fail(f"interrupted. {hint}", 130)
    except (ValueError, OSError, RuntimeError, MemoryError) as error:
        if is_memory(error) and not os.environ.get("GAUSSRAY_TRACEBACK"):
            _fail(memory_message(words[0], error, _resume_hint(words[0])))
        unknown = isinstance(error, RuntimeError) and not isinstance(error, FitError)
        if unknown or os.environ.get("GAUSSRAY_TRACEBACK"):
            _raise_bug(error)
        message = str(error)
        if is_full(error):
            message = (
                f"{message.rstrip('. ')}. The disk is full: make room. {_resume_hint(words[0])}"
            )
        _fail(message)
    except Exception as error:
        _raise_bug(error)
    finally:
        release_locks()


def _resume_hint(command: str) -> str:
    """The sentence after an interruption that says how to resume the command; empty if it cannot be
    resumed."""
    return f"{RESUME[command]} continues where it stopped." if command in RESUME else ""


@contextlib.contextmanager
def _terminated_as_interrupted(command: str) -> Iterator[None]:
    """Within the block SIGTERM interrupts a command of `_CLEANS_UP_ON_SIGTERM`, as Ctrl-C does. A
    second one does nothing, so that what the command removes is removed completely."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = None
    if command in _CLEANS_UP_ON_SIGTERM:
        # Only the main thread may change that.
        with contextlib.suppress(ValueError):
            before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)


def _dispatch(words: list[str]) -> None:
    """Print the script for completion, or run the command."""
    if words[0] in ("--completion", "-sc"):
        # Hydra's spelling is -sc install=bash.
        shell = words[1].removeprefix("install=") if len(words) > 1 else "bash"
        emit(script(shell), sys.stdout)
    elif words[0] == "--help=all":
        raise ValueError(
            "--help=all lists the keys of one command: write `gaussray COMMAND --help=all`, such "
            "as `gaussray render --help=all`."
        )
    elif words[0] not in COMMANDS:
        names, hint = ", ".join(COMMANDS), did_you_mean(words[0], COMMANDS)
        raise ValueError(
            f"the command must be one of {names}, got {words[0]!r}.{hint} See `gaussray --help`."
        )
    else:
        _check_help(words)
        _run(words[0], words[1:])


def _check_help(words: Sequence[str]) -> None:
    """Refuse a kind of help that does not exist."""
    for word in words:
        if word.startswith("--help="):
            raise ValueError(
                f"{word}: the help of a command is `gaussray {words[0]} --help` or `gaussray "
                f"{words[0]} --help=all`."
            )


def _run(command: str, overrides: Sequence[str]) -> None:
    """Run a command with these words, and write its report."""
    began = time.monotonic()
    cfg = compose_config(command, overrides)
    check_style(str(cfg.get("progress", "auto")))
    limit(build_options(Limits, cfg.limits))
    if command == "render" and cfg.dataset.count:
        generate(cfg, overrides)
        return
    if command == "view":
        view(cfg, overrides)
        return
    report = RUN[command](cfg, start_devices(build_options(DevicesOptions, cfg.devices))) or {}
    out = Path(str(cfg.out))
    if is_primary() and (out / RUN_RECORD).is_file():
        record_duration(out, time.monotonic() - began)
        if cfg.get("report"):
            # Of JSON lines the result is the last.
            quiet = bool(cfg.get("quiet")) or style() == "json"
            bar = Progress("report", 1, quiet=quiet)
            bar.report(0, "being written")
            write_report(command, out, report)
            bar.report(1)


def _style(words: Sequence[str]) -> str:
    """The style of progress in the words; the default if its value is wrong, which is reported
    later."""
    styles = [word.split("=", 1)[1] for word in words if word.startswith("progress=")]
    styles = [name for name in styles if name in STYLES]
    return (styles or ["quiet" if "quiet=true" in words else "auto"])[-1]


def _fail(message: str, code: int = 2) -> None:
    """Print an error as one line and exit."""
    message = " ".join(message.split())
    end_line()
    emit(f"gaussray: {message}\n", sys.stderr)
    if style() == "json":
        say(message, "error", code=code)
    exit_process(code)


def _raise_bug(error: Exception) -> None:
    """Raise an unexpected error with its traceback. With several processes, this one exits at once,
    so that the others do not wait for it."""
    end_line()
    if not is_distributed():
        raise error
    traceback.print_exception(error)
    exit_process(1)
