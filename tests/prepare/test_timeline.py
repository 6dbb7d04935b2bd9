"""Common timestamps, and the frame of each camera."""

import dataclasses
import pathlib

import numpy as np
import pytest

from gaussray.prepare.errors import PrepareError
from gaussray.prepare.findings.clocks import sync_findings
from gaussray.prepare.findings.numbered_frames import numbered_frames_findings
from gaussray.prepare.options import FramesOptions
from gaussray.prepare.sources import Source
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import (
    MOST_OF_ONE,
    common_timeline,
    moving_stride,
    of_one_rate,
    resampled,
    tell_assumed_rate,
    tell_numbers,
    thinned_timeline,
)


def video(name, rate, count):
    path = pathlib.Path(f"{name}.mp4")
    return Source(name, path, (), np.arange(count) / rate, ((64, 48),))


def sync(**offsets):
    zeros = dict.fromkeys(offsets, 0.0)
    return Sync("known", offsets, zeros, zeros)


def test_cameras_show_what_they_share():
    sources = [video("a", 10, 40), video("b", 10, 40)]
    line = common_timeline(sources, sync(a=0.0, b=1.0), FramesOptions())
    assert line.rate == pytest.approx(10) and len(line.times) == 30
    assert line.frames["a"][0] == 10 and line.frames["b"][0] == 0
    assert line.times == pytest.approx(np.arange(30) / 10)
    assert line.shifts["b"] == pytest.approx(0, abs=1e-9)


def test_a_part_of_a_frame_remains_as_a_shift():
    sources = [video("a", 10, 40), video("b", 10, 40)]
    line = common_timeline(sources, sync(a=0.0, b=0.93), FramesOptions())
    assert line.shifts["a"] == pytest.approx(0, abs=1e-9)
    assert line.shifts["b"] == pytest.approx(0.03, abs=1e-9) or line.shifts["b"] == pytest.approx(
        -0.07 + 0.1, abs=1e-9
    )


def test_the_lowest_rate_counts_and_shifts_stay_below_half_a_frame():
    sources = [video("a", 30, 90), video("b", 25, 75)]
    line = common_timeline(sources, sync(a=0.0, b=0.0), FramesOptions())
    assert line.rate == pytest.approx(25) and resampled(sources, line) == ["a"]
    assert not of_one_rate(sources) and of_one_rate(sources[:1])
    assert np.all(np.diff(line.frames["b"]) == 1)
    assert np.abs(line.shifts["a"]).max() <= 0.5 / 30 + 1e-9
    frames = line.frames["a"] / 30
    assert frames == pytest.approx(line.times + line.shifts["a"])


def test_a_rate_and_a_span_are_kept_to():
    sources = [video("a", 30, 90)]
    options = FramesOptions(rate=10.0, span=(0.5, 1.5))
    line = common_timeline(sources, sync(a=0.0), options)
    assert line.frames["a"].tolist() == list(range(15, 46, 3)) and line.times[0] == 0


@pytest.mark.parametrize(
    ("count", "span", "used"), [(200, (), 200), (823, (), 165), (823, (2, 8), 181)]
)
def test_of_a_long_video_that_is_alone_each_kth_frame_is_used(count, span, used):
    line = common_timeline([video("a", 30, count)], sync(a=0.0), FramesOptions(span=span))
    steps = np.unique(np.diff(line.frames["a"]))
    assert len(line.times) == used <= MOST_OF_ONE and len(steps) == 1
    assert line.shifts["a"] == pytest.approx(0, abs=1e-9)
    every = common_timeline([video("a", 30, count)], sync(a=0.0), FramesOptions(rate=30.0))
    both = common_timeline([video(n, 30, count) for n in "ab"], sync(a=0.0, b=0.0), FramesOptions())
    assert len(every.times) == len(both.times) == count
    # That is no reason to doubt it.
    found = sync_findings([video("a", 30, count)], sync(a=0.0), line)
    assert not any(one.level == "warn" for one in found)


@pytest.mark.parametrize(
    ("cameras", "still", "rate", "stride"),
    [(2, "", 0.0, 4), (2, "", 30.0, 1), (2, "a", 0.0, 2), (2, "ab", 0.0, 1), (3, "", 0.0, 5)],
)
def test_the_pictures_of_cameras_that_move_are_limited_together(cameras, still, rate, stride):
    sources = [video(name, 30, 312) for name in "abc"[:cameras]]
    offsets = sync(**{source.name: 0.0 for source in sources})
    options = FramesOptions(rate=rate)
    line = common_timeline(sources, offsets, options)
    assert moving_stride(sources, line, set(still), options) == stride
    thin = thinned_timeline(line, stride)
    assert thin.times == pytest.approx(np.arange(len(thin.times)) * stride / 30)
    assert thin.rate == pytest.approx(30 / stride)
    for source in sources:
        frames = thin.frames[source.name]
        assert source.times[frames] - thin.shifts[source.name] == pytest.approx(thin.times)
    moving = cameras - len(still)
    assert rate or len(thin.times) * moving <= MOST_OF_ONE


def test_pictures_that_the_user_has_chosen_are_all_used():
    pictures = tuple(pathlib.Path(f"{i}.png") for i in range(300))
    folders = [Source(n, pathlib.Path(n), pictures, np.zeros(0), ((64, 48),)) for n in "ab"]
    line = common_timeline(folders, sync(a=0.0, b=0.0), FramesOptions())
    assert moving_stride(folders, line, set(), FramesOptions()) == 1


def test_videos_that_share_no_time_are_refused():
    sources = [video("a", 10, 20), video("b", 10, 20)]
    with pytest.raises(PrepareError, match="must overlap in time"):
        common_timeline(sources, sync(a=0.0, b=5.0), FramesOptions())
    with pytest.raises(PrepareError, match="frames.span"):
        common_timeline(sources, sync(a=0.0, b=0.0), FramesOptions(span=(7.0, 8.0)))


def folder(name, numbers):
    pictures = tuple(pathlib.Path(f"{name}/{n:06d}.jpg") for n in numbers)
    return Source(name, pathlib.Path(name), pictures, np.zeros(0), ((64, 48),))


def together(sources):
    zeros = dict.fromkeys((source.name for source in sources), 0.0)
    return Sync("none", zeros, zeros, zeros)


def test_pictures_of_one_number_have_one_time(capsys):
    sources = [folder("a", range(10)), folder("b", [2, 3, 4, *range(7, 14)])]
    sources.append(folder("c", range(4, 14)))
    line = common_timeline(sources, together(sources), FramesOptions(rate=2.0))
    assert line.times == pytest.approx([0, 1.5, 2, 2.5]) and line.rate == 2
    assert {name: own.tolist() for name, own in line.frames.items()} == {
        "a": [4, 7, 8, 9], "b": [2, 3, 4, 5], "c": [0, 3, 4, 5]
    }  # fmt: skip
    assert all(not own.any() for own in line.shifts.values())
    part = common_timeline(sources, together(sources), FramesOptions(rate=2.0, span=(1.5, 2.0)))
    assert part.times == pytest.approx([0, 0.5]) and part.frames["c"].tolist() == [3, 4]
    tell_numbers(sources, part)
    said = capsys.readouterr().out
    assert "(a/000004.jpg with b/000004.jpg), of which all folders have 4. sync.offs" in said
    # Whoever gives offsets, gives the times of the first pictures.
    line = common_timeline(sources, sync(a=0.0, b=0.0, c=0.0), FramesOptions())
    assert line.frames["c"].tolist() == list(range(10))
    tell_numbers(sources, line)
    tell_numbers(sources[:1], common_timeline(sources[:1], together(sources), FramesOptions()))
    assert not capsys.readouterr().out


def test_folders_that_may_count_alike_are_paired_by_their_order():
    sources = [folder("a", range(10)), folder("b", range(1, 11))]
    line = common_timeline(sources, together(sources), FramesOptions())
    assert line.frames["a"].tolist() == line.frames["b"].tolist() == list(range(10))


def test_times_at_which_a_folder_beside_a_video_lacks_a_picture_are_left_out(capsys):
    sources = [video("v", 30, 10), folder("a", [0, 1, 2, 3, 6, 7, 8, 9]), folder("b", range(10))]
    line = common_timeline(sources, together(sources), FramesOptions())
    assert line.frames["v"].tolist() == line.frames["b"].tolist() == [0, 1, 2, 3, 6, 7, 8, 9]
    assert line.frames["a"].tolist() == list(range(8))
    assert all(own == pytest.approx(0, abs=1e-9) for own in line.shifts.values())
    (warned,) = numbered_frames_findings(sources, line)
    assert warned.text == (
        "pictures that are not used: 2 of b; all folders have 8 of the numbers in their names, and "
        "8 times are used"
    )
    # Offsets of zero would switch off the synchronisation of videos.
    tell_numbers(sources, line)
    assert capsys.readouterr().out.endswith("of which all folders have 8.\n")


def test_a_long_gap_beside_a_video_repeats_no_picture():
    lacking = [*range(1, 40), *range(61, 101)]
    sources = [folder("a", lacking), folder("b", range(1, 101)), video("v", 30, 100)]
    line = common_timeline(sources, together(sources), FramesOptions())
    assert line.frames["a"].tolist() == list(range(79))
    assert all(np.abs(own).max() <= 0.5 / 30 + 1e-9 for own in line.shifts.values())
    assert "not used: 21 of b;" in numbered_frames_findings(sources, line)[0].text


def test_that_one_folder_begins_with_zero_and_another_with_one_is_told_though_numbers_count():
    sources = [folder("a", [*range(50), *range(51, 100)]), folder("b", range(1, 101))]
    line = common_timeline(sources, together(sources), FramesOptions())
    assert line.frames["a"][0] == 1 and line.frames["b"][0] == 0
    doubt, unused = numbered_frames_findings(sources, line)
    assert doubt.text.endswith("another with 1: a begins with 000000 and b with 000001")
    assert "1 of a, 2 of b" in unused.text
    given = common_timeline(sources, sync(a=0.0, b=0.0), FramesOptions())
    assert not any("begins" in one.text for one in numbered_frames_findings(sources, given))


def test_the_first_timestamp_is_none_before_a_late_camera():
    sources = [video("a", 25, 100), video("b", 25, 80)]
    line = common_timeline(sources, sync(a=0.0, b=0.74), FramesOptions(rate=2.0))
    assert line.frames["b"][0] == 0
    for name in "ab":
        assert np.abs(line.shifts[name]).max() <= 0.5 / 25 + 1e-9


@pytest.mark.parametrize("rate", [0.0, 10.0, 25.0])
def test_a_camera_of_a_lower_rate_than_the_timestamps_shows_its_nearest_frames(rate):
    sources = [video("a", 25, 50), video("b", 5, 10)]
    line = common_timeline(sources, sync(a=0.0, b=0.14), FramesOptions(rate=rate))
    assert np.abs(line.shifts["b"]).max() <= 0.5 / 5 + 1e-9
    assert np.abs(line.shifts["a"]).max() <= 0.5 / 25 + 1e-9
    assert set(line.frames["b"].tolist()) == set(range(10))


def test_one_folder_of_pictures_has_no_time():
    pictures = tuple(pathlib.Path(f"{i}.png") for i in range(5))
    source = Source("photos", pathlib.Path("photos"), pictures, np.zeros(0), ((64, 48),))
    line = common_timeline([source], sync(photos=0.0), FramesOptions())
    assert line.is_static and line.frames["photos"].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("options", "count", "told"),
    [(FramesOptions(), 5, True), (FramesOptions(rate=10.0), 5, False), (FramesOptions(), 1, False)],
)
def test_the_rate_of_folders_of_pictures_is_told_to_be_assumed(options, count, told, capsys):
    pictures = tuple(pathlib.Path(f"{i}.png") for i in range(count))
    sources = [Source(n, pathlib.Path(n), pictures, np.zeros(0), ((64, 48),)) for n in "ab"]
    tell_assumed_rate(sources, common_timeline(sources, sync(a=0.0, b=0.0), options), options)
    said = "a, b: folders of pictures without a frame rate: 30 a second are assumed"
    assert capsys.readouterr().out.startswith(said) == told


def test_a_folder_alone_is_photographs_and_a_line_says_how_to_say_otherwise(capsys):
    source = folder("a", range(1, 16))
    line = common_timeline([source], together([source]), FramesOptions())
    assert line.is_static and len(line.times) == 15 and not line.times.any()
    tell_assumed_rate([source], line, FramesOptions())
    said = capsys.readouterr().out
    assert (
        "15 pictures are taken as photographs of a scene that stands still. Their names (000"
        in said
    )
    assert "as those of frames do. If these are frames of a video, give frames.rate=30:" in said
    # Without such names the line is shorter.
    source = folder("a", [1, 2, 7])
    line = common_timeline([source], together([source]), FramesOptions())
    tell_assumed_rate([source], line, FramesOptions())
    assert "stands still. If these are frames of a video" in capsys.readouterr().out
    with pytest.raises(
        PrepareError, match=r"frames.span must be \[\] for photographs .* got \[0.0, 1"
    ):
        common_timeline([source], together([source]), FramesOptions(span=(0.0, 1.0)))


@pytest.mark.parametrize(
    ("numbers", "told"),
    [(range(1, 16), "25 a second.\n"), ([1, 2, 7], "names counts, and not the ")],
)
def test_a_rate_makes_the_only_folder_a_camera_with_times(capsys, numbers, told):
    source, options = folder("a", numbers), FramesOptions(rate=25.0)
    line = common_timeline([source], together([source]), options)
    count = len(numbers)
    assert not line.is_static and line.rate == 25
    assert line.times == pytest.approx(np.arange(count) / 25)
    assert line.frames["a"].tolist() == list(range(count)) and not line.shifts["a"].any()
    assert moving_stride([source], line, set(), options) == 1
    assert not numbered_frames_findings([source], line)
    tell_assumed_rate([source], line, options)
    assert told in capsys.readouterr().out
    part = FramesOptions(rate=25.0, span=(0.04, 0.08))
    assert common_timeline([source], together([source]), part).frames["a"].tolist() == [1, 2]


def test_frames_of_several_sizes_are_refused():
    source = dataclasses.replace(folder("a", range(2)), sizes=((64, 48), (48, 64)))
    line = common_timeline([source], together([source]), FramesOptions())
    assert line.is_static
    with pytest.raises(PrepareError, match="must have one size, got 64 x 48 and 48 x 64"):
        common_timeline([source], together([source]), FramesOptions(rate=30.0))
