"""The sample data: a capture of 16 cameras, and the scene that the demo reconstructs from it."""

from pathlib import Path


# The word that stands for the sample data in place of a folder, and which folder each key gets.
WORD = "sample"
PARTS = {"scene": "scene", "capture.path": "capture", "cameras": "capture", "truth": "capture"}


def sample(part: str) -> Path:
    """The folder of the sample's `capture` or `scene`: inside an installed package, or in
    experiments/quickstart of a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside, beside = package / "quickstart", package.parent / "experiments" / "quickstart"
    return (inside if inside.is_dir() else beside) / part
