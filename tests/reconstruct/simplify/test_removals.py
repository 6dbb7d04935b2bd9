"""Removals: what costs at most the bound goes, and bisection finds as much as a full search."""

import math

import equinox as eqx
import numpy as np
import pytest
import toy

from gaussray.reconstruct.simplify.candidate import whole_candidate
from gaussray.reconstruct.simplify.candidate_meter import CandidateMeter
from gaussray.reconstruct.simplify.removals import BISECTIONS, Removals
from gaussray.reconstruct.simplify.summary import part_counts


BOUND, WHOLE = 0.1, 30.0


class Meter(CandidateMeter):
    """A PSNR that falls by so much with each Gaussian that is removed."""

    masked = False

    def __init__(self, cost):
        self.total, self.asked = np.concatenate([[0.0], np.cumsum(cost)]), 0

    def psnr(self, candidate, *, least):
        self.asked += 1
        lost = float(self.total[int((~np.asarray(candidate.kept)).sum())])
        return WHOLE - lost if WHOLE - lost >= least else -math.inf


@pytest.fixture(scope="module")
def candidate():
    return whole_candidate(toy.scene())


def without(candidate):
    def first(count):
        return eqx.tree_at(lambda c: c.kept, candidate, candidate.kept.at[:count].set(False))

    return first


def begun(candidate, cost, reports=None):
    meter = Meter(cost)
    note = (lambda *x: None) if reports is None else (lambda *x: reports.append(x))
    return meter, Removals(candidate, part_counts(candidate.scene), meter, BOUND, note)


def test_a_part_goes_if_it_costs_at_most_the_bound(candidate):
    for cost, removed in ((0.1 - 1e-9, True), (0.1 + 1e-9, False)):
        _, removals = begun(candidate, [cost])
        assert removals.remove("one", without(candidate)(1)) == removed
        assert removals.psnr == pytest.approx(WHOLE - cost * removed)
        assert bool(removals.candidate.kept[0]) != removed
        nothing, step = removals.steps
        assert nothing["taken"] and nothing["loss"] == 0
        assert (step["step"], step["taken"], step["loss"]) == ("one", removed, 0.1)
        assert step["gaussians"][0] - step["gaussians"][1] == 1


@pytest.mark.parametrize("seed", range(6))
def test_bisection_removes_as_many_as_a_search_of_all_numbers(candidate, seed):
    """Of fewer than a hundred things exactly as many."""
    count = len(candidate.kept)
    assert count < 100
    cost = np.random.default_rng(seed).exponential(10.0 ** (-seed / 2), count) / count
    meter, removals = begun(candidate, cost)
    removals.begin("prune")
    removals.remove_most("faint", count, without(candidate))
    expected = max(k for k in range(count + 1) if meter.total[k] <= BOUND)
    assert int((~np.asarray(removals.candidate.kept)).sum()) == expected
    assert meter.asked <= 1 + BISECTIONS


def test_progress_never_goes_back_and_a_part_that_is_over_counts_as_whole(candidate):
    reports = []
    _, removals = begun(candidate, [1.0] * len(candidate.kept), reports)
    removals.begin("prune")
    removals.remove("one", without(candidate)(1))
    removals.begin("shading")
    removals.remove("shading", without(candidate)(1))
    done = [report[0] for report in reports]
    assert done == [0, 1, 2, 1 + BISECTIONS + 1] and len({report[1] for report in reports}) == 1
    notes = ["measures the scene", "what does nothing", "one", "shading"]
    assert [report[2] for report in reports] == notes
