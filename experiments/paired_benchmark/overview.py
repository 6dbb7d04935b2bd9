"""One picture of every scene under every effect.

python -m experiments.paired_benchmark.overview --captures DIR [--out scenes.png]
"""

import argparse
from pathlib import Path

from experiments.paired_benchmark.plan import EFFECTS
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.frames import read_encoded
from gaussray.dataset.images import contact_sheet, write_image


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--captures", type=Path, required=True)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "scenes.png")
    chosen = parser.parse_args()
    rows = []
    for file in sorted(chosen.captures.glob("*/transforms.json")):
        capture = read_capture(file.parent)
        groups = {"pinhole": capture.views, **capture.effects}
        names = [name for name in EFFECTS if name in groups]
        rows.append((file.parent.name, [picture(groups[name]) for name in names]))
    titles = [name.replace("_", " ") for name in EFFECTS]
    write_image(chosen.out, contact_sheet(rows, titles=titles, font=12))


def picture(views):
    """Of the last camera, two thirds into the clip."""
    own = [view for view in views if view.camera_name == views[-1].camera_name]
    return read_encoded(min(own, key=lambda view: abs(view.time - 2 / 3)))


if __name__ == "__main__":
    main()
