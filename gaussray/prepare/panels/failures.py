"""Failures of `gaussray prepare` that may come from pictures of several panels."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from gaussray.prepare.errors import PrepareError
from gaussray.prepare.panels.find import find_panels
from gaussray.prepare.sources import Source
from gaussray.runtime.output import first_of


def holds_views(source: Source) -> bool:
    """Whether a video surely holds two views in each picture, which one pose does not fit."""
    return source.first is not None and any(one.are_surely_views for one in source.first.panels)


@contextmanager
def panels_in_errors(sources: Sequence[Source]) -> Iterator[None]:
    """Have a failure within the block begin with which videos seem to hold several panels.

    Raises:
        PrepareError: That of the block, after the videos.
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
            f"{first_of(held)} seem{'s' * (len(held) == 1)} to hold several views or maps in each "
            "picture, which may be the reason of the failure: cut them as the warning at the "
            f"beginning says. What failed: {error}"
        ) from error
