"""Entry point of the program `gaussray`. Help and version import nothing that is slow to load."""

import atexit
import gc
import os
import sys
from collections.abc import Sequence
from importlib.metadata import version

from gaussray.cli.help import COMMANDS, full_help, short_help, usage
from gaussray.runtime.output import emit


def program() -> None:
    """The console script: `main`, as a process of its own.

    The objects of the libraries exist as long as the process. Garbage collection every 700 objects,
    and freeing them at the end, would take a second of processor time. XLA's own log, with blocks
    about its slow compilation, is not shown unless TF_CPP_MIN_LOG_LEVEL is set; its failures are
    exceptions.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    gc.set_threshold(20_000)
    code = 1

    def end() -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

    # What is registered first is called last.
    atexit.register(end)
    try:
        main()
        code = 0
    except KeyboardInterrupt:
        code = 130
        raise
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
        raise


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program.

    An error in arguments or files prints one line and exits with code 2 (`cli.help.EXITS`). With
    the environment variable GAUSSRAY_TRACEBACK set, every error shows its traceback.

    Args:
        arguments: words of the command line without the program's name; None reads sys.argv.

    Raises:
        SystemExit: The command failed; the exit code says how.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    text = _help(words)
    if text is not None:
        emit(f"{text}\n", sys.stdout)
        return
    from gaussray.cli.run import run_and_report

    run_and_report(words)


def _help(words: Sequence[str]) -> str | None:
    """The text that is asked for; None if a command is to be run."""
    if len(words) > 1 and words[0] == "help":
        words = [words[1], "--help"]
    if not words or words[0] in ("-h", "--help", "help"):
        return usage()
    if words[0] in ("--version", "version"):
        return f"gaussray {version('gaussray')}"
    if words[0] in COMMANDS and "--help=all" in words:
        return full_help(words[0], words[1:])
    if words[0] in COMMANDS and ("-h" in words or "--help" in words):
        return short_help(words[0])
    return None


if __name__ == "__main__":
    program()
