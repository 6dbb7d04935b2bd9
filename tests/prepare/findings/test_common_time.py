"""What is said of cameras that start late or stop early."""

import pathlib

import numpy as np
import pytest

from gaussray.prepare.findings.clocks import sync_findings
from gaussray.prepare.findings.common_time import common_time_findings
from gaussray.prepare.options import FramesOptions
from gaussray.prepare.sources import Source
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import common_timeline, thinned_timeline


def video(name, count, rate=10):
    path = pathlib.Path(f"{name}.mp4")
    return Source(name, path, (), np.arange(count) / rate, ((64, 48),))


def folder(name, count):
    pictures = tuple(pathlib.Path(f"{name}/{k:03d}.png") for k in range(count))
    return Source(name, pathlib.Path(name), pictures, np.zeros(0), ((64, 48),))


def found(sources, options=None, **late):
    """The findings about cameras of which some start so many seconds late."""
    zeros = dict.fromkeys((source.name for source in sources), 0.0)
    sync = Sync("known", zeros | late, zeros, zeros)
    line = common_timeline(sources, sync, options or FramesOptions())
    findings = common_time_findings(sources, line)
    # The other findings about the clocks come with them.
    told = sync_findings(sources, sync, line)
    assert all(one in told for one in findings)
    return findings


def test_a_video_that_stops_early_is_named_with_what_it_costs():
    (doubt,) = found([video("a", 48), video("b", 20), video("c", 48)])
    assert doubt.level == "warn" and doubt.subject == "sync"
    assert doubt.text == (
        "frames that are not used: 28 of the 48 of a, 28 of the 48 of c; b ends 2.80 s before most "
        "others"
    )
    assert doubt.remedy.startswith("Without b they are used: take it away; or give sync.offsets=")


def test_a_video_that_starts_late_is_named_also_beside_one_that_stops_early():
    sources = [video(name, 100) for name in "abcd"]
    (doubt,) = found(sources, b=3.0)
    assert doubt.text.endswith("30 of the 100 of d; b starts 3.00 s after most others")
    assert "30 of the 100 of b" in doubt.text  # which go on after the others
    (doubt,) = found([*sources, video("e", 80), video("f", 70)], b=3.0)
    assert doubt.text.endswith(
        "b starts 3.00 s after most others and e, f end up to 3.00 s before most others"
    )
    assert doubt.remedy.startswith("Start all cameras before, and stop them after,")


def test_of_two_videos_the_shorter_one_is_named():
    (doubt,) = found([video("a", 48), video("b", 20)])
    assert doubt.text == (
        "frames that are not used: 28 of the 48 of a; b ends 2.80 s before the other"
    )


@pytest.mark.parametrize(("short", "told"), [(91, False), (89, True)])
def test_a_tenth_of_the_time_of_most_cameras_may_be_left_out(short, told):
    assert bool(found([video("a", 100), video("b", short), video("c", 100)])) is told


def test_a_single_frame_of_a_few_is_not_missed():
    assert not found([video("a", 5), video("b", 4)])
    assert found([video("a", 5), video("b", 3)])


def test_half_of_the_cameras_are_most():
    (doubt,) = found([video("a", 40), video("b", 20), video("c", 20), video("d", 40)])
    assert doubt.text.endswith("b, c end up to 2.00 s before most others")
    # More that stop early are no exception, and one that goes on is not missed.
    assert not found([video("a", 40), video("b", 20), video("c", 20)])


def test_a_span_is_what_the_user_asks_for():
    sources = [video("a", 48), video("b", 20), video("c", 48)]
    assert not found(sources, FramesOptions(span=(0.0, 1.5)))
    (doubt,) = found(sources, FramesOptions(span=(0.0, 3.0)))
    assert "11 of the 31 of a" in doubt.text and "b ends 1.10 s before" in doubt.text


def test_videos_of_several_rates_and_folders_beside_them_count_by_their_times():
    assert not found([video("a", 90, 30), video("b", 75, 25), folder("c", 90)])
    (doubt,) = found([video("a", 90, 30), video("b", 75, 25), folder("c", 30)])
    assert doubt.text.endswith("50 of the 75 of b; c ends 1.99 s before most others")
    # Of folders alone, another finding tells the pictures that are not used.
    assert not found([folder("a", 9), folder("b", 5)])
    assert not found([video("a", 90)])


def test_timestamps_that_are_left_out_later_do_not_change_it():
    sources = [video("a", 48), video("b", 20), video("c", 48)]
    zeros = dict.fromkeys("abc", 0.0)
    line = common_timeline(sources, Sync("none", zeros, zeros, zeros), FramesOptions())
    few = thinned_timeline(line, 4)
    assert common_time_findings(sources, few) == common_time_findings(sources, line) != []


@pytest.mark.parametrize("late", ["b", "cd"])
def test_of_cameras_that_start_one_after_another_none_is_to_be_taken_away(late):
    names = "ab" if late == "b" else "abcd"
    (doubt,) = found([video(name, 60) for name in names], **dict.fromkeys(late, 2.0))
    assert "take" not in doubt.remedy and "sync.offsets=" in doubt.remedy


def test_frames_of_slow_folders_are_no_less_time():
    options = FramesOptions(rate=2)
    assert not found([video("a", 90, rate=30), folder("b", 6)], options)
