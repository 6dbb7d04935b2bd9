"""Blender's rays and times against ours, for every lens, aperture and shutter.

python -m experiments.paired_benchmark.geometry [--out DIR] [--size 128]
"""

import argparse
import sys
from pathlib import Path

from experiments.paired_benchmark.geometry.proof import prove


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--out", type=Path, default=Path("runs/geometry"), help="folder of capture and report.json"
    )
    parser.add_argument("--size", type=int, default=128, help="shorter side of most pictures, even")
    args = parser.parse_args()
    if args.size < 16 or args.size % 2:
        parser.error(f"--size must be even and at least 16, got {args.size}.")
    try:
        return 0 if prove(args.out, args.size) else 1
    except RuntimeError as error:
        parser.exit(2, f"{error}\n")


if __name__ == "__main__":
    sys.exit(main())
