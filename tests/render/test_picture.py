"""Pictures as pure functions: equal to the renderer's, and their derivatives right."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from dense import dense_scene, frozen_picture

import gaussray
from gaussray.camera.camera import camera_rays
from gaussray.camera.film import pixel_grid
from gaussray.camera.sampling import sobol_samples
from gaussray.render.plan import picture_motion
from gaussray.tracer.motion import merge_rest


# Central differences in double precision of a smooth function.
DIFFERENCES, STEP = 2e-5, 1e-5
EXACT = 1e-10
TRACE = gaussray.TraceOptions(alpha_min=1e-9, transmittance_min=0.0, levels=0, group=2)
OPTIONS = gaussray.RenderOptions(samples=2, keys=3)


def moving_scene():
    """A few Gaussians, two of which move."""
    import toy

    scene = jax.tree.map(lambda x: x.astype(jnp.float64), toy.scene())
    few = jax.tree.map(lambda x: x[::6], scene.static)
    # Round Gaussians have no derivative by their rotation.
    few = dataclasses.replace(few, scale=few.scale * jnp.array([[1.0, 0.6, 1.5]]))
    return dataclasses.replace(scene, static=few)


def every_effect():
    """A camera all of whose numbers matter."""
    rolling = gaussray.rolling_shutter(0.2, rows=8, exposure=0.1)
    pull = gaussray.FocusPull([0.2, 0.8], [2.5, 3.5])
    camera = gaussray.Camera(
        gaussray.Film(8, 8, "box", 1.0),
        gaussray.KannalaBrandt(8.0, (4, 4), [0.02, -0.01, 0.005, 0.001], 1.4),
        gaussray.Aperture(0.05, pull, focus="sphere"),
        dataclasses.replace(rolling, trigger=jnp.asarray(0.01)),
        gaussray.orbit((0.3, -0.4, -3), up=(0, -1, 0), turns=0.02),
        0.45,
    )
    return double(camera)


def double(tree):
    """In double precision, so that the same programs take it: Python's numbers would be weak."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), tree)


def total(scene, camera, plan):
    """A smooth number of a picture that weighs every pixel differently."""
    seen = gaussray.render(scene, camera, plan=plan)
    weight = jnp.cos(jnp.arange(seen.color.size, dtype=float)).reshape(seen.color.shape)
    return jnp.sum(weight * seen.color) + jnp.sum(seen.alpha)


@pytest.fixture(scope="module")
def shot():
    """Scene, camera, plan, `total` as a function of both, and its gradient by both."""
    scene, camera = moving_scene(), every_effect()
    plan = gaussray.plan(scene, camera, options=OPTIONS, trace=TRACE)
    grad = eqx.filter_jit(eqx.filter_grad(lambda both: total(*both, plan)))
    return scene, camera, plan, lambda both: total(*both, plan), grad


@pytest.fixture(scope="module")
def slopes(shot):
    """The gradient of `total` by scene and camera."""
    scene, camera, _, _, grad = shot
    return grad((scene, camera))


@pytest.fixture(scope="module")
def dense():
    """Large Gaussians, a camera whose picture is higher than wide, and their plan."""
    camera = dataclasses.replace(every_effect(), film=gaussray.Film(8, 20, "box", 1.0))
    scene = dense_scene(12, seed=3)
    return scene, camera, gaussray.plan(scene, camera)


# Where the number lies in (scene, camera), and which element of it is moved.
PARAMETERS = {
    "Gaussians: centre": lambda both: both[0].static.mean,
    "Gaussians: size": lambda both: both[0].static.scale,
    "Gaussians: rotation": lambda both: both[0].static.quat,
    "Gaussians: opacity": lambda both: both[0].static.opacity,
    "Gaussians: colour": lambda both: both[0].static.harmonics,
    "field": lambda both: both[0].deformation.mean[1].weight,
    "lens: focal": lambda both: both[1].lens.focal,
    "lens: center": lambda both: both[1].lens.center,
    "lens: coefficients": lambda both: both[1].lens.coefficients,
    "aperture: radius": lambda both: both[1].aperture.radius,
    "aperture: focus": lambda both: both[1].aperture.focus_distance.distance,
    "shutter: row offset": lambda both: both[1].shutter.row_offset,
    "shutter: row step": lambda both: both[1].shutter.row_step,
    "shutter: exposure": lambda both: both[1].shutter.exposure,
    "shutter: trigger": lambda both: both[1].shutter.trigger,
    "pose: rotation": lambda both: both[1].trajectory.quat,
    "pose: place": lambda both: both[1].trajectory.translation,
    "time": lambda both: both[1].time,
}


@pytest.mark.ci
@pytest.mark.parametrize("name", PARAMETERS)
def test_a_derivative_is_that_of_finite_differences(shot, slopes, name):
    scene, camera, _, value, _ = shot
    where, both = PARAMETERS[name], (scene, camera)
    slope, x = np.asarray(where(slopes)), np.asarray(where(both))
    at = np.unravel_index(np.argmax(np.abs(slope)), slope.shape)

    def moved(step):
        there = x.copy()
        there[at] += step
        return float(value(eqx.tree_at(where, both, jnp.asarray(there))))

    found = (moved(STEP) - moved(-STEP)) / (2 * STEP)
    assert abs(found) > 1e-3
    np.testing.assert_allclose(slope[at], found, rtol=DIFFERENCES)


@pytest.mark.ci
def test_a_time_has_a_derivative_also_where_the_frame_is_an_instant(shot):
    scene, _, plan, value, grad = shot
    instant = dataclasses.replace(every_effect(), shutter=double(gaussray.Shutter(trigger=0.0)))
    own = gaussray.plan(scene, instant, options=OPTIONS, trace=TRACE)
    assert own.keys == plan.keys

    def filmed(step):
        shutter = double(gaussray.Shutter(0, step, trigger=0.0))
        return scene, dataclasses.replace(instant, shutter=shutter)

    found = (value(filmed(STEP)) - value(filmed(-STEP))) / (2 * STEP)
    slope = grad(filmed(0.0))[1].shutter.row_step
    np.testing.assert_allclose(slope, found, rtol=DIFFERENCES)


def test_the_picture_is_the_renderers_and_that_of_brute_force(shot):
    scene, camera, plan, _, _ = shot
    seen = gaussray.render(scene, camera, plan=plan)
    assert int(seen.dropped) == 0
    frame = gaussray.Renderer(scene, options=OPTIONS, trace=TRACE)(camera)
    np.testing.assert_allclose(seen.color, frame.color, atol=EXACT)
    pixel = pixel_grid(camera.film).reshape(-1, 2)

    @jax.jit
    def seen_by(scene, camera, u):
        middle = rays_at(jnp.full(5, 0.5)).time
        span = jnp.stack([jnp.min(middle), jnp.max(middle)]) + jnp.array([-0.05, 0.05])
        return merge_rest(picture_motion(scene, span, 3)), [rays_at(x) for x in u]

    def rays_at(u):
        return camera_rays(camera, pixel, jnp.broadcast_to(u, (len(pixel), 5)))

    motion, rays = seen_by(scene, camera, sobol_samples(OPTIONS.samples))
    truth = [reference.trace(motion, lines, alpha_min=1e-9)[0] for lines in rays]
    np.testing.assert_allclose(seen.color.reshape(-1, 3), np.mean(truth, axis=0), atol=EXACT)


@pytest.mark.ci
def test_rays_see_what_the_camera_sees(shot):
    scene, camera, _, _, _ = shot
    pixel = pixel_grid(camera.film).reshape(-1, 2)
    rays = jax.jit(camera_rays)(camera, pixel, jnp.full((len(pixel), 5), 0.5))
    rays = jax.tree.map(lambda x: x.reshape(8, 8, *x.shape[1:]), rays)
    seen = gaussray.render_rays(scene, rays, trace=TRACE)
    camera = dataclasses.replace(camera, film=gaussray.Film(8, 8, "center"))
    shutter = dataclasses.replace(camera.shutter, exposure=0.0)
    camera = dataclasses.replace(camera, shutter=shutter)
    single = dataclasses.replace(OPTIONS, samples=1, keys=0)
    picture = gaussray.render(scene, camera, options=single, trace=TRACE)
    np.testing.assert_allclose(seen.color, picture.color, atol=EXACT)
    np.testing.assert_allclose(seen.alpha, picture.alpha, atol=EXACT)


@pytest.mark.ci
def test_jit_and_vmap_change_nothing_and_need_a_plan_or_an_earlier_call(dense):
    scene, camera, _ = dense

    def at_time(time):
        return gaussray.render(scene, dataclasses.replace(camera, time=time)).color

    with pytest.raises(ValueError, match="gaussray.plan needs the numbers.*of numbers before"):
        jax.jit(at_time)(0.4)
    expected = np.stack([at_time(t) for t in (0.4, 0.6)])
    seen = jax.jit(jax.vmap(at_time))(jnp.array([0.4, 0.6]))
    np.testing.assert_allclose(seen, expected, atol=EXACT)


@pytest.mark.ci
def test_a_plan_that_is_too_small_says_so_and_can_be_enlarged(dense):
    scene, camera, plan = dense
    small = dataclasses.replace(plan, capacity=dataclasses.replace(plan.capacity, pairs=1, slots=1))
    cut = gaussray.render(scene, camera, plan=small)
    assert int(cut.dropped) > 0
    right = gaussray.render(scene, camera, plan=small.enlarged(cut.needed))
    assert int(right.dropped) == 0
    with pytest.raises(ValueError, match="options must be left out beside a plan"):
        gaussray.render(scene, camera, plan=plan, options=OPTIONS)


# Rays between key states of the toy scene, whose motion is smooth, in double precision.
BETWEEN_KEYS = 2e-3


@pytest.mark.ci
def test_a_picture_does_not_depend_on_those_before_it():
    """Key states follow from the times of a picture, not from those of one of the same shapes."""
    scene, options = moving_scene(), gaussray.RenderOptions(samples=1)
    camera = every_effect()
    still = dataclasses.replace(camera, shutter=double(gaussray.rolling_shutter(0.0, rows=8)))
    rolling = dataclasses.replace(camera, shutter=double(gaussray.rolling_shutter(0.9, rows=8)))
    first = gaussray.plan(scene, still, options=options, trace=TRACE)
    longer = gaussray.plan(scene, rolling, options=options, trace=TRACE)
    assert first.keys == 1 and longer.keys > 1
    right = gaussray.render(scene, rolling, plan=longer)
    gaussray.render(scene, still, options=options, trace=TRACE)
    again = gaussray.render(scene, rolling, options=options, trace=TRACE)
    np.testing.assert_allclose(again.color, right.color, atol=EXACT)
    # With the plan of a still one, it is told, inside jit as well.
    cut = jax.jit(lambda c: gaussray.render(scene, c, plan=first))(rolling)
    assert int(cut.dropped) >= longer.keys - 1 and int(cut.needed[-1]) == longer.keys
    assert np.abs(cut.color - right.color).max() > BETWEEN_KEYS
    plan, picture = first, cut
    while int(picture.dropped):
        plan = plan.enlarged(picture.needed)
        picture = gaussray.render(scene, rolling, plan=plan)
    np.testing.assert_allclose(picture.color, right.color, atol=EXACT)


def test_a_picture_in_strips_is_the_picture(dense):
    scene, camera, plan = dense
    strips = dataclasses.replace(plan, rows=8, capacity=dataclasses.replace(plan.capacity))
    whole, cut = (gaussray.render(scene, camera, plan=p) for p in (plan, strips))
    assert int(cut.dropped) == 0
    np.testing.assert_allclose(cut.color, whole.color, atol=EXACT)


def test_a_key_shifts_the_samples(dense):
    scene, camera, _ = dense
    one, two = (gaussray.render(scene, camera, key=jax.random.key(i)).color for i in (0, 1))
    assert 0 < np.abs(one - two).max() < 0.5


@pytest.mark.ci
def test_on_a_dense_scene_the_derivative_is_that_at_a_fixed_order_of_hits():
    """Colours jump where two Gaussians change places along a ray: that is what a finite difference
    of the picture sees beside the derivative, and all of it."""
    scene = dense_scene(60, seed=1)

    def camera(focal):
        return gaussray.Camera(
            gaussray.Film(16, 16, "center"),
            gaussray.Pinhole(focal, (8, 8)),
            trajectory=gaussray.look_at((0, -4, 1)),
        )

    single = gaussray.RenderOptions(samples=1)
    plan = gaussray.plan(scene, camera(24.0), options=single, trace=TRACE)

    @jax.jit
    @jax.value_and_grad
    def mean(focal):
        return jnp.mean(gaussray.render(scene, camera(focal), plan=plan).color)

    order = frozen_picture(scene, camera(24.0))
    fixed = (np.mean(order(camera(24 + STEP))) - np.mean(order(camera(24 - STEP)))) / (2 * STEP)
    _, slope = mean(24.0)
    np.testing.assert_allclose(slope, fixed, rtol=DIFFERENCES)
    wide = 0.05  # enough that hits change places
    free = (mean(24 + wide)[0] - mean(24 - wide)[0]) / (2 * wide)
    held = (np.mean(order(camera(24 + wide))) - np.mean(order(camera(24 - wide)))) / (2 * wide)
    np.testing.assert_allclose(held, slope, rtol=1e-2)
    assert abs(free - slope) > 0.02 * abs(slope)


def test_distance_is_in_scene_units_whatever_the_length_of_a_direction():
    scene = gaussray.Scene(gaussray.Gaussians.colored([0, 0, 3], [1, 0, 0], scale=0.1))
    direction = np.array([[0, 0, 1], [0, 0, 2.5], [0, 0, 1e-3], [0, 0, 0]])
    rays = gaussray.Rays(np.zeros((4, 3)), direction, np.zeros(4))
    seen = gaussray.render_rays(scene, rays)
    np.testing.assert_allclose(seen.depth, [3, 3, 3, 0], atol=1e-12)
    np.testing.assert_allclose(seen.alpha[:3], seen.alpha[0], atol=1e-12)
    assert seen.alpha[0] > 0.5 and seen.alpha[3] == 0


def test_what_only_the_renderer_does_is_refused(dense):
    scene, camera, _ = dense
    with pytest.raises(ValueError, match="options.chunk_rows must be 0 here"):
        gaussray.render(scene, camera, options=gaussray.RenderOptions(chunk_rows=1))
    with pytest.raises((ValueError, TypeError), match="Clip"):
        gaussray.plan(gaussray.Clip((scene,)), camera)  # type: ignore[arg-type]


def test_a_smaller_picture_lists_no_more_than_a_larger_one():
    """No side of the smaller one is a multiple of a bundle: its padding must not widen bounds."""
    place = np.random.default_rng(0).uniform(-1, 1, (400, 3))
    scene = gaussray.Scene(gaussray.Gaussians.colored(place, (1, 1, 1), scale=0.02, opacity=0.5))

    def pairs(side):
        camera = gaussray.Camera(
            gaussray.Film(side, side, "center"),
            gaussray.Pinhole(50.0, (20, 20)),
            trajectory=gaussray.look_at((0, -4, 1)),
        )
        options, trace = gaussray.RenderOptions(samples=1), gaussray.TraceOptions(levels=0)
        return gaussray.plan(scene, camera, options=options, trace=trace).capacity.pairs

    assert pairs(33) <= pairs(40)
