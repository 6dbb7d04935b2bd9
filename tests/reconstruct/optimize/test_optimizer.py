"""Every array learns at its own rate, and what is fixed does not move."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.corrections import no_corrections
from gaussray.reconstruct.data.sampler import TileErrorState
from gaussray.reconstruct.initialize.from_points import between, in_common_view, on_points
from gaussray.reconstruct.optimize import learning_rates, optimizer
from gaussray.reconstruct.optimize.checkpoint import load_checkpoint, save_checkpoint
from gaussray.reconstruct.optimize.free_space import FreeBalls
from gaussray.reconstruct.optimize.learning_rates import CaptureScale, OptimizerOptions
from gaussray.reconstruct.optimize.optimizer import Parameters, scene_of
from gaussray.reconstruct.optimize.state import begin_state
from gaussray.reconstruct.run_progress import KnownBodies, RunProgress, SavedSizes
from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.gaussians import unconstrain
from gaussray.scene.transient import unconstrain_transients


OPTIONS, EXTENT = OptimizerOptions(), 3.0
SCENE = ("static", "moving", "deformation")
FIXED = ("lower", "upper", "begin", "end")

rates, descend = eqx.filter_jit(learning_rates.rates), eqx.filter_jit(optimizer.descend)
with_costs_paid = eqx.filter_jit(optimizer.with_density_costs)


@pytest.fixture(scope="module")
def parameters():
    """Still and moving Gaussians, and a field that moves them."""
    scene = toy.scene()
    return Parameters(unconstrain(scene.static), unconstrain(scene.moving), scene.deformation)


def units(parameters):
    """Pixels at the Gaussians that lie ever farther apart, and an extent."""
    counts = {kind: len(free.mean) for kind, free in parameters.kinds.items()}
    return CaptureScale({kind: 0.1 * jnp.arange(1.0, n + 1) for kind, n in counts.items()}, EXTENT)


def rate_at(parameters, step, **changes):
    options, scale = OptimizerOptions(**changes), units(parameters)
    return rates(parameters, jnp.asarray(step), options=options, scale=scale, share=step / 100)


def test_the_means_learn_in_pixels(parameters):
    rate = rate_at(parameters, 0)
    for side in (rate.static, rate.moving):
        pixels = 0.1 * np.arange(1, len(side.mean) + 1)[:, None]
        np.testing.assert_allclose(side.mean, OPTIONS.mean * pixels, rtol=1e-6)
        np.testing.assert_allclose(side.quat, OPTIONS.quat, rtol=1e-6)
        np.testing.assert_allclose(side.log_scale, OPTIONS.scale, rtol=1e-6)
        np.testing.assert_allclose(side.logit_opacity, OPTIONS.opacity, rtol=1e-6)


def test_transient_gaussians_learn_faster_by_a_factor_but_not_when_and_how_they_move(parameters):
    free = unconstrain_transients(toy.transients(), 0.0)
    learning = Parameters(parameters.static, parameters.moving, None, transient=free)
    usual, fast = (rate_at(learning, 30, transient=factor) for factor in (1.0, 3.0))
    for name in ("mean", "quat", "log_scale", "logit_opacity", "harmonics"):
        before, after = (getattr(rate.transient, name) for rate in (usual, fast))
        np.testing.assert_allclose(after, 3 * np.asarray(before), rtol=1e-6)
    for name in ("velocity", "instant", "log_lifetime"):
        assert getattr(fast.transient, name) == getattr(usual.transient, name)
    assert eqx.tree_equal(fast.static, usual.static)


@pytest.mark.parametrize("mean", [1e-3, 1.6e-4])
def test_a_rate_of_means_in_extents_is_refused(mean):
    with pytest.raises(ValueError, match=r"optimizer\.mean must be 0 or at least 0\.002"):
        OptimizerOptions(mean=mean)
    assert OptimizerOptions(mean=0.0).mean == 0


def test_what_a_network_adds_to_means_is_learnt_in_proportion_to_the_extent(parameters):
    rate = rate_at(parameters, 0).deformation
    np.testing.assert_allclose([rate.mean[1].weight, rate.mean[1].bias], 3 * OPTIONS.mean_head)
    assert rate.mean[0].weight == rate.scale[1].weight == rate.trunk.bias == OPTIONS.network
    none = dataclasses.replace(parameters.deformation, mean=None)
    moved = rate_at(dataclasses.replace(parameters, deformation=none), 0).deformation
    assert moved.mean is None and moved.scale[1].bias == OPTIONS.network


def test_control_points_learn_in_pixels_if_they_began_at_rest(parameters):
    points = toy.control_points()
    moved = eqx.tree_at(lambda p: p.deformation, parameters, toy.deformation(control=points))
    tracked = rate_at(moved, 0).deformation.control
    np.testing.assert_allclose(tracked.path, OPTIONS.control_path * EXTENT, rtol=1e-6)
    np.testing.assert_allclose(tracked.turn, OPTIONS.control_turn, rtol=1e-6)

    pixels, scale = 0.1 * jnp.arange(1.0, 4), units(moved)
    scale = scale._replace(at_rest=pixels)
    rate = rates(moved, jnp.asarray(0), options=OPTIONS, scale=scale, share=0.0)
    found = rate.deformation.control
    path = OPTIONS.from_rest * np.asarray(pixels)
    np.testing.assert_allclose(np.ravel(found.path), path, rtol=1e-6)
    # What is one width away from the pivot moves by a quarter of that.
    np.testing.assert_allclose(np.ravel(found.turn) * points.radius, path / 4, rtol=1e-6)
    for name in ("pivot", "radius", "time"):
        assert not np.any(getattr(found, name))


def test_before_anything_moves_all_gaussians_learn_alike(parameters):
    rate = rate_at(Parameters(parameters.static, parameters.moving, None), 0)
    for side in (rate.static, rate.moving):
        np.testing.assert_allclose(side.quat, OPTIONS.quat, rtol=1e-6)


def test_a_stage_ends_at_a_share_of_every_rate(parameters):
    first, last = rate_at(parameters, 0), rate_at(parameters, 100, decay=0.01)
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(last), strict=True):
        np.testing.assert_allclose(b, 0.01 * np.asarray(a), rtol=1e-5)


def test_colour_learns_faster_than_the_other_harmonics(parameters):
    harmonics = jnp.zeros((parameters.static.mean.shape[0], 4, 3))
    static = type(parameters.static)(**(vars(parameters.static) | {"harmonics": harmonics}))
    rate = rate_at(Parameters(static, parameters.moving, None), 0).static.harmonics
    expected = [OPTIONS.color] + [OPTIONS.harmonics] * 3
    np.testing.assert_allclose(np.ravel(rate), expected, rtol=1e-6)


def test_harmonics_of_the_next_degree_begin_to_learn_after_so_many_steps(parameters):
    harmonics = jnp.zeros((parameters.static.mean.shape[0], 16, 3))
    static = type(parameters.static)(**(vars(parameters.static) | {"harmonics": harmonics}))
    learning = Parameters(static, parameters.moving, None)
    for step, degree in ((0, 0), (9, 0), (10, 1), (25, 2), (30, 3), (99, 3)):
        found = rates(
            learning,
            jnp.asarray(step),
            options=OPTIONS,
            scale=units(learning),
            share=step / 100,
            degree_interval=10,
        ).static.harmonics
        assert np.count_nonzero(np.ravel(found)) == (degree + 1) ** 2


def test_bounds_and_pivots_never_move_and_everything_else_does(parameters):
    ones = jax.tree.map(jnp.ones_like, parameters)
    moved, _ = descend(
        parameters, ones, begin_state(parameters).adam, rate_at(parameters, 0)
    )  # fmt: skip
    before, after = parameters.deformation, moved.deformation
    for name in FIXED:
        np.testing.assert_array_equal(getattr(after.planes, name), getattr(before.planes, name))
    for name in ("pivot", "radius", "time"):
        np.testing.assert_array_equal(getattr(after.bodies, name), getattr(before.bodies, name))
    still = [
        path
        for (path, a), b in zip(
            jax.tree_util.tree_leaves_with_path(parameters), jax.tree.leaves(moved), strict=True
        )
        if not (np.asarray(a) != np.asarray(b)).all()
    ]
    assert len(still) == len(FIXED) + 3
    # Adam's first step is one rate long.
    np.testing.assert_allclose(
        after.trunk.bias, before.trunk.bias - OPTIONS.network, rtol=1e-4, atol=1e-7
    )
    np.testing.assert_allclose(
        moved.static.mean,
        parameters.static.mean - OPTIONS.mean * units(parameters).spacing["static"][:, None],
        rtol=1e-4,
        atol=1e-6,
    )
    for a, b in zip(jax.tree.leaves(parameters), jax.tree.leaves(moved), strict=True):
        assert a.dtype == b.dtype


def test_a_scene_holds_physical_values(parameters):
    scene, expected = scene_of(parameters, *toy.single([[0, 1], [0, 1]])), toy.scene()
    np.testing.assert_allclose(scene.static.scale, expected.static.scale, rtol=1e-5)
    np.testing.assert_allclose(scene.moving.opacity, expected.moving.opacity, rtol=1e-5)


def test_cameras_learn_what_is_named_and_nothing_else(parameters):
    corrections = no_corrections(("pose", "shutter", "exposure"), 3, toy.rolling(toy.camera()))
    kept = Parameters(parameters.static, parameters.moving, parameters.deformation, corrections)
    rate = eqx.filter_jit(learning_rates.rates)(
        kept,
        jnp.asarray(50),
        options=OPTIONS,
        scale=units(parameters),
        share=0.5,
        refine=("pose", "exposure"),
    ).corrections
    assert (rate.pose, rate.shutter, rate.exposure) == pytest.approx(
        (OPTIONS.pose, 0, OPTIONS.exposure), rel=1e-6
    )
    assert rate.lens is None and rate.offset is None


@pytest.mark.parametrize("kind", ["moves", "stands", "refines"])
def test_a_checkpoint_gives_back_the_same_bits(parameters, tmp_path, kind):
    kept = parameters if kind == "moves" else Parameters(parameters.static, parameters.moving, None)
    if kind == "refines":
        corrections = no_corrections(("lens", "shutter", "offset"), 3, toy.rolling(toy.camera()))
        kept = Parameters(*(getattr(parameters, n) for n in SCENE), corrections)
    state = begin_state(kept)
    dice = np.random.default_rng(0)
    noise = lambda x: jnp.asarray(dice.integers(1, 99, x.shape).astype(x.dtype) / 7, x.dtype)  # noqa: E731
    state = jax.tree.map(noise, state)
    drawn = np.int32([[0, 1], [0, 0]]), np.float32([0.1, 0.2])
    progress = RunProgress(
        stage="fine",
        segment=2,
        segments=3,
        initial=(2, 1),
        limit=(3, 4),
        most=7,
        bodies=KnownBodies(np.float32([[1, 2, 3]]), np.float32([0.5])),
        sizes=SavedSizes("fine", 2, 1, (8, 16, 4)),
        tile_errors=TileErrorState(np.float32([[0.5, np.nan]]), *drawn),
        metrics_bytes=99,
        free_space=FreeBalls(np.float32([[1, 2, 3], [4, 5, 6]]), np.float32([0.5, 0.25])),
    )
    saved = state, progress
    save_checkpoint(tmp_path / "checkpoint.npz", *saved)
    found = load_checkpoint(tmp_path / "checkpoint.npz")
    assert jax.tree.structure(found) == jax.tree.structure(saved)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(saved), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


def test_statistics_of_a_checkpoint_with_the_earlier_names_are_read(parameters, tmp_path):
    path = tmp_path / "checkpoint.npz"
    state = begin_state(parameters)
    rows = len(state.static_statistic.seen)
    seen = jnp.arange(rows, dtype=state.static_statistic.seen.dtype)
    state = eqx.tree_at(lambda s: s.static_statistic.seen, state, seen)
    save_checkpoint(path, state, RunProgress())
    header, array = read_arrays(path, "gaussray-checkpoint", 2)
    write_arrays(path, header, {k.replace("_statistic.", "_pull."): x for k, x in array.items()})
    found, _ = load_checkpoint(path)
    np.testing.assert_array_equal(found.static_statistic.seen, seen)


@pytest.mark.parametrize(
    ("key", "value"),
    [("stage", "middle"), ("segment", 0), ("limit", [1]), ("given", [-1, 2]), ("most", "9")],
)
def test_a_checkpoint_with_a_wrong_progress_is_refused(parameters, tmp_path, key, value):
    path = tmp_path / "checkpoint.npz"
    save_checkpoint(path, begin_state(parameters), RunProgress())
    header, array = read_arrays(path, "gaussray-checkpoint", 2)
    header["info"][key] = value
    write_arrays(path, header, array)
    with pytest.raises(ValueError, match="the file is damaged. Start again without resume=true"):
        load_checkpoint(path)


def test_a_checkpoint_with_a_free_space_that_cannot_be_is_refused(parameters, tmp_path):
    path = tmp_path / "checkpoint.npz"
    space = FreeBalls(np.zeros((2, 3), np.float32), np.ones(2, np.float32))
    save_checkpoint(path, begin_state(parameters), RunProgress(free_space=space))
    header, array = read_arrays(path, "gaussray-checkpoint", 2)
    write_arrays(path, header, array | {"note.free_space.radius": np.ones(3, np.float32)})
    with pytest.raises(ValueError, match="three coordinates .* the file is damaged"):
        load_checkpoint(path)
    del array["note.free_space.radius"]
    write_arrays(path, header, array)
    with pytest.raises(ValueError, match="'note.free_space.radius' is missing"):
        load_checkpoint(path)


@pytest.mark.parametrize("name", ["step", "adam.mu.static.mean", "parameters.moving.quat"])
def test_a_checkpoint_without_an_array_is_refused(parameters, tmp_path, name):
    path = tmp_path / "checkpoint.npz"
    save_checkpoint(path, begin_state(parameters), RunProgress())
    header, array = read_arrays(path, "gaussray-checkpoint", 2)
    del array[name]
    write_arrays(path, header, array)
    with pytest.raises(ValueError, match=f"'{name}' is missing"):
        load_checkpoint(path)


@pytest.mark.parametrize("count", [1, 2, 3, 30])
def test_any_number_of_points_is_a_start(count):
    position = np.random.default_rng(0).normal(size=(count, 3)).astype(np.float32)
    start = on_points(position, np.full((count, 3), 0.5, np.float32), degree=1, opacity=0.8)
    assert start.count == count and start.harmonics.shape == (count, 4, 3)
    assert (np.asarray(start.scale) > 0).all()
    for leaf in jax.tree.leaves(start):
        assert np.isfinite(leaf).all() and leaf.dtype == jnp.float32


def test_points_that_coincide_are_a_start_of_equal_gaussians():
    place, color = np.full((9, 3), 2.0, np.float32), np.full((9, 3), 0.25, np.float32)
    start = on_points(place, color, degree=0, opacity=0.8)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(start))
    assert (np.asarray(start.scale) > 0).all() and np.ptp(start.scale, axis=0).max() == 0
    np.testing.assert_array_equal(start.mean, place)
    np.testing.assert_allclose(start.opacity, 0.8, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(start.quat, axis=1), 1, rtol=1e-6)


def test_a_random_start_lies_where_all_cameras_look():
    origin = np.array([[0, 0, -3], [3, 0, 0], [0, 0, 3]], np.float32)
    center = np.array([0.1, 0.2, 0.3])
    direction = center - origin
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position, color = in_common_view(origin, direction.astype(np.float32), count=500, seed=1)
    np.testing.assert_allclose(position.mean(0), center, atol=0.3)
    assert np.linalg.norm(position - center, axis=1).max() < 3.2
    assert position.shape == color.shape == (500, 3)
    again, _ = in_common_view(origin, direction.astype(np.float32), count=500, seed=1)
    np.testing.assert_array_equal(position, again)


def test_points_between_points_lie_on_their_surface_in_the_colours_between():
    dice = np.random.default_rng(0)
    plane = dice.uniform(-1, 1, (40, 3)).astype(np.float32) * np.float32([1, 1, 0])
    slope = dice.uniform(0, 0.3, (3, 3)).astype(np.float32)
    place, color = between(plane, plane @ slope + 0.5, count=300, seed=2)
    assert place.shape == color.shape == (300, 3) and place.dtype == np.float32
    assert (place[:, 2] == 0).all() and np.abs(place).max() <= np.abs(plane).max()
    np.testing.assert_allclose(color, place @ slope + 0.5, atol=1e-6)
    # None is far from those that it lies between.
    gaps = np.linalg.norm(place[:, None] - plane[None], axis=-1).min(axis=1)
    widest = np.sort(np.linalg.norm(plane[:, None] - plane[None], axis=-1), axis=1)[:, 8].max()
    assert gaps.max() < widest
    again, _ = between(plane, plane, count=300, seed=2)
    np.testing.assert_array_equal(place, again)


@pytest.mark.parametrize("count", [1, 2])
def test_few_points_are_repeated(count):
    points = np.arange(3 * count, dtype=np.float32).reshape(count, 3)
    place, color = between(points, points, count=5, seed=0)
    assert all((points == x).all(axis=1).any() for x in place) and (place == color).all()
    assert between(points, points, count=0, seed=0)[0].shape == (0, 3)


def test_a_random_start_is_the_same_in_every_unit():
    origin = np.array([[0, 0, -3], [3, 0, 0], [0, 0, 3]])
    direction = np.float32(np.array([0.1, 0.2, 0.3]) - origin)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    expected, _ = in_common_view(np.float32(origin), direction, count=20, seed=1)
    for unit in np.exp2([-40, -20, 20, 40]):
        place, _ = in_common_view(np.float32(unit * origin), direction, count=20, seed=1)
        np.testing.assert_array_equal(place, np.float32(unit) * expected)
    at_once = np.zeros((3, 3), np.float32)
    place, _ = in_common_view(at_once, direction, count=20, seed=1)
    assert 0.1 < np.linalg.norm(place, axis=1).max() <= 1


def seen_by_pictures(parameters, second):
    """The state of Adam after one step in which the first Gaussian alone was seen."""
    adam = begin_state(parameters).adam
    first = jax.tree.map(lambda x: jnp.zeros_like(x).at[:1].set(second), parameters.static)
    nu = eqx.tree_at(lambda p: p.static, adam.nu, first)
    return adam._replace(count=jnp.asarray(1, jnp.int32), nu=nu)


@pytest.mark.parametrize(("slope", "share"), [(0.5, 0.25), (-0.5, -0.25), (50.0, 1.0)])
def test_costs_are_paid_by_the_size_of_the_pictures_gradient(parameters, slope, share):
    # A second moment of 0.001 x 4 after one step is a gradient of 2.
    parameters = Parameters(parameters.static, parameters.moving, None)
    gradient = jax.tree.map(lambda x: jnp.full_like(x, slope), parameters)
    rate, adam = rate_at(parameters, 0), seen_by_pictures(parameters, 4e-3)
    paid = with_costs_paid(parameters, gradient, adam, rate).static
    before = parameters.static
    np.testing.assert_allclose(
        paid.logit_opacity[0], before.logit_opacity[0] - OPTIONS.opacity * share, rtol=1e-3
    )
    np.testing.assert_allclose(
        paid.log_scale[0], before.log_scale[0] - OPTIONS.scale * share, rtol=1e-3
    )
    np.testing.assert_array_equal(paid.mean, before.mean)


def test_what_no_picture_has_shown_yet_pays_nothing(parameters):
    parameters = Parameters(parameters.static, parameters.moving, None)
    gradient = jax.tree.map(jnp.ones_like, parameters)
    adam = seen_by_pictures(parameters, 4e-3)
    paid = with_costs_paid(parameters, gradient, adam, rate_at(parameters, 0))
    for name in ("logit_opacity", "log_scale"):
        before, after = getattr(parameters.static, name), getattr(paid.static, name)
        np.testing.assert_array_equal(after[1:], before[1:])
        np.testing.assert_array_equal(getattr(paid.moving, name), getattr(parameters.moving, name))
