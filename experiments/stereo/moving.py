"""Stereo of what moves, with whole pictures and with the moving pixels alone: seconds a timestamp.

python -m experiments.stereo.moving CAPTURE [--scale S] [--times N]

Whole pictures are those without masks, of which every pixel is refined, so that silhouettes do not
count either: their points are others. Both are run in turn at every timestamp; compilation, at the
first, is told apart. Median distances of points to the capture's own nearest one are of the first
timestamp, at which its points are.
"""

import argparse
import time
from pathlib import Path

import jax
import numpy as np
from scipy.spatial import KDTree

from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.data.segments import training_views
from gaussray.reconstruct.data.still_cameras import MedianMasks
from gaussray.reconstruct.initialize.stereo.matching import reduced_mask, stereo_points
from gaussray.reconstruct.initialize.stereo.options import options_for, with_silhouette
from gaussray.reconstruct.initialize.stereo.view_sets import moving_views


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("capture", type=Path)
    parser.add_argument("--scale", type=float, default=1.0, help="of the pictures' sides")
    parser.add_argument("--times", type=int, default=8, help="timestamps, evenly spread")
    chosen = parser.parse_args()
    capture = open_capture(chosen.capture, selection=Selection(scale=chosen.scale))
    pictures = footage(training_views(capture), side=8)
    every = np.unique(pictures.times)
    times = every[np.linspace(0, len(every) - 1, min(chosen.times, len(every))).round().astype(int)]
    cameras = len(np.unique(pictures.name))
    options = with_silhouette(options_for(jax.default_backend(), cameras))
    masks, rows, share = MedianMasks(pictures), {"whole": [], "moving": []}, []
    for instant in times:
        found = moving_views(pictures, float(instant), masks)
        if found is None:
            continue
        views, moved = found
        share.append(views.masks.mean())
        wanted = reduced_mask(moved, options)
        for name, seen in (("whole", None), ("moving", views.masks)):
            begin = time.perf_counter()
            points = stereo_points(
                views.pictures, views.cameras, seen, options=options, wanted=wanted
            )
            rows[name].append((time.perf_counter() - begin, points.position))
    print(f"{len(share)} timestamps, {np.mean(share):.3f} of the pixels are matched")
    for name, runs in rows.items():
        seconds, count = [run[0] for run in runs], np.mean([len(run[1]) for run in runs])
        line = f"{name:7} first {seconds[0]:.2f} s, median of the others "
        line += f"{np.median(seconds[1:]):.2f} s, {count:.0f} points a timestamp"
        if capture.points is not None and len(runs[0][1]):
            away = KDTree(capture.points.position).query(runs[0][1])[0]
            line += f", {np.median(away):.4f} from the nearest true point (90 %:"
            line += f" {np.quantile(away, 0.9):.4f})"
        print(line)
    ratio = np.divide(*([run[0] for run in rows[name]][1:] for name in ("whole", "moving")))
    print(f"whole pictures take {np.median(ratio):.2f} times as long")


if __name__ == "__main__":
    main()
