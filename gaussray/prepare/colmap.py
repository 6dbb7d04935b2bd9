"""Access to pycolmap, an optional dependency."""

import contextlib
import signal
from collections.abc import Iterator
from typing import Any

from gaussray.prepare.errors import PrepareError


def pycolmap() -> Any:
    """The module pycolmap.

    Raises:
        PrepareError: It is not installed.
    """
    before = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap as module
    except ImportError:
        raise PrepareError(
            "gaussray prepare needs pycolmap, which is not installed: pip install -e '.[prepare]' "
            "in the folder of gaussray."
        ) from None
    # SIGTERM would print a stack trace of C++ since. Only the main thread may change that.
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGTERM, before)
    return module


@contextlib.contextmanager
def quiet_colmap() -> Iterator[None]:
    """Within the block COLMAP logs nothing but fatal errors: others become a `PrepareError`."""
    logging = pycolmap().logging
    level = logging.minloglevel
    logging.minloglevel = 3
    try:
        yield
    finally:
        logging.minloglevel = level
