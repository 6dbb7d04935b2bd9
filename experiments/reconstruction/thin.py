"""A copy of a capture's point cloud with few of its points.

python -m experiments.reconstruction.thin CAPTURE/points3d.ply OUT.ply [--count 600] [--seed 0]
"""

import argparse
from pathlib import Path

import numpy as np

from gaussray.io.ply import read_vertices


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=600)
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    table = read_vertices(told.source)
    chosen = np.random.default_rng(told.seed).choice(len(table), told.count, replace=False)
    rows = table[np.sort(chosen)]
    head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}"]
    for name in rows.dtype.names:
        kind = "uchar" if rows.dtype[name] == np.uint8 else "float"
        head.append(f"property {kind} {name}")
    lines = [" ".join(str(x) for x in row.tolist()) for row in rows]
    told.out.write_text("\n".join([*head, "end_header", *lines, ""]))


if __name__ == "__main__":
    main()
