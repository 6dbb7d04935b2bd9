"""Non-rigid registration: rigid motions are found again, and one program serves all sizes."""

import jax
import numpy as np
import pytest

from gaussray.geometry import rotation_matrix, turning
from gaussray.reconstruct.initialize import nonrigid_registration
from gaussray.reconstruct.initialize.embedded_deformation import (
    carried,
    control_graph,
    embedded_points,
    registrable,
)
from gaussray.reconstruct.initialize.nonrigid_registration import (
    RegistrationOptions,
    padded_points,
    registered,
    registration_options,
)


OPTIONS = RegistrationOptions(control=60, source=900, target=900)
# Points of single precision, in gaps.
EXACT = 1e-3


def sheet(dice, count):
    """Places (in gaps) and colours of points of a sheet."""
    u = dice.random((count, 2))
    place = np.stack([30 * u[:, 0], 30 * u[:, 1], 3 * np.sin(4 * u[:, 0])], axis=1)
    color = [0.5 + 0.5 * np.sin(7 * u[:, 0]), u[:, 1], 0.5 + 0.5 * np.cos(9 * u[:, 1])]
    return place - [15, 15, 0], np.stack(color, axis=1)


def at_rest(graph):
    return graph.pivot, np.tile([1.0, 0, 0, 0], (len(graph.pivot), 1))


def motion_of(place, color, there, shade, options=OPTIONS):
    graph = control_graph(place, options.control)
    surface = embedded_points(place, color, graph, options.source)
    goal = padded_points(there, shade, options.target)
    return graph, registered(surface, graph, goal, at_rest(graph), options=options)


def test_a_rigid_motion_of_the_same_points_is_found_with_its_rotation():
    place, color = sheet(np.random.default_rng(1), 800)
    quat = turning(jax.numpy.asarray([0.1, -0.2, 0.3]))
    moved = place @ np.asarray(rotation_matrix(quat)).T + [4.0, -3, 2]
    graph, (where, turn) = motion_of(place, color, moved, color)
    np.testing.assert_allclose(carried(place, graph, where, turn), moved, atol=0.05)
    turn = turn[: graph.count] * np.sign(turn[: graph.count, :1])
    np.testing.assert_allclose(np.median(turn, axis=0), quat, atol=0.01)


def test_points_at_rest_stay():
    place, color = sheet(np.random.default_rng(1), 800)
    graph, (where, turn) = motion_of(place, color, place, color)
    np.testing.assert_allclose(where[: graph.count], graph.pivot[: graph.count], atol=EXACT)
    np.testing.assert_allclose(carried(place, graph, where, turn), place, atol=EXACT)


def test_missing_rows_have_no_effect():
    """More rows change neither places nor rotations, and stay where they are."""
    place, color = sheet(np.random.default_rng(1), 100)
    there, shade = sheet(np.random.default_rng(2), 100)
    few = RegistrationOptions(control=50, source=100, target=100)
    graph, (where, turn) = motion_of(place, color, there + 0.5, shade, few)
    wide, (places, turns) = motion_of(place, color, there + 0.5, shade)
    assert graph.count == wide.count == 50
    np.testing.assert_allclose(places[:50], where, atol=EXACT)
    np.testing.assert_allclose(turns[:50], turn, atol=EXACT)
    np.testing.assert_allclose(places[50:], wide.pivot[50:], rtol=1e-6)


def test_clouds_of_any_size_share_one_program():
    before = nonrigid_registration._registered._cache_size()
    # No other test has these options.
    options = RegistrationOptions(control=61, source=901, target=902)
    for count, other in ((800, 900), (64, 70), (300, 1000)):
        place, color = sheet(np.random.default_rng(1), count)
        there, shade = (x[:902] for x in sheet(np.random.default_rng(2), other))
        assert motion_of(place, color, there, shade, options)[1] is not None
    assert nonrigid_registration._registered._cache_size() == before + 1


def test_points_are_carried_by_the_control_points_rigidly():
    place, _ = sheet(np.random.default_rng(1), 400)
    graph = control_graph(place, 60)
    quat = turning(jax.numpy.asarray([0.5, 0.0, -1.0]))
    matrix = np.asarray(rotation_matrix(quat))
    turn = np.tile(np.asarray(quat), (60, 1))
    found = carried(place, graph, graph.pivot @ matrix.T + 5, turn)
    np.testing.assert_allclose(found, place @ matrix.T + 5, atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_all_of_a_few_points_are_used(count):
    place = np.random.default_rng(0).random((count, 3))
    rows = registrable(place, np.random.default_rng(1))
    assert sorted(rows.tolist()) == list(range(count))


def test_strays_are_left_out_and_of_many_points_a_share_is_used():
    place = np.random.default_rng(0).random((20000, 3))
    place[::1000] += 50 * np.arange(20)[:, None]
    rows = registrable(place, np.random.default_rng(1))
    assert 11900 < len(rows) <= 12000 and len(set(rows.tolist())) == len(rows)
    assert place[rows].max() < 2


def test_a_gpu_registers_more_points():
    assert registration_options("gpu").control > registration_options("cpu").control
    assert not jax.tree.leaves(OPTIONS)
