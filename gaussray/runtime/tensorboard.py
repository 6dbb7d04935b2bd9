"""Figures of a fit for TensorBoard."""

import atexit
from collections.abc import Callable
from pathlib import Path
from typing import Any


# Of a line of figures, what names it.
_NAMES = ("segment", "stage", "step", "seconds")


def tensorboard(folder: Path) -> Callable[[dict[str, Any]], None]:
    """What writes lines of figures (`fit.journal`) as scalars into a folder: the terms of the loss,
    PSNR and the number of Gaussians, by stage and, of a clip, by segment. ValueError if the package
    is not here."""
    try:
        from tensorboardX import SummaryWriter  # type: ignore[import-not-found]
    except ImportError as error:
        raise ValueError(
            "tensorboard=true needs the package tensorboardX: pip install 'gaussray[log]', or "
            "leave tensorboard=false."
        ) from error
    writer = SummaryWriter(str(folder), flush_secs=10)
    # A thread writes; it is waited for.
    atexit.register(writer.close)

    def told(line: dict[str, Any]) -> None:
        part = f"segment_{line['segment']}/" if "segment" in line else ""
        for name, value in line.items():
            if name not in _NAMES:
                writer.add_scalar(f"{part}{line['stage']}/{name}", value, line["step"])

    return told
