"""Known poses that nothing tests: of cameras without a match."""

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import observations_by_picture


def untested_pictures(placement: Placement) -> list[MatchingPicture]:
    """Pictures of calibrated cameras that share no match with any other, so that neither a point
    nor an epipolar line tells whether the pose is right."""
    if not placement.known:
        return []
    matched = {file for pair, rows in placement.matches.items() if len(rows) for file in pair}
    counts = observations_by_picture(placement.model)
    return [
        placement.pictures[file]
        for file, count in zip(placement.model.pictures, counts, strict=True)
        if not count and file not in matched
    ]
