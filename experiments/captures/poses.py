"""Whether poses and pictures of captures belong together, as `reconstruct` checks before a fit.

    python -m experiments.captures.poses CAPTURE...

prints for each capture how many details of neighbouring pictures match, how many pixels they lie
off their epipolar lines in the median, as the poses are and as they would be if read otherwise, the
same of neighbours that look in different directions, which reading is taken for right (none: as
they are), and seconds, the first with compilation.
"""

import argparse
import time
from pathlib import Path

from gaussray.capture.open import open_capture
from gaussray.reconstruct.checks.pose_check import REMEDIES, pose_check
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.data.segments import training_views


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    columns = ["matches", "as they are", *REMEDIES]
    print("| " + " | ".join(["capture", *columns, *columns, "reading", "seconds"]) + " |")
    print("|---" * (2 * len(columns) + 3) + "|", flush=True)
    for folder in parser.parse_args().folders:
        pictures = footage(training_views(open_capture(folder)), side=32, bundle=8)
        begin = time.perf_counter()
        found = pose_check(pictures)
        seconds = time.perf_counter() - begin
        cells = [folder.name]
        for pairs in found:
            cells += [
                str(pairs.matches),
                *map("{:.2f}".format, (pairs.error, *pairs.others.values())),
            ]
        cells += [found.reading or "-", f"{seconds:.1f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
