"""A copy of a capture whose light and exposures change over time, to test what such pictures cost.

    python -m experiments.captures.changing_light CAPTURE OUT [--lamp STOPS] [--exposure STOPS]

The lamp's light changes in the pictures of all cameras, held-out ones too, as a lamp that is dimmed
does. The exposure changes in the pictures of each training camera by itself, as cameras with
automatic exposure record; held-out cameras keep theirs. Both change smoothly, by at most so many
stops each way, in linear light; what exceeds full scale is clipped.
"""

import argparse
import json
import shutil
from pathlib import Path

import numpy as np

from gaussray.capture.frames import read_encoded
from gaussray.capture.open import open_capture
from gaussray.color import srgb_decode, srgb_encode
from gaussray.dataset.images import write_image


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
    manifest = json.loads((chosen.capture / "transforms.json").read_text())
    cameras = sorted({frame["camera"] for frame in manifest["frames"]})
    views = {view.image: view for view in open_capture(chosen.capture).views}
    for frame in manifest["frames"]:
        view = views[chosen.capture / frame["file_path"]]
        change = chosen.lamp * stops(view.time, 0)
        if view.split == "train":
            change += chosen.exposure * stops(view.time, 1 + cameras.index(view.camera_name))
        light = srgb_decode(read_encoded(view) / 255.0) * 2**change
        frame["file_path"] = str(Path(frame["file_path"]).with_suffix(".png"))
        name = chosen.out / frame["file_path"]
        name.parent.mkdir(parents=True, exist_ok=True)
        write_image(name, np.rint(255 * srgb_encode(np.clip(light, 0, 1))).astype(np.uint8))
    (chosen.out / "transforms.json").write_text(json.dumps(manifest, indent=1))
    for points in chosen.capture.glob("*.ply"):
        shutil.copy(points, chosen.out / points.name)


if __name__ == "__main__":
    main()
