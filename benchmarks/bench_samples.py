"""Samples of a randomised dataset: how many an hour, and whether memory stays flat.

python -m benchmarks.bench_samples --out DIR [--samples 2000] [--words KEY=VALUE ...]

Renders frames of 128 x 128 of the sample scene with cameras of all lens models (`sample=cameras`
with every file of conf/lens that needs no other). Prints a line every minute: samples, memory
mappings and memory of the process. At the end the median time of the later half of the samples,
and of the part of it that is not spent in the renderer.
"""

import argparse
import json
import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.record import record
from gaussray.cli.main import main as gaussray
from gaussray.config.schema import conf_folder
from gaussray.render.randomize import generate
from gaussray.render.renderer import Renderer


# Files of conf/lens that need a capture or a table.
_NOT_ALONE = ("keep", "table")


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="an empty folder")
    parser.add_argument("--samples", type=int, default=2000)
    parser.add_argument("--words", nargs="*", default=[], help="further words of the command")
    chosen = parser.parse_args()
    lenses = sorted({path.stem for path in (conf_folder() / "lens").glob("*.yaml")} - {*_NOT_ALONE})
    watch = Watch()
    watch.start()
    gaussray(
        [
            *("render", "scene=sample", "sample=cameras", f"dataset.count={chosen.samples}"),
            *(f"out={chosen.out}", "report=false", f"sample.lens.choice=[{','.join(lenses)}]"),
            *chosen.words,
        ]
    )
    watch.end()
    later = watch.samples[len(watch.samples) // 2 :]
    seconds, overhead = (statistics.median(x) for x in zip(*later, strict=True))
    values = {
        "dataset_samples": len(watch.samples),
        "lenses": len(lenses),
        "seconds": round(seconds, 3),
    }
    mean = sum(seconds for seconds, _ in later) / len(later)
    values |= {"overhead": round(overhead, 3), "samples_per_hour": round(3600 / mean)}
    print(json.dumps(record("samples", **values, **watch.memory())))


class Watch(threading.Thread):
    """Times every sample, and looks at the memory of this process every minute."""

    def __init__(self, interval: float = 60.0):
        super().__init__(daemon=True)
        self.samples: list[tuple[float, float]] = []
        self.states: list[dict[str, Any]] = []
        self._interval, self._ended, self._rendering = interval, threading.Event(), 0.0
        self._developed, self._render = Renderer.render_developed, generate._render

    def start(self) -> None:
        watch = self

        def developed(renderer: Renderer, cameras: Any, develop: Any) -> Iterator[Any]:
            frames = watch._developed(renderer, cameras, develop)
            while True:
                began = time.monotonic()
                frame = next(frames, None)
                watch._rendering += time.monotonic() - began
                if frame is None:
                    return
                yield frame

        before = [time.monotonic()]

        def render(*parts: Any) -> bool:
            watch._rendering = 0.0
            rendered = watch._render(*parts)
            now = time.monotonic()
            taken, before[0] = now - before[0], now
            watch.samples.append((taken, taken - watch._rendering))
            return rendered

        Renderer.render_developed, generate._render = developed, render
        super().start()

    def run(self) -> None:
        while not self._ended.wait(self._interval):
            self._look()

    def end(self) -> None:
        """Stop looking."""
        self._ended.set()
        self._look()
        Renderer.render_developed, generate._render = self._developed, self._render

    def memory(self) -> dict[str, Any]:
        """Mappings and megabytes, in the middle of the samples and at the end."""
        half = next(s for s in self.states if s["samples"] >= len(self.samples) // 2)
        return {f"{k}_{n}": s[k] for n, s in (("half", half), ("end", self.states[-1]))
                for k in ("mappings", "megabytes")}  # fmt: skip

    def _look(self) -> None:
        mappings = Path("/proc/self/maps").read_bytes().count(b"\n")
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        state = {"samples": len(self.samples), "mappings": mappings}
        self.states.append(state | {"megabytes": round(pages * 4096 / 1e6)})
        print(self.states[-1], flush=True)


if __name__ == "__main__":
    main()
