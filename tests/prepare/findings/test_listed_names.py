"""Long lists of names tell that they are cut, and runs are ranges."""

import pytest

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.listed_names import listed_names, listed_pictures


FRAMES = [f"{k:05d}.jpg" for k in range(65)]
EVEN = "0, 2, 4, 6, 8, 10, 12, 14"


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        (range(28), "00000.jpg to 00027.jpg"),
        ([0, 1, 5, 6, 7], "00000.jpg, 00001.jpg, 00005.jpg to 00007.jpg"),
        ([3], "00003.jpg"),
    ],
)
def test_neighbours_are_a_range(numbers, told):
    assert listed_names([FRAMES[k] for k in numbers], FRAMES) == told


def test_what_is_not_told_is_counted():
    everyone = [str(k) for k in range(40)]
    assert listed_names(everyone[0:16:2], everyone) == EVEN
    assert listed_names(everyone[0:18:2], everyone) == f"{EVEN} and 1 other"
    assert listed_names([*everyone[0:16:2], *everyone[20:30]], everyone) == f"{EVEN} and 10 others"
    # Without an order nothing is a range.
    assert listed_names(everyone[:10]) == "0, 1, 2, 3, 4, 5, 6, 7 and 2 others"


def test_pictures_of_a_camera_are_a_range_and_cameras_are_not(placement_of):
    pictures = [MatchingPicture(f"{k}.png", "a", k, (4, 3)) for k in range(5)]
    assert listed_pictures(pictures[1:], placement_of(pictures)) == "a 1 to a 4"
    other = [MatchingPicture(f"b{k}.png", "b", k, (4, 3)) for k in range(3)]
    both = placement_of(pictures + other)
    assert listed_pictures(pictures[2:] + other[:2], both) == "a 2 to a 4, b 0, b 1"
    still = [MatchingPicture(f"{k}.png", f"c{k}", 0, (4, 3)) for k in range(4)]
    placement = placement_of(still, still=frozenset(p.camera for p in still))
    assert listed_pictures(still, placement) == "c0, c1, c2, c3"
