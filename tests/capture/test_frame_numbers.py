"""Which pictures of several folders belong together, by the numbers in their names."""

from pathlib import Path

import pytest

from gaussray.capture.frame_numbers import FrameNumbers, evenly_numbered, frame_numbers


def folders(form="{:06d}.jpg", **numbers):
    return {name: [Path(form.format(n, name=name)) for n in own] for name, own in numbers.items()}


def test_pictures_of_one_number_belong_together():
    lacking = [n for n in range(2, 14) if n not in (5, 6)]
    found = frame_numbers(folders(a=range(10), b=lacking, c=range(4, 14), d=range(10)))
    assert found.common == [4, 7, 8, 9] and found.open_question == ("", "")
    assert found.times["c"] == list(range(4, 14))
    assert found.places("a") == [4, 7, 8, 9] and found.places("b") == [2, 3, 4, 5]
    assert found.places("c") == [0, 3, 4, 5]


@pytest.mark.parametrize("form", ["{:06d}.jpg", "{name}1_{:d}.png", "take2_{:04d}_640x480.jpg"])
def test_numbers_that_all_pictures_have_are_of_no_picture(form):
    # Where no folder lacks a number, they say no more than the order.
    assert frame_numbers(folders(form, a=range(5), b=range(5))) == FrameNumbers()
    found = frame_numbers(folders(form, a=range(5), b=[0, 1, 3, 4]))
    assert found.common == [0, 1, 3, 4] and found.times["b"] == found.common


@pytest.mark.parametrize(
    ("b", "says"),
    [
        (range(1, 11), "a begins with 000000 and b with 000001"),
        # Frames of one video that two programs have written: the last one is missing.
        (range(1, 10), "a begins with 000000 and b with 000001"),
        (range(4, 14), "a begins with 000000 and b with 000004"),
        # Timestamps of clocks of their own.
        ([1700000000 + 33 * n for n in range(8)], "a begins with 000000 and b with 1700000000"),
        ([0, 1, 2, 23, 24, 25, 26, 27, 28, 29], "at place 4 a has 000003 and b 000023"),
    ],
)
def test_folders_that_may_count_alike_or_share_few_numbers_go_by_their_order(b, says):
    found = frame_numbers(folders(a=range(10), b=b))
    assert not found.common and found.doubt == says


def test_a_folder_that_counts_from_one_and_lacks_pictures_is_no_other_count():
    found = frame_numbers(folders(a=range(10), b=[1, 2, 3, 5, 6, 7, 8, 9, 10]))
    assert found.common == [1, 2, 3, 5, 6, 7, 8, 9]
    # But it may be one: that is told.
    assert found.doubt == "a begins with 000000 and b with 000001"
    assert "as one folder begins with 0 and another with 1" in found.open_question[0]
    found = frame_numbers(folders(a=[*range(50), *range(51, 100)], b=range(1, 101)))
    assert found.common and found.doubt


def test_times_are_places_among_the_numbers_of_all_folders():
    found = frame_numbers(folders(a=range(0, 20, 2), b=range(20)))
    assert found.common == list(range(0, 20, 2)) == found.times["a"] == found.places("b")
    third = frame_numbers(folders(a=range(90), b=range(0, 90, 3)))
    assert third.times["b"] == list(range(0, 90, 3))
    # Clocks count neither evenly nor in tens: 11:59:59 is followed by 12:00:00.
    clock = [115958, 115959, 120000, 120001]
    found = frame_numbers(folders(a=clock, b=[*clock[:1], *clock[2:]]))
    assert found.times == {"a": [0, 1, 2, 3], "b": [0, 2, 3]}
    milliseconds = [0, 33, 66, 86, 133, 166, 200]
    assert frame_numbers(folders(a=milliseconds, b=milliseconds)) == FrameNumbers()
    nanoseconds = [1403636579763555584 + 50_000_000 * n for n in range(10)]
    found = frame_numbers(folders("{}.png", a=nanoseconds[:7] + nanoseconds[8:], b=nanoseconds))
    assert found.times["a"] == [0, 1, 2, 3, 4, 5, 6, 8, 9]


@pytest.mark.parametrize(
    "names",
    [
        {"a": ["x", "y"], "b": ["x", "y"]},
        {"a": ["1", "2"]},
        {"a": ["7"], "b": ["8"]},
        {"a": ["1", "2"], "b": ["1_1", "2_2"]},
    ],
)
def test_names_that_tell_no_number_are_no_reason_to_doubt(names):
    found = frame_numbers({k: [Path(f"{n}.png") for n in own] for k, own in names.items()})
    assert not found.common and not found.doubt


def named(**names):
    return frame_numbers({k: [Path(f"{n}.png") for n in own] for k, own in names.items()})


def test_a_folder_without_pictures_has_no_numbers():
    assert frame_numbers(folders(a=range(5), b=[])) == FrameNumbers()
    assert frame_numbers(folders(a=[], b=[])) == FrameNumbers()


def test_a_single_picture_has_its_number_where_those_of_others_have_theirs():
    found = named(a=["frame_0001_720p", "frame_0002_720p"], b=["frame_0001_720p"])
    assert not found.doubt
    found = named(a=["1_720p", "2_720p", "3_720p"], b=["2_720p", "3_720p"], c=["3_720p"])
    assert found.doubt == "a begins with 1_720p and b with 2_720p"


def test_of_several_numbers_all_must_agree():
    same = ["1_1", "1_2", "2_1", "2_2"]
    assert named(a=same, b=same) == FrameNumbers()
    found = named(a=same, b=["1_1", "1_3", "2_1", "2_2"])
    assert found.common == [0, 3, 4] and found.doubt == "at place 2 a has 1_2 and b 1_3"
    assert found.times["b"] == [0, 2, 3, 4] and found.places("b") == [0, 2, 3]
    times = [f"{1690000000 + n // 10}.{n % 10}0" for n in range(30)]
    found = named(a=times[:5] + times[6:], b=times[1:4], c=times)
    assert found.common == [1, 2, 3] and not found.from_zero_and_one
    # One folder counts from 0, another from 1.
    assert not named(a=same, b=["1_2", "1_3", "2_2", "2_3"]).common
    assert not named(a=["2_1", "1_1"], b=["2_1", "1_1"]).common


@pytest.mark.parametrize(
    ("names", "even"),
    [
        (["frame_0001", "frame_0002", "frame_0003"], True),
        (["00000", "00005", "00010"], True),
        (["9_640x480", "10_640x480"], True),
        (["frame_0001", "frame_0002", "frame_0004"], False),
        (["a1", "b2", "c3"], False),
        (["20240101_120000", "20240102_120001"], False),
        (["front", "back"], False),
        (["0001"], False),
    ],
)
def test_names_of_frames_differ_by_one_step(names, even):
    assert evenly_numbered([Path(f"{name}.jpg") for name in names]) == even
