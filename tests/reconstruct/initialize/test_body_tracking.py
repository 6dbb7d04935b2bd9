"""Bodies are found where they went, whatever the light does, and nothing else is touched."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy
from scipy.spatial.transform import Rotation

from gaussray.color import srgb_encode
from gaussray.reconstruct.initialize import body_tracking
from gaussray.reconstruct.initialize.appearance import Shown
from gaussray.reconstruct.initialize.body_tracking import TrackOptions, track
from gaussray.reconstruct.initialize.regrouping import MovingGaussians
from gaussray.render.options import RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.bodies import bodies_at_rest
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import constant_harmonics
from gaussray.scene.scene import Scene


TIMES = np.array([0.0, 0.5, 1.0])
SIZE, RADIUS = 48, 0.5
# About a pixel (there are 17.6 to a unit): 1.3 at the ball's rim, which is 8.8 from its centre, and
# 0.9 of path.
RADIANS, METRES = 0.15, 0.05
# From one instant to the next the ball moves by 0.75 and 0.45 of its radius, and turns by about
# 0.45 rad, most of a patch's half width.
PATH = np.array([[0, 0, 0], [0.3, -0.2, 0.1], [0.5, -0.2, 0.2]])
TURN = Rotation.from_rotvec([[0, 0, 0], [0.1, 0.4, 0.2], [0.2, 0.8, 0.3]])
OPTIONS = TrackOptions(side=SIZE)
PALETTE = np.array([[8, 1, 1], [1, 7, 1], [1, 2, 8], [8, 7, 1], [7, 2, 7], [7, 7, 7]]) / 10


def ball(count=300):
    """Discs on a ball with patches of six colours, and their outward normals."""
    i = np.arange(count) + 0.5
    height, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - height**2)
    normal = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)
    seeds = np.random.default_rng(3).normal(size=(12, 3))
    patch = np.argmax(normal @ (seeds / np.linalg.norm(seeds, axis=1, keepdims=True)).T, axis=1)
    return RADIUS * normal, normal, PALETTE[patch % 6]


SIZES: dict = {}


def board(side=16):
    """Discs of six colours, a few of each in one place, on a board behind the ball that rests; and
    their normals."""
    line = np.linspace(-1.5, 1.5, side)
    u, v = (x.reshape(-1) for x in np.meshgrid(line, line))
    place = np.stack([u, v, np.full(len(u), 1.1)], axis=1)
    patch = (np.floor(u / 0.75) + 3 * np.floor(v / 0.75)).astype(int)
    return place, np.tile([0.0, 0, 1], (len(u), 1)), PALETTE[patch % 6]


def filmed(light=(1.0, 1.0, 1.0), path=PATH, turn=TURN, behind=False):
    """The thrown ball seen by six cameras at three instants, under light that may change; with the
    board behind it, or without."""
    place, _, color = ball()
    wall = toy.gaussians([[0, 0, 9]], 9.0, [[0.2, 0.2, 0.2]])
    if behind:
        position, _, paint = board()
        mean, paint = np.concatenate([[[0, 0, 9]], position]), np.insert(paint, 0, 0.2, axis=0)
        wall = toy.gaussians(mean, np.insert(np.full(len(position), 0.15), 0, 9.0), paint)
    pictures, cameras = [], []
    for i, time in enumerate(TIMES):
        mean = place @ turn[i].as_matrix().T + path[i]
        scale = np.full((len(mean), 3), 0.06, np.float32)
        quat = np.tile(np.float32([1, 0, 0, 0]), (len(mean), 1))
        parts = [toy.single(x) for x in (mean, quat, scale, np.full(len(mean), 0.95))]
        moving = Gaussians(*parts, constant_harmonics(toy.single(color * light[i]), 0))
        render = Renderer(
            Scene(wall, moving, None, toy.single([0, 1])),
            options=RenderOptions(samples=1),
            trace=toy.TRACE,
        )
        # What the first one measures serves them all.
        render._capacity = SIZES
        for angle in np.linspace(-1.5, 1.5, 6):
            cameras.append(toy.camera(angle, time, SIZE, SIZE))
            pictures.append(render(cameras[-1]).color)
    encoded = np.round(255 * np.clip(srgb_encode(np.stack(pictures)), 0, 1)).astype(np.uint8)
    return encoded, jax.tree.map(lambda *x: jnp.stack(x), *cameras)


def tracked(picture, camera, mask=None, behind=False, **options):
    parts = [ball(), board()] if behind else [ball()]
    place, normal, color = (np.concatenate(x) for x in zip(*parts, strict=True))
    # The first pixel of every picture shows the wall.
    moved = np.abs(picture / 255.0 - picture[:, :1, :1] / 255.0).max(-1) > 0.1
    body = bodies_at_rest(jnp.zeros((1, 3)), jnp.ones(1), jnp.asarray(TIMES))
    sign = np.where(np.arange(len(normal)) % 2, 1, -1)[:, None]
    parts = {name: getattr(OPTIONS, name) for name in OPTIONS.__dataclass_fields__}
    return track(
        body,
        MovingGaussians(np.zeros(len(place), int), place, normal * sign, color),
        lambda own: Shown(picture[own], moved[own], None if mask is None else mask[own]),
        camera,
        options=TrackOptions(**(parts | options)),
        seed=0,
    )


@pytest.fixture(scope="module")
def film():
    return filmed()


def assert_found(body):
    turn = Rotation.from_quat(np.asarray(body.turn[0])[:, [1, 2, 3, 0]])
    assert (TURN * turn.inv()).magnitude().max() < RADIANS
    np.testing.assert_allclose(body.path[0], PATH, atol=METRES)


@pytest.mark.ci
def test_a_thrown_ball_is_found_at_every_instant(film):
    assert_found(tracked(*film))


@pytest.mark.ci
def test_light_that_changes_by_half_does_not_mislead():
    assert_found(tracked(*filmed(light=(1.0, 0.5, 0.7))))


@pytest.mark.ci
def test_what_light_alone_changes_is_no_body():
    still = filmed(light=(1.0, 0.5, 0.7), path=0 * PATH, turn=[Rotation.identity()] * 3)
    assert tracked(*still).pivot.shape == (0, 3)


@pytest.mark.ci
def test_a_board_that_touches_a_body_and_rests_is_cut_off():
    found = tracked(*filmed(behind=True), behind=True)
    assert_found(found)
    # The group that is given has a radius of 1.
    assert RADIUS < found.radius[0] < 1.4 * RADIUS


def test_gaussians_that_make_up_for_one_another_show_their_mean_colour():
    # In each pair at one place one is too bright and one too dark, by half of the colour.
    width = body_tracking._pixel_width(toy_views(), jnp.zeros((1, 3)), 1)
    place, normal, color = (np.repeat(x, 2, axis=0) for x in ball(100))
    wrong = color * np.where(np.arange(200) % 2, 1.5, 0.5)[:, None]
    body = bodies_at_rest(jnp.zeros((1, 3)), jnp.ones(1), jnp.asarray(TIMES))

    def look(color):
        moving = MovingGaussians(np.zeros(200, int), place, normal, color)
        return body_tracking._known(body, moving, width, 50, seed=0).look

    np.testing.assert_allclose(look(wrong), look(color), atol=1e-6)
    # Farther neighbours do not count: all is not one colour.
    assert np.ptp(np.asarray(look(color)), axis=1).max() > 0.1


def toy_views():
    cameras = [toy.camera(angle, 0.0, SIZE, SIZE) for angle in (-1.0, 0.0, 1.0)]
    return jax.tree.map(lambda *x: jnp.stack(x), *cameras)


@pytest.mark.parametrize("shrink", [1, 3])
def test_a_pixel_is_as_wide_as_distance_over_focal_length(shrink):
    # All stand 3 away with a focal length of 1.1 sides; the second body is behind them.
    pivot = jnp.asarray([[0, 0, 0], [0, 0, -1e3]], jnp.float32)
    found = body_tracking._pixel_width(toy_views(), pivot, shrink)
    np.testing.assert_allclose(found, [shrink * 3 / (1.1 * SIZE), 0], rtol=1e-4)


def test_masked_pixels_say_nothing(film):
    picture, camera = film
    mask = np.ones(picture.shape[:3], bool)
    mask[:, :, : SIZE // 3] = False
    dirty = np.where(mask[..., None], picture, np.uint8([255, 0, 255]))
    assert_found(tracked(dirty, camera, mask))


def test_the_same_seed_finds_the_same_poses(film):
    one, two = tracked(*film), tracked(*film)
    np.testing.assert_array_equal(one.path, two.path)
    np.testing.assert_array_equal(one.turn, two.turn)


def test_without_poses_to_try_bodies_rest(film):
    body = tracked(*film, poses=0)
    assert np.abs(body.path).max() == 0


# Two grey boxes of one colour. Seen from the front, the near one passes before the far one, which
# it hides by more than half at the second time. In pictures of 17.6 pixels to a unit.
BOX, GAP = 0.35, 0.9
NEAR = np.array([[-0.8, 0.05, -0.5], [-0.1, 0.05, -0.5], [0.6, 0.05, -0.5]])
FAR = np.array([[0.5, 0, 0.5], [0.05, 0, 0.5], [-0.4, 0, 0.5]])
# Two pixels across the view, twice that in depth, of which cameras up to 0.5 rad aside tell half;
# at the second time, when more than half of the far box is hidden, a quarter of a side across and
# half a side in depth. Eight seeds reach 0.12 and 0.26.
OCCLUDED = np.tile(2 / 17.6 * np.array([1, 1, 2]), (3, 1))
OCCLUDED[1] = BOX / 2, BOX / 2, BOX


def box(side=6):
    """Discs on the faces of a box, their outward normals, and greys that differ face by face, as
    faces under a lamp do."""
    line = (np.arange(side) + 0.5) / side * 2 - 1
    u, v = (x.reshape(-1) for x in np.meshgrid(line, line))
    places, normals, greys = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            place = np.insert(np.stack([u, v], axis=1), axis, sign, axis=1)
            places.append(BOX * place)
            normals.append(np.tile(np.eye(3)[axis] * sign, (len(u), 1)))
            greys.append(np.full((len(u), 3), 0.15 + 0.1 * (2 * axis + (sign > 0))))
    return tuple(np.concatenate(x) for x in (places, normals, greys))


def boxes_seen(angles):
    """Pictures and cameras of both boxes on their ways."""
    place, _, color = box()
    wall = toy.gaussians([[0, 0, 9]], 9.0, [[0.02, 0.02, 0.02]])
    pictures, cameras = [], []
    for i, time in enumerate(TIMES):
        mean = np.concatenate([place + NEAR[i], place + FAR[i]])
        moving = toy.gaussians(mean, 0.05, np.tile(color, (2, 1)), opacity=0.98)
        render = Renderer(
            Scene(wall, moving, None, toy.single([0, 1])),
            options=RenderOptions(samples=1),
            trace=toy.TRACE,
        )
        for angle in angles:
            cameras.append(toy.camera(angle, time, SIZE, SIZE))
            pictures.append(render(cameras[-1]).color)
    encoded = np.round(255 * np.clip(srgb_encode(np.stack(pictures)), 0, 1)).astype(np.uint8)
    return encoded, jax.tree.map(lambda *x: jnp.stack(x), *cameras)


@pytest.mark.ci
def test_two_grey_boxes_that_occlude_one_another_are_found():
    # The cameras stand before the boxes, so that the near box hides the far one in most of them.
    angles = np.linspace(-0.5, 0.5, 5)
    picture, camera = boxes_seen(angles)
    place, normal, color = box()
    count = len(place)
    # In the front picture of the second time the near box covers more than half of the far one.
    assert abs(NEAR[1] - FAR[1])[0] < BOX
    moved = np.abs(picture / 255.0 - picture[:, :1, :1] / 255.0).max(-1) > 0.1
    pivots = jnp.asarray(np.stack([NEAR[0], FAR[0]]), jnp.float32)
    bodies = bodies_at_rest(pivots, jnp.full(2, 2 * BOX), jnp.asarray(TIMES))
    found = track(
        bodies,
        MovingGaussians(
            np.repeat([0, 1], count),
            np.concatenate([place + NEAR[0], place + FAR[0]]),
            np.tile(normal, (2, 1)),
            np.tile(color, (2, 1)),
        ),
        lambda frames: Shown(picture[frames], moved[frames], None),
        camera,
        options=OPTIONS,
        seed=0,
    )
    assert found.pivot.shape == (2, 3)
    for path, truth in zip(np.asarray(found.path), (NEAR, FAR), strict=True):
        assert (np.abs(path - (truth - truth[0])) < OCCLUDED).all(), path


@pytest.mark.parametrize(
    ("key", "value"),
    [("poses", -1), ("points", 0), ("rounds", 0), ("side", 0), ("elite", 1), ("blur", ())],
)
def test_an_option_that_cannot_be_is_named(key, value):
    with pytest.raises(ValueError, match=f"track.{key} must"):
        TrackOptions(**{key: value})
