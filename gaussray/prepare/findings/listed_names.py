"""Names in a message: runs of neighbours as ranges, and how many are not told."""

from collections.abc import Sequence

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.placed_cameras import picture_name
from gaussray.prepare.poses import Placement


# Names and ranges that are told, at most; and fewest neighbours that make a range.
_TOLD, _RANGE = 8, 3


def listed_names(names: Sequence[str], everyone: Sequence[str] = ()) -> str:
    """Names as in `a1 to a5, b2 and 7 others`.

    Args:
        names: those that are told, in order.
        everyone: all names in order, in which neighbours follow each other; none makes no ranges.
    """
    place = {name: k for k, name in enumerate(everyone)}
    runs: list[list[str]] = []
    for name in names:
        if runs and name in place and place[name] - 1 == place.get(runs[-1][-1]):
            runs[-1].append(name)
        else:
            runs.append([name])
    parts = [
        part for run in runs for part in ([run] if len(run) >= _RANGE else [[name] for name in run])
    ]
    told = [part[0] if len(part) == 1 else f"{part[0]} to {part[-1]}" for part in parts[:_TOLD]]
    left = sum(map(len, parts[_TOLD:]))
    more = f" and {left} other{'s' * (left > 1)}" if left else ""
    return ", ".join(told) + more


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
