"""Whether pictures show enough for features to be found in them."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import UInt8

from gaussray.capture.picture_file import read_levels
from gaussray.capture.spread import evenly_spread
from gaussray.capture.video_file import decoded_frames, upright
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.first_picture import detailed_blocks
from gaussray.prepare.photographs import HEIC_SUFFIXES
from gaussray.prepare.sources import Source


# A picture with fewer blocks that show something is bare: a white dot on black has 8 at most, poor
# pictures of 320 x 240 a hundred.
_FEWEST = 12
# Pictures of a camera that are looked at if the first one is bare: so many of a folder, each k-th
# of a video.
_PICTURES, _FRAMES = 5, 10


def check_details(sources: Sequence[Source]) -> None:
    """Refuse cameras of which no picture that is looked at shows more than a few spots.

    The first picture of one camera is enough to tell that they show something; later ones are
    decoded only if all of them are bare, as where a film begins black.

    Raises:
        PrepareError: None of them does; poses cannot be estimated from such pictures.
    """
    if any(_first_shows_something(source) for source in sources):
        return
    most = 0
    for source in sources:
        for picture in _later_pictures(source):
            if (count := detailed_blocks(picture)) >= _FEWEST:
                return
            most = max(most, count)
    what = "spots on an even ground" if most else "an even colour"
    one = "the camera's" if len(sources) == 1 else f"all {len(sources)} cameras'"
    raise PrepareError(
        f"the pictures must show texture, but {one} pictures show {what} alone. Check that they "
        "are not black, overexposed or out of focus, and that they are no infra-red recordings of "
        "markers: take the videos of ordinary cameras, or give a calibration as "
        "poses.calibration=FILE."
    )


def _first_shows_something(source: Source) -> bool:
    if source.is_video:
        return source.first is None or source.first.blocks >= _FEWEST
    # A reader of its own decodes these; they are photographs.
    if source.pictures[0].suffix.lower() in HEIC_SUFFIXES:
        return True
    return detailed_blocks(read_levels(source.pictures[0], *source.size(0))) >= _FEWEST


def _later_pictures(source: Source) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    if source.is_video:
        for k, frame in enumerate(decoded_frames(source.path)):
            if k % _FRAMES == 0:
                yield upright(source.path, frame)
    else:
        for k in evenly_spread(range(source.count), _PICTURES):
            if source.pictures[k].suffix.lower() not in HEIC_SUFFIXES:
                yield read_levels(source.pictures[k], *source.size(k))
