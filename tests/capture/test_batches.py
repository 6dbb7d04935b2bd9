"""Training footage, the tiles that a step looks at, and how they are drawn."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.camera import camera_rays
from gaussray.camera.film import Film
from gaussray.camera.lens import KannalaBrandt
from gaussray.camera.trajectory import Trajectory
from gaussray.capture.batches import Sampler, footage, tile_colors, tile_grid, tile_rays
from gaussray.capture.calibration import read_views
from gaussray.capture.errors import CaptureError
from gaussray.dataset.images import write_image, write_mask
from gaussray.dataset.manifest import FrameRecord, write_manifest


pytestmark = pytest.mark.usefixtures("quick_compilation")

# Odd sides that tiles of SIDE do not divide: 2 x 3 tiles.
WIDTH, HEIGHT, SIDE = 13, 19, 8
TIMES = (0.0, 0.5, 1.0)
# Cameras one by one or stacked: a few roundings of single precision.
SAME = 1e-6
# Draws per test, and what is allowed of a share that they estimate: four standard deviations.
DRAWS = 4000
SHARE = 4 * (0.25 / DRAWS) ** 0.5

MIDDLE = jnp.full((1, 5), 0.5)

colors = jax.jit(tile_colors, static_argnames="side")
cast = jax.jit(tile_rays, static_argnames="side")


def look(shown, frame, tile, *, side):
    """Chief rays of tiles, encoded colours and weights."""
    camera = jax.tree.map(lambda x: x[frame], shown.camera)
    rays = jax.tree.map(lambda x: x[0], cast(camera, tile, MIDDLE, side=side))
    return rays, *colors(shown, frame, tile, side=side)


def picture(frame):
    """Codes that name their own column, row and frame."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([x, y, np.full_like(x, frame)], axis=-1).astype(np.uint8)


def hole():
    """A mask that is False in one corner and at one pixel."""
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:5, :7] = mask[17, 3] = False
    return mask


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """Three views of a camera that moves; the one in the middle has a mask."""
    folder = tmp_path_factory.mktemp("capture")
    write_mask(folder / "mask.png", hole())
    records = [
        FrameRecord(
            f"{i}.png", toy.camera(0.2 * i, time, WIDTH, HEIGHT), "cam", "train",
            mask_path="mask.png" if i == 1 else None,
        )
        for i, time in enumerate(TIMES)
    ]  # fmt: skip
    for i, record in enumerate(records):
        write_image(folder / record.file_path, picture(i))
    write_manifest(folder / "transforms.json", records)
    return read_views(folder / "transforms.json")


@pytest.fixture(scope="module")
def seen(views):
    """Rays, encoded colours and weights of all tiles of all frames, a frame after the other."""
    shown = footage(views)
    columns, rows = tile_grid(shown, SIDE)
    frame, tile = np.divmod(np.arange(len(views) * columns * rows, dtype=np.int32), columns * rows)
    found = look(shown, jnp.asarray(frame), jnp.asarray(tile), side=SIDE)
    return jax.tree.map(lambda x: np.asarray(x).reshape(len(views), -1, *x.shape[1:]), found)


def places(color):
    """Frame, row and column of the pixels, which their colours name."""
    x, y, frame = np.rint(255 * np.moveaxis(color, -1, 0)).astype(int)
    return frame, y, x


def other(view, **parts):
    """The view through a camera of which parts are others."""
    camera = type(view.camera)(**(vars(view.camera) | parts))
    return dataclasses.replace(view, camera=camera)


def test_footage_holds_the_bytes_and_the_times(views):
    shown = footage(views)
    assert shown.picture.dtype == jnp.uint8
    np.testing.assert_array_equal(shown.picture, [picture(i) for i in range(3)])
    np.testing.assert_array_equal(shown.times, np.float32(TIMES))


def test_without_a_view_the_remedy_is_named():
    with pytest.raises(CaptureError, match='"split": "train"'):
        footage([])


@pytest.mark.parametrize("what", ["size", "lens", "film", "path"])
def test_views_that_cannot_be_stacked_are_named(views, what):
    camera = views[2].camera
    size = toy.single([WIDTH / 2, HEIGHT / 2])
    pose = camera.trajectory
    double = (jnp.concatenate([x, x]) for x in (pose.quat, pose.translation))
    parts = {
        "size": {"film": Film(HEIGHT, WIDTH, "center")},
        "lens": {"lens": KannalaBrandt(size, size, jnp.zeros(4, jnp.float32), toy.single(1.0))},
        "film": {"film": Film(WIDTH, HEIGHT, "box", 1.0)},
        "path": {"trajectory": Trajectory(toy.single([0, 1]), *double)},
    }
    with pytest.raises(CaptureError, match="must share one size, lens model") as error:
        footage([*views[:2], other(views[2], **parts[what])])
    assert str(views[2].image) in str(error.value) and str(views[0].image) in str(error.value)


def test_tiles_of_odd_pictures_hold_every_pixel_and_overlap(seen, views):
    _, color, _ = seen
    assert tile_grid(footage(views), SIDE) == (2, 3)
    assert color.shape == (3, 6 * SIDE**2, 3)
    for own in range(3):
        frame, y, x = places(color[own])
        assert (frame == own).all()
        met = np.zeros((HEIGHT, WIDTH), int)
        np.add.at(met, (y, x), 1)
        # The last tile begins SIDE before the border: columns 5 to 7 and rows 11 to 15 come twice.
        expected = np.ones((HEIGHT, WIDTH), int)
        expected[:, 5:8] *= 2
        expected[11:16] *= 2
        np.testing.assert_array_equal(met, expected)


def test_a_tile_is_a_square_row_after_row(seen):
    _, color, _ = seen
    _, y, x = (c.reshape(6, SIDE, SIDE) for c in places(color[0]))
    np.testing.assert_array_equal(x - x[:, :1, :1], np.broadcast_to(np.arange(SIDE), x.shape))
    np.testing.assert_array_equal(y - y[:, :1, :1], np.swapaxes(x - x[:, :1, :1], 1, 2))
    np.testing.assert_array_equal(x[:, 0, 0], [0, 5, 0, 5, 0, 5])
    np.testing.assert_array_equal(y[:, 0, 0], [0, 0, 8, 8, 11, 11])


def test_rays_are_those_of_the_pixels_centres_and_of_their_own_frame(seen, views):
    rays, color, _ = seen
    middle = jnp.full((color.shape[1], 5), 0.5, jnp.float32)
    for own, view in enumerate(views):
        _, y, x = places(color[own])
        expected = camera_rays(view.camera, toy.single(np.stack([x, y], axis=-1)), middle)
        for name in ("origin", "direction", "time"):
            found = getattr(rays, name)[own]
            np.testing.assert_allclose(found, getattr(expected, name), atol=SAME, err_msg=name)


def test_every_sample_has_the_rays_that_its_numbers_mean(views):
    lens, film = toy.rolling(views[1].camera), Film(WIDTH, HEIGHT)
    camera = type(lens)(**(vars(lens) | {"film": film}))
    u = toy.single(np.random.default_rng(0).random((3, 5)))
    stack = jax.tree.map(lambda x: jnp.stack([x, x]), camera)
    rays = cast(stack, jnp.array([0, 5], jnp.int32), u, side=SIDE)
    assert rays.time.shape == (3, 2 * SIDE**2)
    y, x = np.mgrid[:SIDE, :SIDE]
    for tile, (left, top) in enumerate([(0, 0), (WIDTH - SIDE, HEIGHT - SIDE)]):
        pixel = toy.single(np.stack([x + left, y + top], axis=-1).reshape(-1, 2))
        for i in range(3):
            expected = camera_rays(camera, pixel, jnp.broadcast_to(u[i], (SIDE**2, 5)))
            for name in ("origin", "direction", "time"):
                found = getattr(rays, name)[i].reshape(2, SIDE**2, -1)[tile]
                wanted = getattr(expected, name).reshape(SIDE**2, -1)
                np.testing.assert_allclose(found, wanted, atol=SAME, err_msg=name)


def test_what_is_masked_has_weight_0_and_all_else_weight_1(seen):
    _, color, weight = seen
    for own in range(3):
        _, y, x = places(color[own])
        expected = hole()[y, x] if own == 1 else np.ones(len(x))
        np.testing.assert_array_equal(weight[own], expected)
    assert (weight[1] == 0).any() and (weight[1] == 1).any()


def test_without_masks_every_weight_is_1(views):
    shown = footage([views[0], views[2]])
    assert shown.mask is None
    none = jnp.zeros(1, jnp.int32)
    assert (look(shown, none, none, side=SIDE)[2] == 1).all()


def test_pictures_of_fractions_are_taken_as_they_are(views):
    shown = footage(views)
    fractions = eqx.tree_at(lambda s: s.picture, shown, shown.picture.astype(jnp.float32) / 255)
    frame, tile = jnp.array([2], jnp.int32), jnp.array([5], jnp.int32)
    one, two = (look(s, frame, tile, side=SIDE)[1] for s in (shown, fractions))
    np.testing.assert_allclose(one, two, atol=SAME)
    assert one.max() <= 18 / 255


def test_a_tile_larger_than_the_picture_is_refused(views):
    with pytest.raises(CaptureError, match="at most the picture's smaller side, got 14"):
        tile_grid(footage(views), WIDTH + 1)


def sampler(balance, tiles=DRAWS):
    """Two frames at time 0, of which in one a tile moves, and one at time 1, where nothing does."""
    activity = np.zeros((3, 5), np.float32)
    activity[1, 3] = 0.25
    return Sampler(np.array([0.0, 0.0, 1.0]), activity, tiles=tiles, balance=balance)


@pytest.mark.parametrize("balance", [0.0, 0.5, 1.0])
def test_the_share_drawn_where_things_move_is_the_balance_and_the_rest_is_even(balance):
    frame, tile = sampler(balance).draw(np.array([0]), np.random.default_rng(0))
    assert frame.shape == tile.shape == (1, DRAWS)
    drawn = np.zeros((3, 5))
    np.add.at(drawn, (frame[0], tile[0]), 1 / DRAWS)
    expected = np.zeros((3, 5))
    expected[:2] = (1 - balance) / 10
    expected[1, 3] += balance
    np.testing.assert_allclose(drawn, expected, atol=SHARE)


def test_where_nothing_moves_draws_are_even():
    frame, tile = sampler(1.0).draw(np.array([1]), np.random.default_rng(0))
    assert (frame == 2).all()
    np.testing.assert_allclose(np.bincount(tile[0], minlength=5) / DRAWS, 0.2, atol=SHARE)


def test_a_step_sees_no_tile_twice_while_there_are_others():
    frame, tile = sampler(0.9, tiles=10).draw(np.zeros(20, int), np.random.default_rng(0))
    assert all(len(set(pairs)) == 10 for pairs in (5 * frame + tile).tolist())


def test_the_same_dice_draw_the_same_and_others_draw_others():
    instants = np.array([0, 1, 0])

    def draw(seed):
        return np.stack(sampler(0.5).draw(instants, np.random.default_rng(seed)))

    np.testing.assert_array_equal(draw(0), draw(0))
    assert (draw(0) != draw(1)).any()
