"""A capture is cut evenly, and neighbours share the instant between them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import toy

from gaussray.capture.capture import Capture, View
from gaussray.reconstruct.data.segments import segments


HERE = Path(__file__)


def capture(times, held_out=()):
    """Two cameras that see each of the times, and a third that sees those held out."""
    seen = [(time, name, "train") for name in ("a", "b") for time in times]
    seen += [(time, "c", "test") for time in held_out]
    views = [
        View(toy.camera(time=time), HERE, None, None, name, split, time, "pinhole", None, "srgb")
        for time, name, split in seen
    ]
    every = [view.time for view in views]
    return Capture(HERE, views, {}, None, (min(every), max(every)), "normalised")


@pytest.mark.parametrize("most", [2, 3, 4, 5, 8])
@pytest.mark.parametrize("count", [2, 3, 9, 10, 16])
def test_segments_are_short_enough_even_and_share_an_instant(count, most):
    times = np.sort(np.random.default_rng(count).uniform(0, 1, count)).tolist()
    cut = segments(capture(times), most)
    instants = [sorted({view.time for view in part.views}) for part in cut]
    lengths = [len(own) for own in instants]
    assert max(lengths) <= most and max(lengths) - min(lengths) <= 1
    # As few as can be.
    assert (len(cut) - 1) * (most - 1) < max(count - 1, 1)
    for (one, before), (two, after) in zip(
        zip(cut, instants, strict=True), list(zip(cut, instants, strict=True))[1:], strict=False
    ):
        assert before[-1] == after[0] == one.time_range[1] == two.time_range[0]
    assert sorted({time for own in instants for time in own}) == times
    for part in cut:
        assert all(part.time_range[0] <= view.time <= part.time_range[1] for view in part.views)


@pytest.mark.parametrize("most", [0, 3, 7])
def test_a_capture_that_is_short_enough_is_one_segment_without_a_name(most):
    (part,) = segments(capture([0.0, 0.5, 1.0]), most)
    assert len(part.views) == 6 and part.time_range == (0.0, 1.0) and not part.name


def test_what_is_held_out_is_in_no_segment_but_inside_of_their_times():
    cut = segments(capture([0.2, 0.4, 0.6, 0.8], held_out=[0.1, 0.5, 1.0]), 3)
    assert [part.time_range for part in cut] == [(0.1, 0.6), (0.6, 1.0)]
    assert [part.name for part in cut] == ["segment 1 of 2", "segment 2 of 2"]
    assert all(view.split == "train" for part in cut for view in part.views)


def test_a_capture_without_training_views_is_left_to_those_who_say_so():
    views = [dataclasses.replace(view, split="test") for view in capture([0.0, 1.0]).views]
    (part,) = segments(Capture(HERE, views, {}, None, (0.0, 1.0), "normalised"), 2)
    assert not part.views
