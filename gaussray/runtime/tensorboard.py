"""Training curves for TensorBoard."""

import atexit
from collections.abc import Callable
from pathlib import Path
from typing import Any


# Keys of metrics.jsonl that are not curves.
_NAMES = ("segment", "stage", "step", "seconds")


def tensorboard(folder: Path) -> Callable[[dict[str, Any]], None]:
    """A function that writes a line of metrics.jsonl as TensorBoard scalars into a folder.

    Each term of the loss, PSNR and the number of Gaussians has one curve per stage and, for a
    segmented clip, per segment.

    Raises:
        ValueError: the package tensorboardX is not installed.
    """
    try:
        from tensorboardX import SummaryWriter  # type: ignore[import-not-found]
    except ImportError as error:
        raise ValueError(
            "tensorboard=true needs the package tensorboardX: pip install -e '.[log]', or "
            "leave tensorboard=false."
        ) from error
    writer = SummaryWriter(str(folder), flush_secs=10)
    # A thread of the writer writes the file; close waits for it.
    atexit.register(writer.close)

    def write(line: dict[str, Any]) -> None:
        part = f"segment_{line['segment']}/" if "segment" in line else ""
        for name, value in line.items():
            if name not in _NAMES:
                writer.add_scalar(f"{part}{line['stage']}/{name}", value, line["step"])

    return write
