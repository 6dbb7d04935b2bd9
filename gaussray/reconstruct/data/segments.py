"""A long capture cut into segments in time, which are reconstructed one after another."""

import dataclasses

import numpy as np

from gaussray.capture.capture import Capture, View
from gaussray.capture.same_lens import same_lens
from gaussray.capture.same_size import same_size
from gaussray.capture.spread import evenly_spread


@dataclasses.dataclass(frozen=True, eq=False)
class Segment:
    """The training views from one time to another, both included, and that interval of time;
    `name` is shown in progress bars and empty for a whole capture."""

    views: list[View]
    time_range: tuple[float, float]
    name: str = ""


def training_views(capture: Capture) -> list[View]:
    """The views of split train, as cameras of one size and one kind of lens (`same_size`,
    `same_lens`)."""
    return same_lens(same_size([view for view in capture.views if view.split == "train"]))


def segments(capture: Capture, most: int) -> list[Segment]:
    """The training views in segments of about equal length. Neighbours share one time.

    So an exposure or readout around that time lies within one of them. The first segment begins and
    the last one ends with the capture.

    Args:
        capture: the capture.
        most: the largest number of times of a segment, at least 2; 0: one segment.
    """
    views = training_views(capture)
    times = np.unique([view.time for view in views])
    count = -(-(len(times) - 1) // (most - 1)) if most else 1
    if count <= 1:
        return [Segment(views, capture.time_range)]
    inner = evenly_spread(times.tolist(), count + 1)[1:-1]
    begin, end = capture.time_range
    edges = [begin, *inner, end]
    return [
        Segment(
            [view for view in views if first <= view.time <= last],
            (first, last),
            f"segment {i} of {count}",
        )
        for i, (first, last) in enumerate(zip(edges, edges[1:], strict=False), 1)
    ]
