"""How much a file may ask for: held against its header before memory is taken."""

import equinox as eqx


class Limits(eqx.Module):
    """The most that is read of one file.

    `text` megabytes of JSON or other text; `arrays` gigabytes of all arrays in a file, unpacked;
    `picture` megapixels of a picture or video, in `channels`; `points` millions of points or
    Gaussians; `frames` of a list or video. What a capture names lies in its folder or in one of the
    `folders`.
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
    """Those in force."""
    return _in_force[0]


def limit(chosen: Limits) -> None:
    """Put limits in force: of the whole process, as the system's own are, for files are opened deep
    below the stages and in threads."""
    _in_force[0] = chosen


def within(path: object, what: str, amount: float | int, key: str, unit: float | int = 1) -> None:
    """A ValueError if a file asks for more than the limit `key` of so many `unit`s."""
    most = getattr(limits(), key)
    if amount > most * unit:
        raise ValueError(
            f"{path}: {what} must be at most limits.{key}={most:g}, got {amount / unit:.6g}. Raise "
            "the limit if you trust the file."
        )
