"""Files that appear whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


# In the name of what is not whole yet.
PART = ".part"


@contextlib.contextmanager
def whole(path: Path | str) -> Iterator[Path]:
    """A temporary name beside `path`, same suffix, moved onto it when the block ends well.

    Missing folders are made. If the block raises, the temporary file is removed and `path` is left
    as it was.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{path}: its folder cannot be made: {error}") from error
    partial = path.with_name(f".{path.stem}.{os.getpid()}{PART}{path.suffix}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def sweep(folder: Path, *, deep: bool = False) -> None:
    """Remove what killed processes have left of files that were not whole, in `folder` or, `deep`,
    also below it. Nothing else may be writing there."""
    for partial in (folder.rglob if deep else folder.glob)(f".*{PART}*"):
        with contextlib.suppress(OSError):
            partial.unlink()
