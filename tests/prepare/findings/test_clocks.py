"""What is said about the clocks of the cameras."""

import pathlib

import numpy as np
import pytest

from gaussray.prepare.findings.clocks import sync_findings
from gaussray.prepare.options import FramesOptions
from gaussray.prepare.sources import Source
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import common_timeline


def video(name, rate, count):
    path = pathlib.Path(f"{name}.mp4")
    return Source(name, path, (), np.arange(count) / rate, ((64, 48),))


def found(sources, method="known", disagreement=0.0, assumed=""):
    """The findings about cameras that start together; the last one disagrees so much with others,
    and some have no trusted offset."""
    names, last = [source.name for source in sources], sources[-1].name
    zeros = dict.fromkeys(names, 0.0)
    confidence = dict.fromkeys(names, 1.0) | {last: 0.5}
    sync = Sync(method, zeros, confidence, zeros | {last: disagreement}, frozenset(assumed))
    line = common_timeline(sources, sync, FramesOptions())
    return sync_findings(sources, sync, line)


def test_the_least_confidence_is_told_of_videos_that_are_synchronised():
    (good,) = found([video("a", 10, 40), video("b", 10, 40)], "audio")
    assert good.level == "good" and "by audio, confidence 0.50 or more" in good.text


@pytest.mark.parametrize(
    ("assumed", "text"),
    [
        ("c", "c: no trusted synchronisation by motion; taken to start with a"),
        ("abc", "no trusted synchronisation by motion; all videos are taken to start together"),
        # Sound links the others: the first of these starts with the first camera.
        ("a", "a: no trusted synchronisation by motion; taken to start with b"),
    ],
)
def test_videos_without_a_trusted_offset_start_with_one_that_has_it(assumed, text):
    (weak,) = found([video(name, 10, 40) for name in "abc"], "motion", assumed=assumed)
    assert weak.level == "warn" and weak.text == text


def test_offsets_that_are_given_need_no_confidence():
    pair = [video("a", 10, 40), video("b", 10, 40)]
    for method, text in (("none", "start together"), ("known", "offsets are given")):
        (good,) = found(pair, method)
        assert good.level == "good" and text in good.text
    assert found(pair[:1]) == []


def test_pairs_may_disagree_by_half_a_frame():
    pair = [video("a", 10, 40), video("b", 10, 40)]
    assert [finding.level for finding in found(pair, disagreement=0.049)] == ["good"]
    (_, doubt) = found(pair, disagreement=0.051)
    assert doubt.level == "warn" and "51 ms about b" in doubt.text


def test_cameras_of_a_higher_rate_show_their_nearest_frames():
    (_, doubt) = found([video("a", 30, 90), video("b", 25, 75)])
    assert doubt.level == "warn" and doubt.text.startswith("a show their nearest frames at 25 per")


def test_pictures_that_no_other_camera_has_a_time_for_are_told():
    def folder(name, count):
        pictures = tuple(pathlib.Path(f"{i}.png") for i in range(count))
        return Source(name, pathlib.Path(name), pictures, np.zeros(0), ((64, 48),))

    def warnings(*sources):
        return [finding.text for finding in found(sources) if finding.level == "warn"]

    (text,) = warnings(folder("tall", 9), folder("wide", 5))
    assert "not used: 4 of tall;" in text and "all of them have 5" in text
    assert not warnings(folder("tall", 5), folder("wide", 5))
    assert not warnings(folder("tall", 9))


def test_numbers_that_not_all_folders_have_are_told():
    def folder(name, *numbers):
        pictures = tuple(pathlib.Path(f"{n:03d}.png") for n in numbers)
        return Source(name, pathlib.Path(name), pictures, np.zeros(0), ((64, 48),))

    def warnings(*sources, method="none"):
        found_ = found(sources, method)
        return [finding.text for finding in found_ if finding.level == "warn"]

    some, late = folder("some", 0, 1, 2, 5, 6), folder("late", 2, 3, 4, 5, 6)
    (text,) = warnings(some, late)
    assert text == (
        "pictures that are not used: 2 of some, 2 of late; all folders have 3 of the numbers in "
        "their names"
    )
    assert not warnings(some, late, method="known")
    (text,) = warnings(folder("a", 0, 1, 2), folder("b", 1, 2, 3))
    assert text.endswith("may not be: a begins with 000 and b with 001")
