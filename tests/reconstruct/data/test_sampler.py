"""How tiles are drawn: spread out, where things move, where the error is, never where all is
masked."""

import numpy as np
import pytest

from gaussray.capture.errors import CaptureError
from gaussray.reconstruct.data.loader import GrowingWindow
from gaussray.reconstruct.data.sampler import Sampler, TileErrors


# Draws per test. Each stratum adds less than one draw to what a tile's share asks for.
DRAWS = 4000
SHARE = 2 / DRAWS
TIMES = np.array([0.0, 0.0, 1.0])


def sampler(balance, tiles=DRAWS, **options):
    """Two frames at time 0, of which in one a tile moves, and one at time 1, where nothing does."""
    moved = np.zeros((3, 5), np.uint16)
    moved[1, 3] = 16
    return Sampler(TIMES, moved, tiles=tiles, moving_share=balance, **options)


def shares(drawn, instant=0, steps=1, seed=0):
    """How often each tile is drawn, as a share of all draws."""
    frame, tile = drawn.draw(np.full(steps, instant), np.random.default_rng(seed))
    found = np.zeros((3, 5))
    np.add.at(found, (frame, tile), 1 / frame.size)
    return found


def two_cameras():
    """One camera took the first frame, another the other two."""
    return TileErrors(np.array([0, 1, 1]), 5)


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_the_share_drawn_where_things_move_is_the_balance_and_the_rest_is_even(balance):
    expected = np.zeros((3, 5))
    expected[:2] = (1 - balance) / 10
    expected[1, 3] += balance
    np.testing.assert_allclose(shares(sampler(balance)), expected, atol=SHARE)


def test_where_nothing_moves_draws_are_even():
    np.testing.assert_allclose(shares(sampler(1.0), instant=1)[2], 0.2, atol=SHARE)


def test_steps_of_many_instants_each_see_their_own():
    frame, tile = sampler(0.5, tiles=8).draw(np.array([1, 0, 1, 0]), np.random.default_rng(0))
    assert frame.shape == tile.shape == (4, 8)
    assert (frame[[0, 2]] == 2).all() and (frame[[1, 3]] < 2).all()


def test_a_few_draws_are_spread_and_right_on_average():
    # Tile (1, 3) has the share 0.5 + 0.05: 2.2 of 4 draws; every other one 0.2 of 4.
    few = sampler(0.5, tiles=4)
    frame, tile = few.draw(np.zeros(2000, int), np.random.default_rng(0))
    often = np.sum((frame == 1) & (tile == 3), axis=1)
    assert set(often) <= {1, 2, 3}
    # Four standard deviations of a mean of 2000 counts that differ by one at most.
    np.testing.assert_allclose(often.mean(), 2.2, atol=4 * 0.5 / 2000**0.5)
    # The first frame comes before: two strata at most reach into it.
    assert np.sum(frame == 0, axis=1).max() <= 2


def test_no_tile_is_drawn_twice_where_every_stratum_holds_whole_tiles():
    frame, tile = sampler(0.0, tiles=10).draw(np.zeros(20, int), np.random.default_rng(0))
    assert all(len(set(pairs)) == 10 for pairs in (5 * frame + tile).tolist())


def test_the_same_dice_draw_the_same_and_others_draw_others():
    instants = np.array([0, 1, 0])

    def draw(seed):
        return np.stack(sampler(0.5, tiles=3).draw(instants, np.random.default_rng(seed)))

    np.testing.assert_array_equal(draw(0), draw(0))
    assert (draw(0) != draw(1)).any()


def test_tiles_without_a_visible_pixel_are_never_drawn():
    visible = np.ones((3, 5), bool)
    visible[0, :4] = visible[2] = False
    errors = two_cameras()
    errors.note_errors(np.array([0]), np.array([1]), np.array([0.9]))
    errors.learn()
    masked = sampler(0.3, visible=visible, error=0.3, errors=errors)
    assert (shares(masked)[~visible] == 0).all()
    # The last instant shows nothing.
    np.testing.assert_array_equal(masked.instants, [0])
    with pytest.raises(CaptureError, match="the masks leave no pixel"):
        sampler(0.3, visible=np.zeros((3, 5), bool))


@pytest.mark.parametrize("balance", [0.5, 1.0])
def test_what_moves_in_a_tile_that_may_not_be_drawn_does_not_count(balance):
    """Held-out tiles have moving pixels; none of them may be learnt from."""
    visible = np.ones((3, 5), bool)
    visible[1, 3] = False
    expected = np.where(visible, 1 / 9, 0.0)
    expected[2] = 0
    np.testing.assert_allclose(shares(sampler(balance, visible=visible)), expected, atol=SHARE)


def test_a_share_is_drawn_in_proportion_to_the_errors():
    errors = two_cameras()
    frame, tile = (x.reshape(-1) for x in np.mgrid[:2, :5])
    told = np.arange(10) / 10
    errors.note_errors(frame, tile, told)
    errors.learn()
    expected = np.zeros((3, 5))
    expected[:2] = 0.6 * told.reshape(2, 5) / told.sum() + 0.4 * 0.5 / 10
    expected[1, 3] += 0.4 * 0.5
    found = shares(sampler(0.5, error=0.6, errors=errors))
    np.testing.assert_allclose(found, expected, atol=SHARE)


def test_what_was_never_drawn_counts_as_the_worst_and_cameras_share_their_instants():
    errors = two_cameras()
    assert (errors.of(np.array([0, 2])) == 1).all()
    errors.note_errors(np.array([[0, 1]]), np.array([[2, 4]]), np.array([[0.25, 0.5]]))
    assert (errors.of(np.array([0])) == 1).all()
    errors.learn()
    expected = np.full((3, 5), 0.5)
    expected[0, 2] = 0.25
    np.testing.assert_array_equal(errors.of(np.arange(3)), expected)


def test_errors_are_an_exponential_mean():
    errors, rate = two_cameras(), TileErrors.RATE
    for value in (0.8, 0.4):
        errors.note_errors(np.array([1]), np.array([0]), np.array([value]))
        errors.learn()
    errors.note_errors(np.array([2, 1]), np.array([0, 0]), np.array([0.2, 0.4]))
    errors.learn()
    mean = (1 - rate) * 0.8 + rate * 0.4
    mean = 0.3 + (1 - rate) ** 2 * (mean - 0.3)
    # Single precision.
    np.testing.assert_allclose(errors.of(np.array([1]))[0, 0], mean, rtol=1e-6)


def test_errors_are_kept_and_restored_with_what_was_told_last():
    errors, again = two_cameras(), two_cameras()
    errors.note_errors(np.array([0]), np.array([1]), np.array([0.5]))
    errors.learn()
    errors.note_errors(np.array([1]), np.array([1]), np.array([0.25]))
    again.restore(errors.state())
    np.testing.assert_array_equal(again.of(np.arange(3)), errors.of(np.arange(3)))
    errors.learn()
    again.learn()
    np.testing.assert_array_equal(again.of(np.arange(3)), errors.of(np.arange(3)))
    assert again.of(np.array([1]))[0, 1] == 0.25


@pytest.mark.parametrize("times", [np.linspace(0, 1, 101), np.linspace(-3, 9, 101)])
def test_the_window_grows_from_the_middle_to_both_ends(times):
    window = GrowingWindow((times[0] + times[-1]) / 2, 0.2, least=4, grown=0.6)
    first = window.among(times, "fine", 0, 0.0)
    np.testing.assert_array_equal(first, np.arange(40, 61))
    np.testing.assert_array_equal(first, window.among(times, "coarse", 90, 0.9))
    # Half of the way to 0.6 of the stage: half of the rest is seen.
    np.testing.assert_array_equal(window.among(times, "fine", 30, 0.3), np.arange(20, 81))
    for done in (60, 90, 200):
        assert len(window.among(times, "fine", done, done / 100)) == 101


def test_a_long_stage_sees_all_times_after_some_steps_for_each():
    times = np.linspace(0, 1, 101)
    window = GrowingWindow(0.5, 0.2, grown=0.6, steps_each=4)
    np.testing.assert_array_equal(window.among(times, "fine", 202, 0.0202), np.arange(20, 81))
    assert len(window.among(times, "fine", 404, 0.0404)) == 101


def test_a_window_that_begins_at_the_first_time_grows_to_the_last():
    window, times = GrowingWindow(0.0, 0.1, least=1, grown=1.0), np.linspace(0, 1, 11)
    np.testing.assert_array_equal(window.among(times, "fine", 0, 0.0), [0, 1])
    assert len(window.among(times, "fine", 11, 1.0)) == 11


def test_the_first_time_alone_is_a_window_of_the_coarse_stage():
    window, times = GrowingWindow(0.0), np.linspace(0, 1, 11)
    np.testing.assert_array_equal(window.among(times, "coarse", 7, 0.7), [0])
    assert len(window.among(times, "fine", 0, 0.0)) == 11


def test_a_window_holds_some_times_however_few_there_are():
    uneven = np.array([0.0, 0.1, 0.2, 0.3, 1.0])
    assert len(GrowingWindow(0.5, 0.0, least=3).among(uneven, "coarse", 0, 0.0)) >= 3
    assert len(GrowingWindow(0.5, 0.0, least=12).among(uneven, "coarse", 0, 0.0)) == 5
    assert len(GrowingWindow(0.5, 1.0).among(uneven, "coarse", 0, 0.0)) == 5
