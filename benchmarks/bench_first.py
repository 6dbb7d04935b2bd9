"""The first picture of a process: import, then programs that are compiled, or kept from before.

python -m benchmarks.bench_first [--gaussians 24000 24000 24300 40000] [--side 128]

Every number of Gaussians is a process of its own; they share one folder of kept programs, empty at
the first. A number that came before, or one that is rounded up to the same (`scene.spare_rows`),
loads what another compiled. The same generated room, one ray a pixel, and a renderer that repeats
a picture until no list drops anything; `bench_render` measures its error.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import Any

from benchmarks.record import RESULTS, show


_COLUMNS = ("gaussians", "rows", "import_s", "first_s", "second_s", "device")


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    counts = [24_000, 24_000, 24_300, 40_000]
    parser.add_argument("--gaussians", type=int, nargs="+", default=counts)
    parser.add_argument("--side", type=int, default=128)
    parser.add_argument("--one", action="store_true", help="in this process, as a line of JSON")
    chosen = parser.parse_args(argv)
    if chosen.one:
        print(json.dumps(first_picture(chosen.gaussians[0], chosen.side)))
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        settings = os.environ | {"JAX_COMPILATION_CACHE_DIR": folder}
        for count in chosen.gaussians:
            words = ["--one", "--gaussians", str(count), "--side", str(chosen.side)]
            command = [sys.executable, "-m", "benchmarks.bench_first", *words]
            done = subprocess.run(command, env=settings, check=True, stdout=subprocess.PIPE)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
            RESULTS.mkdir(parents=True, exist_ok=True)
            with (RESULTS / "first.jsonl").open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    show(rows, *_COLUMNS)


def first_picture(count: int, side: int) -> dict[str, Any]:
    """Seconds of the import, of the first picture of a room, and of the second.

    Args:
        count: number of Gaussians, a tenth of which move.
        side: side of the picture in pixels.
    """
    began = time.perf_counter()
    from benchmarks.problem import cameras, dynamic_room
    from benchmarks.record import machine
    from gaussray.render.options import RenderOptions
    from gaussray.render.renderer import Renderer
    from gaussray.runtime.devices import DevicesOptions, start_devices
    from gaussray.scene.spare_rows import with_spare_rows

    start_devices(DevicesOptions())
    seconds = [time.perf_counter() - began]
    scene, camera = dynamic_room(count), cameras(side)["pinhole"]
    began = time.perf_counter()
    renderer = Renderer(scene, options=RenderOptions(samples=1))
    for _ in range(2):
        renderer(camera)
        seconds.append(time.perf_counter() - began)
        began = time.perf_counter()
    names = ("import_s", "first_s", "second_s")
    figures = dict(zip(names, (round(x, 3) for x in seconds), strict=True))
    rows = with_spare_rows(scene).count
    line = {"bench": "first", "gaussians": count, "rows": rows, "side": side}
    return line | figures | machine()


if __name__ == "__main__":
    main()
