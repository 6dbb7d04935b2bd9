"""The terms of the loss, by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from skimage.metrics import structural_similarity

from gaussray.capture.temporal_median import MOTION_THRESHOLD, OUTLYING
from gaussray.geometry import multiply
from gaussray.reconstruct.data.tiles import tile_order
from gaussray.reconstruct.optimize import regularizer
from gaussray.reconstruct.optimize.loss import (
    LossOptions,
    developed,
    dssim,
    far_apart,
    l1,
    terms,
)
from gaussray.scene.control_points import ControlPoints
from gaussray.scene.planes import initial_planes


SIDE = 8

measured = jax.jit(dssim, static_argnames=("side", "bundle"))
roughness = jax.jit(regularizer.plane_terms)
stiffness = jax.jit(regularizer.rigid_term)


@pytest.fixture(scope="module")
def tiles():
    """Two pictures of three tiles."""
    dice = np.random.default_rng(0)
    return tuple(jnp.asarray(dice.uniform(size=(3 * SIDE**2, 3))) for _ in range(2))


def planes(**changes):
    lower, upper = jnp.zeros(3), jnp.ones(3)
    start = initial_planes(
        jax.random.key(0), lower, upper, (0.0, 1.0), sides=(3, 5), instants=4, channels=2
    )
    return type(start)(**(vars(start) | changes))


def test_l1_is_the_mean_absolute_difference():
    ours, truth = jnp.array([[1.0, 2, 3], [0, 0, 0]]), jnp.array([[0.0, 2, 5], [0, 0, 3]])
    assert l1(ours, truth) == 1.0


def test_an_excess_counts_only_where_the_file_could_have_held_it():
    encoded, truth = jnp.array([[1.5, 1.5, 0.2]]), jnp.array([[1.0, 0.5, 1.0]])
    np.testing.assert_array_equal(developed(encoded, truth), [[1.0, 1.5, 0.2]])


def test_pixels_are_far_apart_where_the_mean_difference_around_them_is_large():
    side, bundle = 16, 8
    dice = np.random.default_rng(1)
    apart = 0.02 * dice.normal(size=(2, side, side, 3))
    apart[:, 4:12, :9] += 0.4 * dice.normal(size=(2, 8, 9, 3)) + np.array([0.0, 0.08, 0.0])
    most = np.empty((2, side, side))
    for tile, row, column in np.ndindex(most.shape):
        rows, columns = (slice(max(k - 2, 0), k + 3) for k in (row, column))
        most[tile, row, column] = np.abs(apart[tile, rows, columns].mean(axis=(0, 1))).max()
    assert OUTLYING * np.median(most) > MOTION_THRESHOLD
    expected = most > OUTLYING * np.median(most)
    order = tile_order(side, bundle)
    flat = jnp.asarray(apart.reshape(2, -1, 3)[:, order].reshape(-1, 3))
    found = far_apart(flat, jnp.zeros_like(flat), side=side, bundle=bundle)
    assert 0.05 < expected.mean() < 0.5
    np.testing.assert_array_equal(found, expected.reshape(2, -1)[:, order].reshape(-1))


def test_no_pixel_is_far_apart_where_all_are():
    """A rendering that is wrong everywhere shows nothing of what moves."""
    side, odd = 16, np.zeros((1, 16, 16, 3), bool)
    odd[0, 3:9, 3:9] = True
    order = tile_order(side, None)

    def far(usual, moving):
        apart = np.where(odd, moving, usual)
        flat = jnp.asarray(apart.reshape(1, -1, 3)[:, order].reshape(-1, 3))
        return np.asarray(far_apart(flat, jnp.zeros_like(flat), side=side)).sum()

    assert far(0.01, 0.3) > 16 and far(0.04, 0.9) > 16
    assert far(0.15, 0.15) == far(0.15, 0.8) == 0


def test_dssim_of_equal_pictures_is_zero(tiles):
    np.testing.assert_allclose(measured(tiles[0], tiles[0], side=SIDE), 0, atol=1e-15)


def test_dssim_equals_the_formula_tile_by_tile(tiles):
    ours, truth = (np.asarray(x).reshape(3, SIDE * SIDE, 3) for x in tiles)
    place = np.arange(SIDE) - 3.5
    weight = np.exp(-(place[:, None] ** 2 + place[None] ** 2) / (2 * 1.5**2)).reshape(-1)
    weight /= weight.sum()
    values = []
    for a, b in zip(ours, truth, strict=True):
        for x, y in zip(a.T, b.T, strict=True):
            mx, my = weight @ x, weight @ y
            vx, vy = weight @ (x - mx) ** 2, weight @ (y - my) ** 2
            cov = weight @ ((x - mx) * (y - my))
            top = (2 * mx * my + 1e-4) * (2 * cov + 9e-4)
            values.append(1 - top / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    np.testing.assert_allclose(measured(*tiles, side=SIDE), np.mean(values), rtol=1e-12)


def test_dssim_has_the_derivative_of_finite_differences(tiles):
    check_grads(
        jax.jit(lambda x: dssim(jnp.asarray(x), tiles[1], side=SIDE)), (tiles[0],), order=1,
        modes=["rev"], atol=1e-6, rtol=1e-5,
    )  # fmt: skip


@pytest.mark.parametrize(("side", "bundle"), [(16, 16), (32, 8), (24, 8)])
def test_dssim_of_larger_tiles_is_the_mean_over_the_windows_inside_them(side, bundle):
    dice = np.random.default_rng(1)
    truth = dice.uniform(size=(2, side, side, 3))
    ours = np.clip(truth + 0.2 * dice.normal(size=truth.shape), 0, 1)
    # scikit-image blurs beyond the borders; windows that stay inside are 5 pixels away from them.
    options = {"channel_axis": 2, "data_range": 1, "gaussian_weights": True, "full": True}
    inside = slice(5, side - 5)
    maps = [
        structural_similarity(a, b, use_sample_covariance=False, **options)[1][inside, inside]
        for a, b in zip(ours, truth, strict=True)
    ]
    order = tile_order(side, bundle)
    ordered = [jnp.asarray(x.reshape(2, -1, 3)[:, order].reshape(-1, 3)) for x in (ours, truth)]
    found = measured(*ordered, side=side, bundle=bundle)
    np.testing.assert_allclose(found, 1 - np.mean(maps), rtol=1e-9)


def test_a_weight_of_zero_leaves_dssim_out(tiles):
    assert set(terms(*tiles, options=LossOptions(), side=SIDE)) == {"l1"}
    assert set(terms(*tiles, options=LossOptions(dssim=0.2), side=SIDE)) == {"l1", "dssim"}


def test_the_regulariser_of_constant_planes_is_zero():
    start = planes()
    flat = planes(space=tuple(jnp.full_like(x, 0.3) for x in start.space))
    assert {name: float(x) for name, x in roughness(flat).items()} == {
        "plane_variation": 0.0, "time_smoothness": 0.0, "time_planes_from_one": 0.0,
    }  # fmt: skip


def test_the_regularisers_by_hand():
    start = planes()
    space, time = [np.array(x) for x in start.space], [np.array(x) for x in start.time]
    space = [x * 0 for x in space]
    space[0][0, 1, 1, 0] = 3.0  # in the middle of 3 x 3: two differences each way
    time[0][1, 2, 0, 0] = 2.0  # row 2 of 4: second differences 1, -2
    found = roughness(planes(space=tuple(map(jnp.asarray, space)),
                                     time=tuple(map(jnp.asarray, time))))  # fmt: skip
    each_way = 2 * 3.0**2 / (3 * 2 * 3 * 2)
    np.testing.assert_allclose(found["plane_variation"], 2 * each_way, rtol=1e-12)
    np.testing.assert_allclose(found["time_smoothness"], (1 + 4) / (3 * 2 * 3 * 2), rtol=1e-12)
    np.testing.assert_allclose(found["time_planes_from_one"], 1 / (3 * 4 * 3 * 2), rtol=1e-12)


def test_two_instants_have_no_curvature():
    start = planes()
    found = roughness(planes(time=tuple(x[:, :2] for x in start.time)))
    assert found["time_smoothness"] == 0


@pytest.mark.parametrize(
    "name", ["l1", "dssim", "plane_variation", "time_smoothness", "time_planes_from_one"]
)
def test_a_negative_weight_is_named(name):
    with pytest.raises(ValueError, match=f"loss.{name} must be at least 0"):
        LossOptions(**{name: -0.1})


def test_dssim_keeps_its_digits_where_pictures_are_nearly_equal(tiles):
    truth = tiles[0].astype(jnp.float32)
    ours = truth + jnp.asarray(1e-4 * np.random.default_rng(2).normal(size=truth.shape), "float32")
    double = measured(ours.astype(float), truth.astype(float), side=SIDE)
    np.testing.assert_allclose(measured(ours, truth, side=SIDE), double, rtol=1e-4)


def control_points(count=9, instants=4, seed=0):
    """Control points with random poses at four times."""
    dice = np.random.default_rng(seed)
    return ControlPoints(
        pivot=jnp.asarray(dice.normal(size=(count, 3))),
        radius=jnp.ones(count),
        time=jnp.linspace(0.0, 1.0, instants),
        path=jnp.asarray(dice.normal(size=(count, instants, 3))),
        turn=jnp.asarray(dice.normal(size=(count, instants, 4))),
    )


def test_the_rigid_term_is_that_of_its_definition():
    control = control_points()
    pivot, path = np.asarray(control.pivot), np.asarray(control.path[:, 1])
    costs = []
    for i, turn in enumerate(np.asarray(control.turn[:, 1])):
        w, x, y, z = turn / np.linalg.norm(turn)
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        away = np.linalg.norm(pivot - pivot[i], axis=1)
        for j in np.argsort(away)[1:7]:
            arm = pivot[j] - pivot[i]
            off = np.linalg.norm(pivot[j] + path[j] - (pivot[i] + path[i] + rotation @ arm))
            costs.append(np.sqrt((off / away[j]) ** 2 + 0.01**2) - 0.01)
    # At the second timestamp the pose is the recorded one.
    assert stiffness(control, control.time[1]) == pytest.approx(np.mean(costs), rel=1e-9)


def test_what_moves_as_one_rigid_body_costs_nothing_and_gradients_are_right():
    control = control_points()
    angle = jnp.linspace(0.0, 2.0, 4)
    turn = jnp.stack([jnp.cos(angle), jnp.sin(angle), 0 * angle, 0 * angle], axis=-1)
    turn = jnp.broadcast_to(turn, control.turn.shape)
    arm = jnp.concatenate([jnp.zeros((9, 1)), control.pivot], axis=1)[:, None]
    inverse = turn * jnp.array([1.0, -1, -1, -1])[None, None]
    turned = multiply(multiply(turn, jnp.broadcast_to(arm, turn.shape)), inverse)[..., 1:]
    shift = jnp.linspace(0.0, 1.0, 4)[None, :, None]
    path = turned - control.pivot[:, None] + shift
    rigid = type(control)(control.pivot, control.radius, control.time, path, turn)
    for time in rigid.time:
        assert float(stiffness(rigid, time)) < 1e-12

    @jax.jit
    def cost(path, turn):
        moved = type(control)(control.pivot, control.radius, control.time, path, turn)
        return regularizer.rigid_term(moved, jnp.array(0.4))

    check_grads(cost, (control.path, control.turn), order=1, modes="rev")


def test_one_control_point_has_no_neighbour_to_hold_on_to():
    assert float(stiffness(control_points(1), jnp.array(0.5))) == 0
