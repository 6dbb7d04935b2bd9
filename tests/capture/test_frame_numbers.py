"""Which pictures of several folders belong together, by the numbers in their names."""

from pathlib import Path

import pytest

from gaussray.capture.frame_numbers import frame_numbers


def folders(form="{:06d}.jpg", **numbers):
    return {name: [Path(form.format(n, name=name)) for n in own] for name, own in numbers.items()}


def test_pictures_of_one_number_belong_together():
    lacking = [n for n in range(2, 14) if n not in (5, 6)]
    found = frame_numbers(folders(a=range(10), b=lacking, c=range(4, 14), d=range(10)))
    assert found.common == [4, 7, 8, 9] and not found.is_order
    assert found.counts("c") == list(range(4, 14))
    assert found.places("a") == [4, 7, 8, 9] and found.places("b") == [2, 3, 4, 5]
    assert found.places("c") == [0, 3, 4, 5]


@pytest.mark.parametrize("form", ["{:06d}.jpg", "{name}1_{:d}.png", "take2_{:04d}_640x480.jpg"])
def test_numbers_that_all_pictures_have_are_of_no_picture(form):
    found = frame_numbers(folders(form, a=range(5), b=range(5)))
    assert found.common == [0, 1, 2, 3, 4] and found.is_order and not found.doubt


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


def test_every_second_number_has_times_as_far_apart_as_all():
    found = frame_numbers(folders(a=range(0, 20, 2), b=range(20)))
    assert found.common == list(range(0, 20, 2)) and found.counts("a") == list(range(10))
    assert found.places("b") == found.common and not found.is_order


def test_nanoseconds_are_times():
    times = [1403636579763555584 + 50_000_000 * n for n in range(10)]
    found = frame_numbers(folders("{}.png", a=times[:7] + times[8:], b=times))
    assert found.counts("a") == pytest.approx([0, 1, 2, 3, 4, 5, 6, 8, 9])


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


def test_numbers_that_begin_again_go_by_their_order():
    names = ["1_1", "1_2", "2_1", "2_2"]
    pictures = {k: [Path(f"{n}.png") for n in names] for k in "ab"}
    assert frame_numbers(pictures) == ([], {}, "")
    pictures["b"][1] = Path("1_3.png")
    assert frame_numbers(pictures).doubt == "at place 2 a has 1_2 and b 1_3"
