"""The camera: its parts in order, one compilation for all values, gradients through all of it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.aperture import Aperture, no_aperture
from gaussray.camera.camera import Camera, camera_ray, camera_rays, project
from gaussray.camera.film import Film, pixel_grid
from gaussray.camera.lens import FisheyePolynomial, KannalaBrandt, pinhole
from gaussray.camera.sampling import sobol_samples
from gaussray.camera.shutter import Shutter, global_shutter
from gaussray.camera.trajectory import Trajectory, static_trajectory
from gaussray.geometry import BLENDER_AXES, RigidTransform, quaternion, rotation_matrix


WIDTH, HEIGHT = 12, 8
EXACT = 1e-12
# Finite differences of check_grads through all five parts.
GRADIENT = 1e-4
HALF = jnp.full(5, 0.5)


shoot = jax.jit(camera_rays)
shoot_one = jax.jit(camera_ray)
see = jax.jit(project)


def number(value):
    return jnp.array(float(value))


POSE = RigidTransform(jnp.array([0.9, 0.1, -0.3, 0.2]), jnp.array([1.0, -2.0, 0.5]))
LENSES = {
    "pinhole": pinhole(jnp.array([10.0, 11.0]), jnp.array([6.2, 3.9])),
    "polynomial": FisheyePolynomial(
        jnp.array([0.0, -0.06, -1e-4, 0.0, 0.0]),
        jnp.array([36.0, 24.0]),
        jnp.array([12.0, 8.0]),
        jnp.array([0.01, 0.02]),
        number(3.0),
    ),
    "kannala": KannalaBrandt(
        jnp.array([6.0, 6.1]), jnp.array([6.2, 3.9]), jnp.array([0.01, 0, 0, 0]), number(1.7)
    ),
}


def moving(speed=(1.0, 0.0, 0.0)):
    """World axes, passing the origin at time 0."""
    way = jnp.array(speed)
    quat = jnp.array([(1.0, 0, 0, 0), (1.0, 0, 0, 0)])
    return Trajectory(jnp.array([-10.0, 10.0]), quat, jnp.stack([-10 * way, 10 * way]))


def camera(name="pinhole", **parts):
    given = {
        "film": Film(WIDTH, HEIGHT, "box", 1.0),
        "lens": LENSES[name],
        "aperture": no_aperture(),
        "shutter": global_shutter(),
        "trajectory": static_trajectory(POSE),
        "time": number(0.0),
    }
    return Camera(**(given | parts))


def wide(radius=0.2, distance=2.0, focus="plane"):
    return Aperture(number(radius), number(distance), number(0), number(1), focus=focus)


def wide_for(lens):
    return wide(focus="plane" if lens == "pinhole" else "sphere")


@pytest.mark.parametrize("lens", LENSES)
def test_the_chief_ray_is_the_lens_seen_from_the_pose(lens):
    pixel = jnp.array([3.0, 5.0])
    ray = shoot_one(camera(lens), pixel, HALF)
    expected = rotation_matrix(POSE.quat) @ LENSES[lens].direction(pixel + 0.5)
    np.testing.assert_allclose(ray.direction, expected, atol=EXACT)
    np.testing.assert_allclose(ray.origin, POSE.translation, atol=EXACT)
    assert ray.time == 0


@pytest.mark.parametrize("lens", LENSES)
def test_a_point_on_a_pixels_ray_is_projected_to_the_pixels_centre(lens):
    pixels = pixel_grid(Film(WIDTH, HEIGHT)).reshape(-1, 2)
    rays = shoot(camera(lens), pixels, jnp.tile(HALF, (len(pixels), 1)))
    points = rays.origin + 3 * rays.direction
    back = jax.jit(jax.vmap(project, in_axes=(None, 0)))(camera(lens), points)
    lit = np.any(rays.direction != 0, axis=-1)
    np.testing.assert_allclose(np.array(back)[lit], np.array(pixels + 0.5)[lit], atol=1e-9)


def test_blenders_matrix_becomes_blenders_ray():
    """transform_matrix (camera to world, y up, looking down -z) and the ray of section a."""
    turn = rotation_matrix(jnp.array([0.3, -0.5, 0.1, 0.8]))
    pose = RigidTransform(quaternion(turn @ jnp.diag(jnp.array(BLENDER_AXES))), POSE.translation)
    ray = shoot_one(camera(trajectory=static_trajectory(pose)), jnp.array([2.0, 1.0]), HALF)
    blender = np.array([(2.5 - 6.2) / 10, -(1.5 - 3.9) / 11, -1])
    expected = np.array(turn) @ blender / np.linalg.norm(blender)
    np.testing.assert_allclose(ray.direction, expected, atol=EXACT)


def test_a_moving_camera_has_moved_on_at_every_row():
    rolling = Shutter(number(0.1), number(0.01), number(0.0))
    taken = camera(shutter=rolling, trajectory=moving((2.0, 0.0, -1.0)), time=number(0.5))
    rows = jnp.stack([jnp.full(HEIGHT, 4.0), jnp.arange(HEIGHT, dtype=float)], -1)
    rays = shoot(taken, rows, jnp.tile(HALF, (HEIGHT, 1)))
    times = 0.6 + 0.01 * np.arange(HEIGHT)
    np.testing.assert_allclose(rays.time, times, atol=EXACT)
    np.testing.assert_allclose(rays.origin, np.outer(times, (2, 0, -1)), atol=EXACT)


def test_all_film_samples_of_a_pixel_share_its_rows_time():
    rolling = Shutter(number(0.0), number(0.01), number(0.0))
    u = sobol_samples(32)
    pixel = jnp.broadcast_to(jnp.array([2.0, 6.0]), (32, 2))
    filtered = camera(shutter=rolling, film=Film(WIDTH, HEIGHT, "blackman_harris", 3.0))
    rays = shoot(filtered, pixel, u)
    np.testing.assert_allclose(rays.time, 0.06, atol=EXACT)
    assert np.ptp(rays.direction[:, 0]) > 0


def test_lens_samples_start_on_the_aperture_and_meet_in_focus():
    u = sobol_samples(32).at[:, :2].set(0.5)
    pixel = jnp.broadcast_to(jnp.array([2.0, 6.0]), (32, 2))
    rays = shoot(camera(aperture=wide()), pixel, u)
    into_camera = jax.vmap(POSE.inverse_apply)
    origin = into_camera(rays.origin)
    target = into_camera(rays.origin + rays.direction)
    np.testing.assert_allclose(origin[:, 2], 0, atol=EXACT)
    ahead = target - origin
    met = origin + ahead * 2.0 / ahead[:, 2:]
    np.testing.assert_allclose(met, np.broadcast_to(met[0], met.shape), atol=EXACT)
    assert np.linalg.norm(origin, axis=-1).max() > 0.15


def test_pixels_beyond_the_field_of_view_send_no_ray():
    narrow = eqx.tree_at(lambda lens: lens.fov, LENSES["polynomial"], number(0.5))
    taken = camera(aperture=wide(focus="sphere"))
    taken = eqx.tree_at(lambda c: c.lens, taken, narrow)
    ray = shoot_one(taken, jnp.array([0.0, 0.0]), HALF.at[2].set(0.9))
    np.testing.assert_array_equal(ray.direction, [0, 0, 0])
    assert np.isfinite(ray.origin).all()


def test_moving_camera_and_world_together_changes_nothing_in_the_camera():
    """A rigid motion of the pose moves the rays by it."""
    motion = RigidTransform(jnp.array([0.5, 0.5, -0.1, 0.7]), jnp.array([3.0, 1.0, -4.0]))
    turned = quaternion(rotation_matrix(motion.quat) @ rotation_matrix(POSE.quat))
    moved = static_trajectory(RigidTransform(turned, motion.apply(POSE.translation)))
    pixel, u = jnp.array([2.0, 6.0]), jnp.array([0.1, 0.8, 0.3, 0.9, 0.4])
    for lens in LENSES:
        before = shoot_one(camera(lens, aperture=wide_for(lens)), pixel, u)
        after = shoot_one(camera(lens, aperture=wide_for(lens), trajectory=moved), pixel, u)
        np.testing.assert_allclose(after.origin, motion.apply(before.origin), atol=1e-10)
        np.testing.assert_allclose(after.direction, motion.rotate(before.direction), atol=1e-10)


def test_one_compilation_serves_every_camera():
    traced = jax.jit(eqx.debug.assert_max_traces(camera_rays, max_traces=1))
    pixels = pixel_grid(Film(WIDTH, HEIGHT)).reshape(-1, 2)
    u = jnp.tile(HALF, (len(pixels), 1))
    for i in range(4):
        lens = pinhole(jnp.array([10.0 + i, 11.0]), jnp.array([6.0, 4.0 - i]))
        rolling = Shutter(number(i), number(0.01 * i), number(0.1 * i))
        traced(
            camera(
                lens=lens,
                aperture=wide(0.1 * i, 1 + i),
                shutter=rolling,
                trajectory=moving((1.0 * i, 0.0, 0.0)),
                time=number(i),
            ),
            pixels,
            u,
        )


def test_single_precision_stays_single_through_all_parts():
    for lens in LENSES:
        taken, pixel, u = jax.tree.map(
            lambda x: x.astype(jnp.float32),
            (
                camera(lens, aperture=wide_for(lens), trajectory=moving()),
                jnp.array([2.0, 3.0]),
                HALF,
            ),
        )
        ray = shoot_one(taken, pixel, u)
        assert all(x.dtype == jnp.float32 for x in jax.tree.leaves(ray))
        assert see(taken, ray.origin + ray.direction).dtype == jnp.float32


@pytest.mark.parametrize("lens", LENSES)
def test_gradients_reach_every_parameter_and_are_right(lens):
    taken = camera(
        lens,
        aperture=wide_for(lens),
        shutter=Shutter(number(0.2), number(0.03), number(0.1)),
        trajectory=Trajectory(
            jnp.array([0.0, 1.0]),
            jnp.array([(1.0, 0.1, 0, 0), (0.8, 0.1, 0.5, -0.2)]),
            jnp.array([(0.0, 1.0, 2.0), (2.0, 1.0, 3.0)]),
        ),
        time=number(0.3),
    )
    pixel, u = jnp.array([3.0, 5.0]), jnp.array([0.1, 0.8, 0.3, 0.9, 0.4])

    def per_cm(taken, sign):
        """A polynomial's k_n per cm^n: finite differences of all five are then alike."""
        if lens != "polynomial":
            return taken
        k = taken.lens.coefficients * 10.0 ** (sign * jnp.arange(5))
        return eqx.tree_at(lambda c: c.lens.coefficients, taken, k)

    @jax.jit
    def total(taken):
        ray = camera_ray(per_cm(jax.tree.map(jnp.asarray, taken), -1), pixel, u)
        weight = jnp.array([1.0, 2.0, 3.0])
        return ray.origin @ weight + ray.direction @ weight[::-1] + ray.time

    taken = per_cm(taken, 1)
    check_grads(total, (taken,), order=1, modes=["rev"], rtol=GRADIENT)
    # All but what cannot matter: a disc has no rotation, an ideal pinhole no distortion, and the
    # field of view is a border.
    idle = {".aperture.rotation", ".lens.distortion", ".lens.fov", ".lens.max_angle"}
    for path, leaf in jax.tree_util.tree_leaves_with_path(jax.grad(total)(taken)):
        name = jax.tree_util.keystr(path)
        assert np.any(leaf != 0) != (name in idle), name


def test_project_uses_the_pose_of_the_frames_own_time():
    taken = camera(trajectory=moving((0.0, 1.0, 0.0)), time=number(2.0))
    np.testing.assert_allclose(see(taken, jnp.array([0.0, 2.0, 5.0])), [6.2, 3.9], atol=EXACT)
    assert np.isnan(see(taken, jnp.array([0.0, 2.0, -5.0]))).all()
