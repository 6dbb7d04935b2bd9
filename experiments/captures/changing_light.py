"""A copy of a capture whose light and exposures change over time, to test what such pictures cost.

    python -m experiments.captures.changing_light CAPTURE OUT [--lamp STOPS] [--exposure STOPS]

The lamp's light changes in the pictures of all cameras, held-out ones too, as a lamp that is dimmed
does. The exposure changes in the pictures of each training camera by itself, as cameras with
automatic exposure record; held-out cameras keep theirs. Both change smoothly, by at most so many
stops each way, in linear light; what exceeds full scale is clipped.
"""

import argparse
from pathlib import Path

import numpy as np

from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.color import srgb_decode, srgb_encode
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.prepare.document import write_points


# Periods over the duration of the capture: slow, and a few frames long.
_PERIODS = (1.3, 3.1)


def stops(time: float, seed: int) -> float:
    """A smooth function of time in -1..1, another for each seed; times are in 0..1."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(_PERIODS))
    waves = np.sin(2 * np.pi * np.array(_PERIODS) * time + phase)
    return float(waves @ (0.6, 0.4))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--lamp", type=float, default=0.0, help="stops")
    parser.add_argument("--exposure", type=float, default=0.0, help="stops")
    chosen = parser.parse_args()
    capture, records = open_capture(chosen.capture), []
    cameras = sorted({view.camera_name for view in capture.views})
    for i, view in enumerate(capture.views):
        change = chosen.lamp * stops(share_of(view.time, capture.time_range), 0)
        if view.split == "train":
            own = 1 + cameras.index(view.camera_name)
            change += chosen.exposure * stops(share_of(view.time, capture.time_range), own)
        light = srgb_decode(read_encoded(view) / 255.0) * 2**change
        name = f"images/{view.camera_name}/{i:05d}.png"
        (chosen.out / name).parent.mkdir(parents=True, exist_ok=True)
        levels = np.rint(255 * srgb_encode(np.clip(light, 0, 1))).astype(np.uint8)
        write_image(chosen.out / name, levels)
        records.append(FrameRecord(name, view.camera, view.camera_name, view.split))
    extra = {"time_unit": capture.time_unit}
    if capture.points is not None:
        colors = np.rint(255 * srgb_encode(np.clip(np.asarray(capture.points.color), 0, 1)))
        place = np.asarray(capture.points.position)
        write_points(chosen.out / "points3d.ply", place, colors.astype(np.uint8))
        extra["ply_file_path"] = "points3d.ply"
    write_manifest(chosen.out / "transforms.json", records, extra=extra)


def share_of(time: float, time_range: tuple[float, float]) -> float:
    """A time as a share of the capture's duration."""
    begin, end = time_range
    return (time - begin) / ((end - begin) or 1.0)


if __name__ == "__main__":
    main()
