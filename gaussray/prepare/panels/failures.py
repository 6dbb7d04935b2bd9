"""Failures of `gaussray prepare` that may come from pictures of several panels."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from gaussray.prepare.errors import PrepareError
from gaussray.prepare.panels.find import find_panels
from gaussray.prepare.sources import Source
from gaussray.runtime.output import first_of


@contextmanager
def panels_in_errors(sources: Sequence[Source]) -> Iterator[None]:
    """Have a failure within the block repeat which videos seem to hold several panels.

    Raises:
        PrepareError: That of the block, with the videos.
    """
    try:
        yield
    except PrepareError as error:
        signs = [() if source.first is None else source.first.panels for source in sources]
        found = zip(sources, find_panels(signs), strict=True)
        held = [source.path.name for source, one in found if one is not None]
        if not held:
            raise
        raise PrepareError(
            f"{error} The reason may be that {first_of(held)} seem{'s' * (len(held) == 1)} to hold "
            "several views or maps in each picture: cut them as the warning at the beginning says."
        ) from error
