"""What a fit does with all training pictures before its first step, seconds by part.

python -m benchmarks.bench_pictures [--side 1170] [--cameras 18] [--times 24]
python -m benchmarks.bench_pictures --capture DIR

read: pictures are decoded and cut into tiles
motion: temporal medians of each camera, and the pixels of each tile that differ from them
medians: whole pictures of what stands still, for stereo
points: for which share of the time places in the scene show something else than at first

Without --capture, cameras around the generated room show plain patches, over which a square goes.
Files go to the folder for temporary files (TMPDIR). A part that compiles programs does so in the
first of two rounds; the second counts.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks.record import begin, record, show
from benchmarks.room_capture import around
from gaussray.capture.capture import View
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.reconstruct.data.motion_mask import activity, point_activity
from gaussray.reconstruct.data.pictures import Footage, footage
from gaussray.reconstruct.data.still_cameras import camera_frames, find_medians


# Tiles as fits on a GPU have them, and places that are looked at.
_SIDE, _BUNDLE, _PLACES = 32, 8, 200_000
# Patches along the side of a picture, and the share of it that the square's side is.
_PATCHES, _SQUARE = 30, 0.2


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--side", type=int, default=1170)
    parser.add_argument("--cameras", type=int, default=18)
    parser.add_argument("--times", type=int, default=24)
    parser.add_argument("--capture", help="another capture than that of patches")
    chosen = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(chosen.capture or Path(folder) / "capture")
        if not chosen.capture:
            write_patches(path, chosen.side, chosen.cameras, chosen.times)
        views = [view for view in open_capture(path).views if view.split != "test"]
        rows = _rows(views, Path(folder))
    show(rows, "part", "pictures", "megapixels", "seconds", "gigabytes_per_s")


def write_patches(folder: Path, side: int, count: int, times: int) -> None:
    """A capture of patches by cameras around the room, over each of which a square goes."""
    dice, listed = np.random.default_rng(0), []
    place = np.arange(side) * _PATCHES // side
    size = max(round(_SQUARE * side), 1)
    for number, camera in enumerate(around(side, count)):
        still = dice.integers(0, 256, (_PATCHES, _PATCHES, 3), np.uint8)[place[:, None], place]
        for instant in range(times):
            left = instant * (side - size) // max(times - 1, 1)
            picture = still.copy()
            picture[left : left + size, left : left + size] = 255 - still[:size, :size]
            name = f"images/cam{number:02d}/{instant:04d}.png"
            write_image(folder / name, picture)
            shown = eqx.tree_at(lambda c: c.time, camera, jnp.float32(instant / max(times - 1, 1)))
            listed.append(FrameRecord(name, shown, f"cam{number:02d}", "train"))
    write_manifest(folder / "transforms.json", listed)


def _rows(views: Sequence[View], folder: Path) -> list[dict[str, Any]]:
    """A line for each part."""
    places = np.random.default_rng(0).uniform(-1, 1, (_PLACES, 3)).astype(np.float32)
    read: list[Footage] = []

    def reading() -> None:
        # In a file, as large captures are.
        read[:] = [footage(views, side=_SIDE, bundle=_BUNDLE, memory=0, folder=folder)]

    def medians() -> None:
        read[0].medians.clear()
        find_medians(read[0], [own for own, still in camera_frames(read[0]) if still])

    parts: dict[str, Callable[[], Any]] = {
        "read": reading,
        "motion": lambda: activity(read[0]),
        "medians": medians,
        "points": lambda: point_activity(read[0], places),
    }
    rows = []
    for part, work in parts.items():
        for _ in range(2):
            began = time.perf_counter()
            work()
            seconds = time.perf_counter() - began
        film = read[0].film
        rows.append(
            record(
                "pictures",
                part=part,
                pictures=len(views),
                megapixels=film.width * film.height / 1e6,
                seconds=seconds,
                gigabytes_per_s=read[0].pixel.nbytes / 1e9 / seconds,
            )
        )
    return rows


if __name__ == "__main__":
    main()
