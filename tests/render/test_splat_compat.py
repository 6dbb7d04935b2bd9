"""What rasterisers add: against 3DGS's own formulas, worked out in double precision."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.lens import KannalaBrandt, RayTable
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.render.splat_compat import colors_from_center, dilate
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import Scene
from gaussray.tracer.options import TraceOptions


# Single precision.
ROUND = 2e-6


def camera():
    return toy.records()[0].camera


def pose():
    path = camera().trajectory
    w, x, y, z = np.asarray(path.quat[0], np.float64) / np.linalg.norm(path.quat[0])
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return turn, np.asarray(path.translation[0], np.float64)


def some(count=50, coefficients=4):
    rng = np.random.default_rng(0)
    turn, eye = pose()
    ahead = rng.uniform([-0.3, -0.3, 1], [0.3, 0.3, 4], (count, 3))
    return Gaussians(
        mean=jnp.asarray(ahead @ turn.T + eye, jnp.float32),
        quat=jnp.asarray(rng.normal(size=(count, 4)), jnp.float32),
        scale=jnp.asarray(rng.uniform(1e-3, 0.05, (count, 3)), jnp.float32),
        opacity=jnp.full(count, 0.9),
        harmonics=jnp.asarray(rng.normal(size=(count, coefficients, 3)), jnp.float32),
    ), ahead


@pytest.mark.parametrize("shift", [0.0, 40.0])
def test_what_a_pinhole_adds_covers_as_many_pixels_as_3dgs_adds_anywhere(shift):
    own, ahead = some()
    ahead[:, :2] *= 5
    turn, eye = pose()
    own = dataclasses.replace(own, mean=jnp.asarray(ahead @ turn.T + eye, jnp.float32))
    lens = camera().lens
    lens = dataclasses.replace(lens, focal=lens.focal * 1.5, center=lens.center + shift)
    wide = dilate(own, dataclasses.replace(camera(), lens=lens), 0.3)
    added = np.asarray(wide.scale, np.float64) ** 2 - np.asarray(own.scale, np.float64) ** 2
    (fx, fy), (x, y, z) = np.asarray(lens.focal, np.float64), ahead.T
    zero = np.zeros_like(x)
    jacobian = np.array([[fx / z, zero, -fx * x / z**2], [zero, fy / z, -fy * y / z**2]])
    shown = np.einsum("ikn,jkn->nij", jacobian, jacobian) * added[:, :1, None]
    # Single precision of the sums of squares of which the added one is the smaller.
    np.testing.assert_allclose(np.sqrt(np.linalg.det(shown)), 0.3, rtol=1e-3)
    assert wide.opacity is own.opacity and wide.mean is own.mean


@pytest.mark.slow
def test_a_fisheye_widens_by_the_distance():
    own, ahead = some()
    own_camera = camera()
    film, focal = own_camera.film, 20.0
    middle = jnp.asarray([film.width / 2, film.height / 2])
    lens = KannalaBrandt(jnp.asarray([focal, focal]), middle, jnp.zeros(4), jnp.asarray(3.0))
    wide = dilate(own, dataclasses.replace(own_camera, lens=lens), 0.3)
    distance = np.linalg.norm(ahead, axis=1, keepdims=True)
    expected = np.asarray(own.scale, np.float64) ** 2 + 0.3 * (distance / focal) ** 2
    np.testing.assert_allclose(np.asarray(wide.scale) ** 2, expected, rtol=1e-3)


def test_a_table_of_rays_widens_as_the_lens_that_it_is_of():
    own, own_camera = some()[0], camera()
    film, lens = own_camera.film, own_camera.lens
    column, row = np.meshgrid(np.arange(0.0, film.width + 1), np.arange(0.0, film.height + 1))
    pixels = jnp.asarray(np.stack([column, row], axis=-1), jnp.float32)
    rays = jax.vmap(jax.vmap(lens.direction))(pixels)
    table = RayTable(jnp.ones(2, jnp.float32), jnp.zeros(2, jnp.float32), rays)
    added = [
        np.square(np.asarray(dilate(own, dataclasses.replace(own_camera, lens=x), 0.3).scale))
        - np.square(np.asarray(own.scale))
        for x in (lens, table)
    ]
    # The table's pixels all have the area of the middle one; here they differ by a fifth.
    np.testing.assert_allclose(added[1], added[0], rtol=0.25)


@pytest.mark.slow
def test_key_states_widen_each_by_their_own_distance():
    own, _ = some()
    keys = dataclasses.replace(
        own,
        mean=jnp.stack([own.mean, 2 * own.mean]),
        quat=jnp.stack([own.quat, own.quat]),
        scale=jnp.stack([own.scale, own.scale]),
    )
    both = dilate(keys, camera(), 0.3)
    for k, mean in enumerate(keys.mean):
        alone = dilate(dataclasses.replace(own, mean=mean), camera(), 0.3)
        np.testing.assert_allclose(both.scale[k], alone.scale, rtol=ROUND)


def test_colours_are_those_towards_the_mean():
    own, ahead = some()
    turn, _ = pose()
    flat = colors_from_center(own, camera(), own.mean)
    assert flat.harmonics.shape == (50, 1, 3)
    d = (ahead / np.linalg.norm(ahead, axis=1, keepdims=True)) @ turn.T
    c = np.asarray(own.harmonics, np.float64)
    c1 = 0.4886025119029199
    sh = C0 * c[:, 0] + c1 * (-d[:, 1:2] * c[:, 1] + d[:, 2:] * c[:, 2] - d[:, :1] * c[:, 3])
    color = np.asarray(flat.harmonics[:, 0]) * C0 + 0.5
    np.testing.assert_allclose(color, np.maximum(sh + 0.5, 0), atol=1e-5)


def test_a_picture_shows_a_gaussian_as_wide_as_3dgs_draws_it():
    turn, eye = pose()
    depth, scale = 3.0, 0.06
    view = camera()
    one = Gaussians(
        mean=jnp.asarray((turn[:, 2] * depth + eye)[None], jnp.float32),
        quat=toy.single([[1.0, 0, 0, 0]]),
        scale=toy.single([[scale] * 3]),
        opacity=toy.single([0.9]),
        harmonics=toy.single([[[0.0, 1, 2], [0, 0, 0], [2, 0, 0], [0, 0, 0]]]),
    )
    none = jax.tree.map(lambda x: x[:0], one)
    scene = Scene(one, none, None, toy.single([0.0, 1]))
    options = RenderOptions(samples=1, dilation=0.3, harmonics="center")
    frame = Renderer(scene, options=options, trace=TraceOptions(k=8, alpha_min=1e-4))(view)
    focal, center = (np.asarray(x, np.float64) for x in (view.lens.focal, view.lens.center))
    film = view.film
    x, y = np.meshgrid(np.arange(film.width) + 0.5, np.arange(film.height) + 0.5)
    # Of a Gaussian on the axis a ray at tan(angle) = r / focal misses the middle by depth times the
    # sine; 3DGS draws the tangent's square with 0.3 square pixels more.
    squared = ((x - center[0]) ** 2 + (y - center[1]) ** 2) / (1 + _tan(x, y, focal, center) ** 2)
    alpha = 0.9 * np.exp(-0.5 * squared / ((scale * focal[0] / depth) ** 2 + 0.3))
    np.testing.assert_allclose(frame.alpha, np.where(alpha > 1e-4, alpha, 0), atol=2e-3)
    # One colour from everywhere, that of the direction to the middle.
    seen = frame.alpha > 0.05
    color = frame.color[seen] / frame.alpha[seen][:, None]
    c1, ahead = 0.4886025119029199, turn[:, 2]
    expected = np.array([C0 * 0 + 0.5 + c1 * ahead[2] * 2, C0 + 0.5, 2 * C0 + 0.5])
    np.testing.assert_allclose(color, np.tile(np.maximum(expected, 0), (len(color), 1)), atol=1e-4)


def _tan(x, y, focal, center):
    return np.hypot((x - center[0]) / focal[0], (y - center[1]) / focal[1])
