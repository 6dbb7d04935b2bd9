"""What there is to try things on: a capture of 16 cameras, and the scene the demo makes of it."""

from pathlib import Path


# The word that stands for the sample where a folder is asked for, and what it means there.
WORD = "sample"
PARTS = {"scene": "scene", "capture.path": "capture", "cameras": "capture", "truth": "capture"}


def sample(part: str) -> Path:
    """The folder of the sample's `capture` or `scene`: inside the package when installed, among
    the experiments in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside, beside = package / "quickstart", package.parent / "experiments" / "quickstart"
    return (inside if inside.is_dir() else beside) / part
