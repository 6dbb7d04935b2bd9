"""Folders beside those of pictures that hold something else: depth maps, masks, normals."""

import re
from pathlib import Path


_OTHER = re.compile(
    r"((depth|disparity|mask|segmentation|semantic|label|confidence)s?|seg|normals)([ _-].*)?",
    re.IGNORECASE,
)


def holds_other_maps(folder: Path) -> bool:
    """Whether the name of a folder says that it holds depth maps, masks, labels or normals.

    Args:
        folder: a folder beside one of pictures.
    """
    return _OTHER.fullmatch(folder.name) is not None
