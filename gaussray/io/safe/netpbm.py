"""Headers of binary PGM and PPM pictures, whose reader takes the whole file into memory."""

import os
import re
from pathlib import Path

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within


# Whitespace and comments may lie between the numbers, and one space or line end before the pixels.
# Nothing is repeated within what is repeated: the time would double with each further space.
_HEADER = re.compile(rb"P([56])" + rb"(?:[ \t\r\n\v\f]|#[^\r\n]*[\r\n])+(\d{1,9})" * 3 + rb"\s")
# Longest header, with its comments.
_LONGEST = 4096
# Bytes that may follow the pixels: a line end, a trailer of the program that wrote it.
_TRAILER = 4096


def check_netpbm(path: Path) -> None:
    """Check that a binary PGM or PPM file holds the pixels that its header says, and no more.

    Raises:
        OSError: the header is damaged, or the file is too short or too long for it.
        ValueError: the picture exceeds limits.picture.
    """
    with opened(path) as file:
        header = _HEADER.match(file.read(_LONGEST))
        size = os.fstat(file.fileno()).st_size
    if header is None:
        raise OSError(f"{path}: the picture cannot be opened: its header is damaged.")
    kind, width, height, most = (int(number) for number in header.groups())
    if not (width and height and 1 <= most < 1 << 16):
        raise OSError(
            f"{path}: the picture must have pixels of levels up to 1 ... 65535, got {width} x "
            f"{height} up to {most}."
        )
    within(path, "its megapixels", width * height, "picture", 1e6)
    stored = width * height * (3 if kind == 6 else 1) * (2 if most > 255 else 1)
    if size < header.end() + stored:
        raise OSError(
            f"{path}: the picture is truncated or corrupt: it must hold {stored} bytes of pixels, "
            f"got {size - header.end()}. Copy it again."
        )
    if size > header.end() + stored + _TRAILER:
        raise OSError(
            f"{path}: the picture must be alone in its file, {stored} bytes of pixels, got "
            f"{size - header.end()}. Write each picture into a file of its own."
        )
