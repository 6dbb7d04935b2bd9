"""Which pictures are left out, and which are told of only, because matches contradict poses."""

import itertools

import numpy as np
import pytest

from gaussray.prepare import contradictions
from gaussray.prepare.contradictions import DOUBTFUL, SURE, contradicted_pictures, strong_pairs
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.findings.pair_distances import PairDistance
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


@pytest.fixture
def named(monkeypatch):
    """Names the pictures that are told of, and those that are left out, of pairs of 200 matches.

    Args:
        distances: pixels of each pair of pictures, which are called with one letter.
        width: of all pictures.
    """

    def run(distances, width):
        files = sorted({file for pair in distances for file in pair})
        nothing, zeros = np.zeros(0, int), np.zeros(0)
        seen = Observations(nothing, nothing, nothing, np.zeros((0, 2)), zeros)
        model = SparseModel(files, np.zeros((len(files), 3, 4)), [], np.zeros((0, 3)), seen)
        pictures = {f: MatchingPicture(f, f, 0, (width, 480)) for f in files}
        matches = {tuple(pair): np.zeros((200, 2), int) for pair in distances}
        placement = Placement(model, pictures, {}, matches, frozenset(), known=False)
        found = {tuple(pair): PairDistance(200, value) for pair, value in distances.items()}
        monkeypatch.setattr(contradictions, "pair_distances", lambda _, chosen: {
            pair: found[pair] for pair in chosen})  # fmt: skip
        strong = strong_pairs(placement)
        told, left_out = (contradicted_pictures(placement, strong, x) for x in (DOUBTFUL, SURE))
        assert left_out.items() <= told.items()
        return "".join(told), "".join(left_out)

    return run


def pairs(names, good, odd, bad):
    """All pairs, of which those with one picture are farther off."""
    both = ("".join(pair) for pair in itertools.combinations(names, 2))
    return {pair: bad if odd in pair else good for pair in both}


def test_one_pair_tells_nothing(named):
    assert named({"ab": 0.1}, 1000) == ("", "")


def test_beside_a_near_duplicate_nothing_is_left_out(named):
    assert named({"ab": 0.3, "ac": 2.4, "bc": 2.4}, 2000) == ("c", "")
    assert named({"ab": 0.3, "ac": 240, "bc": 240}, 2000) == ("c", "")


def test_a_blurred_picture_is_not_left_out(named):
    assert named(pairs("abcdefghijk", 0.4, "k", 2.2), 2000) == ("k", "")


def test_a_pose_a_little_off_is_told_of(named):
    """As one of two cameras that drive, whose pictures are 1241 wide."""
    assert named(pairs("abcd", 0.04, "d", 2.3), 1241) == ("d", "")


@pytest.mark.parametrize(
    ("good", "bad", "told", "left_out"),
    [
        (0.1, 0.95, "", ""),
        (0.1, 1.05, "e", ""),
        (0.1, 2.95, "e", ""),
        (0.1, 3.05, "e", "e"),
        (1.0, 3.95, "", ""),
        (1.0, 4.05, "e", "e"),
    ],
)
def test_so_many_thousandths_and_times_the_others(named, good, bad, told, left_out):
    for width in (1000, 2500):
        scale = width / 1000
        found = named(pairs("abcde", good * scale, "e", bad * scale), width)
        assert found == (told, left_out)


def test_three_pairs_of_three_others_are_enough(named):
    bad = {"ad": 9.0, "bd": 9.0, "cd": 9.0}
    assert named({"ab": 0.1, "bc": 0.1, "ac": 0.1, **bad}, 1000) == ("d", "d")
    assert named({"ab": 0.1, "bc": 0.1, **bad}, 1000) == ("d", "")
