"""Stereo of a capture without its points, scored against them where it has any.

python -m experiments.stereo.score experiments/quickstart/capture
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.capture.open import open_capture
from gaussray.capture.points import Points
from gaussray.capture.selection import Selection
from gaussray.color import srgb_encode
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.data.segments import training_views
from gaussray.reconstruct.initialize.stereo.from_pictures import points_from_pictures


# Shares of the diagonal of the true points' box.
WITHIN = (0.01, 0.05)


def scores(
    found: Float[np.ndarray, "points 3"], truth: Float[np.ndarray, "truth 3"]
) -> dict[str, float]:
    """Distances between two clouds, both ways: the median from found to true points in gaps between
    the true ones, which are the least that it can be, and shares within WITHIN of the box."""
    size = float(np.linalg.norm(np.ptp(truth, axis=0)))
    gap = float(np.median(KDTree(truth).query(truth, k=2)[0][:, 1]))
    away, missing = KDTree(truth).query(found)[0], KDTree(found).query(truth)[0]
    result = {"median": float(np.median(away)), "median_gaps": float(np.median(away)) / gap}
    for share in WITHIN:
        result[f"accurate_{share}"] = float(np.mean(away < share * size))
        result[f"complete_{share}"] = float(np.mean(missing < share * size))
    return {name: round(value, 4) for name, value in result.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--scale", type=float, default=1.0, help="of the pictures' sides")
    parser.add_argument("--out", type=Path, help="a PLY file for the points")
    chosen = parser.parse_args()
    capture = open_capture(chosen.capture, selection=Selection(scale=chosen.scale))
    pictures = footage(training_views(capture), side=8)
    begin, cpu = time.monotonic(), time.process_time()
    points = points_from_pictures(pictures)
    result = {
        "pictures": len(pictures.times),
        "points": len(points.position),
        "seconds": round(time.monotonic() - begin, 1),
        "cpu_seconds": round(time.process_time() - cpu, 1),
    }
    if capture.points is not None:
        result |= scores(points.position, capture.points.position)
    print(json.dumps(result))
    if chosen.out:
        write(chosen.out, points)


def write(path: Path, points: Points) -> None:
    """Points as a binary PLY file with 8-bit sRGB colours."""
    kinds = [*((axis, "<f4") for axis in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))]
    table = np.empty(len(points.position), kinds)
    codes = np.round(255 * srgb_encode(np.clip(points.color, 0, 1).astype(np.float64)))
    columns = [*points.position.T, *codes.astype(np.uint8).T]
    for (name, _), column in zip(kinds, columns, strict=True):
        table[name] = column
    words = {"<f4": "float", "u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [f"property {words[kind]} {name}" for name, kind in kinds]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + table.tobytes())


if __name__ == "__main__":
    main()
