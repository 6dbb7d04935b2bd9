"""What finds more matches of some pictures."""

from collections.abc import Sequence

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.full_pictures import MANY_FEATURES
from gaussray.prepare.placement import Placement


# Pixels below which wider pictures would have clearly more features.
_SMALL = 800


def more_matches(placement: Placement, pictures: Sequence[MatchingPicture]) -> list[str]:
    """What would find more matches: a noun or a key each; often nothing.

    Args:
        placement: which pictures may have more features, which cameras stand still, and whether
            they have further timestamps.
        pictures: those that lack matches, or no picture for all.
    """
    pictures = pictures or list(placement.pictures.values())
    smallest = min((max(picture.size) for picture in pictures), default=0)
    found = []
    if any(picture.file in placement.full_pictures for picture in pictures):
        found.append(f"poses.features={MANY_FEATURES}")
    elif smallest < _SMALL:
        found.append(f"larger pictures (these have {smallest} pixels)")
    if placement.more_instants and any(p.camera in placement.still for p in pictures):
        found.append(f"frames.instants={placement.more_instants}")
    return found
