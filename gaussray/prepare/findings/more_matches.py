"""What finds more matches of some pictures."""

from collections.abc import Sequence

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.poses import Placement


# Pixels below which a picture's width limits its features, and not `poses.features`.
_SMALL = 800


def more_matches(placement: Placement, pictures: Sequence[MatchingPicture]) -> list[str]:
    """What would find more matches: a noun or a key each.

    Args:
        placement: the cameras that stand still, and whether they have further timestamps.
        pictures: those that lack matches, or no picture for all.
    """
    pictures = pictures or list(placement.pictures.values())
    smallest = min((max(picture.size) for picture in pictures), default=0)
    wider = f"larger pictures (these have {smallest} pixels)"
    found = [wider if smallest < _SMALL else "poses.features=16384"]
    if placement.more_instants and any(p.camera in placement.still for p in pictures):
        found.append(f"frames.instants={placement.more_instants}")
    return found
