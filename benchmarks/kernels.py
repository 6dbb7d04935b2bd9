"""Which kernels of a CUDA device a program waits for."""

import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax


def kernel_seconds(run: Callable[[], Any]) -> dict[str, float]:
    """Seconds of every kernel while a function runs, those that take longest first; none where
    there is no CUDA device.

    Args:
        run: the function, which has run before, so that nothing is compiled.
    """
    seconds: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            jax.block_until_ready(run())
        (path,) = Path(folder).rglob("*.xplane.pb")
        for plane in jax.profiler.ProfileData.from_file(str(path)).planes:
            if "GPU" in plane.name:
                # Other lines repeat what these hold, by module and operation.
                streams = [line for line in plane.lines if line.name.startswith("Stream")]
                for event in (event for line in streams for event in line.events):
                    seconds[event.name] += 1e-9 * event.duration_ns
    return dict(seconds.most_common())
