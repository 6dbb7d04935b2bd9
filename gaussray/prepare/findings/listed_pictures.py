"""Pictures in a message: runs of neighbours as ranges, and how many are not told."""

from collections.abc import Sequence

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.placed_cameras import picture_name
from gaussray.prepare.placement import Placement
from gaussray.runtime.output import listed_names


def listed_pictures(pictures: Sequence[MatchingPicture], placement: Placement) -> str:
    """The names of some pictures of a placement (`listed_names`); those of cameras that stand still
    are told one by one.

    Args:
        pictures: those that are told, in the order of the placement.
        placement: all pictures, and the cameras that stand still.
    """
    everyone, camera = [], ""
    for picture in placement.pictures.values():
        if picture.camera != camera:
            # No range leads from one camera to the next.
            everyone.append("")
        camera = picture.camera
        everyone.append("" if camera in placement.still else picture_name(picture, placement))
    return listed_names([picture_name(picture, placement) for picture in pictures], everyone)
