"""What to do about a lens that may be wrong, by what the user has said of it."""

from gaussray.prepare.placement import Placement


def lens_advice(placement: Placement) -> str:
    """How to tell the lens, or what to check of what was told of it: a clause."""
    if placement.model.focal_source == "lens":
        return "check that poses.lens is of this camera, zoom and size of pictures, or leave it out"
    if placement.fov_given:
        return "check poses.fov, or give poses.lens=FILE in its place if you know the lens"
    return "poses.lens=FILE or poses.fov=DEGREES if you know the lens"
