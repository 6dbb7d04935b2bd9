"""Limits on the size of untrusted files, checked against their headers before memory is used."""

import equinox as eqx


class Limits(eqx.Module):
    """The largest files that are read.

    Args:
        text: megabytes of JSON or other text.
        arrays: gigabytes of all arrays of a file, uncompressed.
        picture: megapixels of a picture or video frame. Reading one takes up to 25 bytes a pixel,
            and 45 where it is scaled.
        channels: channels of a picture.
        points: millions of points or Gaussians.
        frames: frames of a manifest or video.
        folders: folders in which files named by a capture may lie, besides the capture's own.

    Raises:
        ValueError: a limit is not above 0, or a folder is empty.
    """

    text: float = eqx.field(static=True, default=512.0)
    arrays: float = eqx.field(static=True, default=16.0)
    picture: float = eqx.field(static=True, default=200.0)
    channels: int = eqx.field(static=True, default=64)
    points: float = eqx.field(static=True, default=50.0)
    frames: int = eqx.field(static=True, default=1_000_000)
    folders: tuple[str, ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        for key in ("text", "arrays", "picture", "channels", "points", "frames"):
            if not getattr(self, key) > 0:
                raise ValueError(f"limits.{key} must be above 0, got {getattr(self, key)}.")
        if not all(isinstance(folder, str) and folder for folder in self.folders):
            raise ValueError(f"limits.folders must be a list of folders, got {list(self.folders)}.")


_in_force = [Limits()]


def limits() -> Limits:
    """The limits in force."""
    return _in_force[0]


def limit(chosen: Limits) -> None:
    """Put limits in force for the whole process, including all threads."""
    _in_force[0] = chosen


def within(path: object, what: str, amount: float | int, key: str, unit: float | int = 1) -> None:
    """Check a size against a limit.

    Args:
        path: the file, for the error message.
        what: what is measured, for the error message.
        amount: the size.
        key: name of the limit in `Limits`.
        unit: size of the limit's unit, such as 1e6 for megabytes.

    Raises:
        ValueError: the size exceeds the limit.
    """
    most = getattr(limits(), key)
    if amount > most * unit:
        raise ValueError(
            f"{path}: {what} must be at most limits.{key}={most:g}, got {amount / unit:.6g}. Raise "
            "the limit if you trust the file."
        )
