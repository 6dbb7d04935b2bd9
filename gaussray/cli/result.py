"""What a command tells at its end: its result, and the page about its output folder."""

import warnings
from pathlib import Path
from typing import Any

from gaussray.runtime.devices import is_primary
from gaussray.runtime.progress import say


def say_result(text: str, **facts: Any) -> None:
    """Print the result of a command, once for all processes.

    Args:
        text: the message.
        facts: further values, which the style json prints.
    """
    if is_primary():
        say(text, "result", **facts)


def write_report(command: str, out: Path, shown: dict[str, Any]) -> None:
    """Write report.html into the output folder. A failure is a warning, because the results are
    complete without it.

    Args:
        command: a command, or `dataset` (`report.write.TITLES`).
        out: the output folder.
        shown: the scene and the capture that the page draws, under these names, where it does.
    """
    from gaussray.report import write_page

    try:
        write_page(command, out, scene=shown.get("scene"), capture=shown.get("capture"))
    except Exception as error:
        warnings.warn(
            f"{out / 'report.html'}: the report could not be written ({type(error).__name__}: "
            f"{error}). All results are there.",
            stacklevel=2,
        )
