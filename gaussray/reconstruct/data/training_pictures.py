"""The training pictures of a segment, which trials and the fit share."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from gaussray.capture.capture import View
from gaussray.reconstruct.data.equalize import Equalization, equalization, equalized
from gaussray.reconstruct.data.motion_mask import Activity, activity
from gaussray.reconstruct.data.pictures import Footage, footage
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.reconstruct.shared_results import SharedResults


class TrainingPictures(NamedTuple):
    """Pictures in tiles of one size.

    Args:
        footage: the pictures, evened out, and their cameras.
        equalization: what was evened out; None for nothing.
        activity: where the pictures change.
    """

    footage: Footage
    equalization: Equalization | None
    activity: Activity


def training_pictures(
    views: Sequence[View],
    options: ReconstructOptions,
    shared: SharedResults,
    *,
    evened_out: bool,
    folder: Path,
    report: Callable[[int], object],
) -> TrainingPictures:
    """The pictures of a segment, read once for each size of tiles. All sizes together take
    fit.memory at most; beyond, they are in files.

    Args:
        views: the training views of the segment.
        options: all options, of which those of pictures and tiles count.
        shared: what fits of the same pictures have in common.
        evened_out: whether exposures and light that change are evened out, in all of these fits.
        folder: folder of the files.
        report: called with the number of pictures read, after each picture.
    """
    bundle = options.trace.bundle
    side = max(options.fit.tile_side, bundle)
    with shared.turn("pictures"):
        kept: dict[tuple[int, int], TrainingPictures] = shared.once("pictures", dict)
        if (side, bundle) in kept:
            return kept[side, bundle]
        taken = 1e-9 * sum(other.footage.pixel.nbytes for other in kept.values())
        memory = max(options.fit.memory - taken, 0.0)
        read = footage(views, side=side, bundle=bundle, memory=memory, folder=folder, report=report)
        found = None
        if evened_out:
            found = shared.once("equalization", lambda: equalization(read))
        if found is not None:
            read = equalized(read, found)
        for other in kept.values():
            # Whole pictures, whatever the size of tiles.
            read.medians.update(other.footage.medians)
        kept[side, bundle] = TrainingPictures(read, found, activity(read))
    return kept[side, bundle]
