"""The picture file of a view: its fields, its size, and whether it is the one that it must be."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from gaussray.capture.errors import CaptureError
from gaussray.capture.orientation import is_turned
from gaussray.capture.picture_file import check_size, open_image, picture_size
from gaussray.capture.stored_part import Window
from gaussray.capture.videos import frame_of


@runtime_checkable
class PictureFile(Protocol):
    """The fields of a view that are needed to read its picture.

    `image` is a file or a frame of a video (`frame_path`), `width` and `height` the size that the
    view must have, `background` one of BACKGROUNDS, `window` the part of the file that the view
    shows (None: all of it), `margin` how many columns and rows around it show nothing (left, top,
    right, bottom).
    """

    @property
    def image(self) -> Path: ...
    @property
    def width(self) -> int: ...
    @property
    def height(self) -> int: ...
    @property
    def color_space(self) -> str: ...
    @property
    def background(self) -> str: ...
    @property
    def window(self) -> Window | None: ...
    @property
    def margin(self) -> tuple[int, int, int, int]: ...


def stored_size(view: PictureFile) -> tuple[int, int]:
    """Width and height of the file of a view's picture."""
    return view.window.size if view.window else shown_size(view)


def shown_size(view: PictureFile) -> tuple[int, int]:
    """Width and height of a view without its margin: of what it shows."""
    left, top, right, bottom = view.margin
    return view.width - left - right, view.height - top - bottom


def check_images(views: Sequence[PictureFile]) -> None:
    """Check that the pictures of all views exist and have the sizes that their cameras say.

    Raises:
        CaptureError: names the first ten pictures that are absent or of another size.
    """
    wrong = []
    for view in views:
        try:
            check_size(view.image, _size_for(view), *stored_size(view))
        except (OSError, CaptureError) as error:
            wrong.append(str(error))
    if wrong:
        more = [f"... and {len(wrong) - 10} more"] if len(wrong) > 10 else []
        raise CaptureError(
            "\n".join([f"{len(wrong)} of {len(views)} pictures:", *wrong[:10], *more])
        )


def _size_for(view: PictureFile) -> tuple[int, int]:
    """The size of a view's file as it is read for the view (`is_turned`)."""
    if frame_of(view.image):
        return picture_size(view.image)
    spec, wanted = open_image(view.image).spec(), stored_size(view)
    return wanted if is_turned(spec, *wanted) else (spec.width, spec.height)
