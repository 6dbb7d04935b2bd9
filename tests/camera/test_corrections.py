"""Corrections of cameras: nothing at zero, what they say otherwise, no more than can be told."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.array import camera_set, rays_per_pixel
from gaussray.camera.corrections import (
    REFINABLE,
    Corrections,
    apply_color_response,
    apply_corrections,
    color_response,
    fix_gauge,
    no_corrections,
    refined_kinds,
    require_correctable,
)
from gaussray.camera.lens import (
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FisheyePolynomial,
    FTheta,
    KannalaBrandt,
    pinhole,
)
from gaussray.camera.refined_cameras import (
    color_matrices,
    corrections_summary,
    gains,
    refined_frames,
)
from gaussray.geometry import RigidTransform, multiply, turning


ANGLES = (-0.6, -0.2, 0.3, 0.5)
NAMES = ("a", "b", "c", "d")
# Single precision, of values of order 1 to 3 (places) and 10 (pixels).
SAME, PIXELS = 1e-5, 1e-4
# A small similarity changes poses in its first order; the second is its square.
SMALL = 1e-3
SIZE = toy.single([toy.SIZE, toy.SIZE])
LENSES = {
    "pinhole": toy.camera().lens,
    "distorted": pinhole(
        SIZE, SIZE / 2, toy.single([-0.2, 0.05, 0.002, 0, 0, 0, 0, 0])
    ),
    "kannala_brandt": KannalaBrandt(
        SIZE / 2, SIZE / 2, toy.single([0.05, -0.01, 0, 0]), toy.single(1.4)
    ),
    "polynomial": FisheyePolynomial(
        toy.single([0, -0.07, 1e-4, -2e-5, 0]), toy.single([36, 36]), SIZE,
        toy.single([0.02, -0.01]), toy.single(3.0),
    ),
    "equisolid": Fisheye(SIZE / 2, SIZE / 2, toy.single(1.4), "equisolid"),
    "double_sphere": DoubleSphere(SIZE / 2, SIZE / 2, toy.single([-0.2, 0.6]), toy.single(1.8)),
    "f_theta": FTheta(
        jnp.ones(2, jnp.float32), SIZE / 2, toy.single([0, 0.06, 0, 1e-5]), toy.single(20)
    ),
}  # fmt: skip


def bending(lens):
    """The coefficients of a lens."""
    return require_correctable(lens).coefficient_values


def stack(cameras):
    return jax.tree.map(lambda *x: jnp.stack(x), *cameras)


@pytest.fixture(scope="module")
def filmed():
    """Two frames of each of four cameras, with a rolling shutter."""
    return [toy.rolling(toy.camera(angle, time)) for angle in ANGLES for time in (0.0, 0.5)]


@pytest.fixture(scope="module")
def cameras(filmed):
    return camera_set(np.repeat(np.arange(4), 2), stack(filmed), extent=2.0)


def alone(cameras, **own):
    """A camera's own corrections, applied."""
    return lambda camera: apply_corrections(camera, Corrections(**own), cameras)


def through(lens):
    """A camera with this lens."""
    return type(toy.camera())(**(vars(toy.camera()) | {"lens": lens}))


@pytest.mark.parametrize("name", LENSES)
def test_no_correction_changes_no_bit(filmed, cameras, name):
    camera = type(filmed[0])(**(vars(filmed[0]) | {"lens": LENSES[name]}))
    none = no_corrections(REFINABLE, 4, camera)
    assert refined_kinds(none) == REFINABLE
    same = refined_frames(none, cameras, NAMES, [("c", camera)])[0]
    assert jax.tree.structure(same) == jax.tree.structure(camera)
    for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(camera), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("name", LENSES)
def test_a_longer_focal_length_spreads_the_picture_about_its_centre(cameras, name):
    lens = LENSES[name]
    own = jnp.zeros(3 + bending(lens).shape[-1], jnp.float32).at[0].set(toy.single(np.log(1.1)))
    longer = alone(cameras, lens=own)(through(lens)).lens
    axis, ahead = lens.project(toy.single([0, 0, 1])), toy.single([0.2, -0.3, 1])
    before, after = lens.project(ahead) - axis, longer.project(ahead) - axis
    np.testing.assert_allclose(after, 1.1 * before, atol=PIXELS)


@pytest.mark.parametrize("name", LENSES)
def test_the_centre_moves_by_what_a_small_turn_moves_the_axis(cameras, name):
    lens, small = LENSES[name], toy.single([2e-3, -1e-3])
    own = jnp.zeros(3 + bending(lens).shape[-1], jnp.float32).at[1:3].set(small)
    moved = alone(cameras, lens=own)(through(lens)).lens
    axis = toy.single([0, 0, 1])
    turned = jnp.append(small, 1)
    # To second order in the angle: 5e-6 of about 16 pixels.
    np.testing.assert_allclose(moved.project(axis), lens.project(turned), atol=PIXELS)


def test_only_coefficients_that_a_lens_has_are_refined(cameras):
    for name, lens in LENSES.items():
        count = bending(lens).shape[-1]
        own = jnp.zeros(3 + count, jnp.float32).at[3:].set(1e-3)
        bent = bending(alone(cameras, lens=own)(through(lens)).lens)
        np.testing.assert_array_equal(
            bent != bending(lens),
            bending(lens) != 0,
            name,
        )


def test_a_panorama_has_no_lens_to_refine_but_a_pose():
    camera = through(Equirectangular(SIZE, SIZE / 2))
    assert no_corrections(("pose",), 4, camera).lens is None
    with pytest.raises(ValueError, match=r"fit.refine=\[lens\] must be for lenses with a focal"):
        no_corrections(("lens",), 4, camera)


def test_poses_turn_about_their_own_place_and_move_in_extents(filmed, cameras):
    turn, shift = toy.single([0.1, -0.2, 0.3]), toy.single([0.01, 0.02, -0.03])
    pose = alone(cameras, pose=jnp.concatenate([turn, shift]))(filmed[0]).trajectory
    before = filmed[0].trajectory
    np.testing.assert_allclose(pose.translation, before.translation + 2 * shift[None], atol=SAME)
    np.testing.assert_allclose(pose.quat[0], multiply(turning(turn), before.quat[0]), atol=SAME)


def test_readout_scales_about_the_frames_time_and_offsets_shift_it(filmed, cameras):
    before = filmed[0].shutter
    after = alone(cameras, shutter=toy.single(np.log(1.5)), offset=toy.single(0.25))(
        filmed[0]
    ).shutter
    # The instants are half a unit apart.
    np.testing.assert_allclose(after.row_offset, 1.5 * before.row_offset + 0.125, atol=SAME)
    np.testing.assert_allclose(after.row_step, 1.5 * before.row_step, rtol=SAME)


def similarity(turn, shift, scale, camera):
    """Turn and shift (in extents) of a camera that moves with the whole world."""
    place = np.asarray(camera.trajectory.translation[0], np.float64)
    moved = np.cross(turn, place) + shift + scale * place
    return np.concatenate([turn, moved / 2.0])


def test_what_the_scene_can_make_up_for_is_taken_out(filmed, cameras):
    world = [np.array([1.0, -2, 0.5]), np.array([0.3, 0.1, -1]), 0.7]
    alike = np.stack([similarity(*world, c) for c in filmed[::2]])
    dice = np.random.default_rng(0)
    own, gain, late = dice.normal(size=(4, 6)), dice.normal(size=(4, 3)), dice.normal(size=4)
    given = Corrections(
        pose=toy.single(own), shutter=toy.single(0.1), exposure=toy.single(gain),
        offset=toy.single(late),
    )  # fmt: skip
    kept = fix_gauge(given, cameras)
    same = fix_gauge(
        Corrections(
            pose=toy.single(own + alike), shutter=toy.single(0.1), exposure=toy.single(gain + 3),
            offset=toy.single(late - 2),
        ),
        cameras,
    )  # fmt: skip
    for name in ("pose", "exposure", "offset"):
        np.testing.assert_allclose(getattr(same, name), getattr(kept, name), atol=SAME)
    np.testing.assert_array_equal(kept.shutter, np.full(4, np.float32(0.1)))
    # Seven of the poses' numbers are gone, the others stay.
    free = np.asarray(cameras.pose_projector, np.float64)
    np.testing.assert_allclose(np.linalg.eigvalsh(free), np.repeat([0, 1], [7, 17]), atol=SAME)
    np.testing.assert_allclose(kept.pose, fix_gauge(kept, cameras).pose, atol=SAME)


def test_a_scene_that_moves_with_its_cameras_looks_the_same(filmed, cameras):
    """A point that the similarity takes along falls on the pixel it had."""
    world = [SMALL * np.array([1.0, -2, 0.5]), SMALL * np.array([0.3, 0.1, -1]), 0.7 * SMALL]
    point = np.array([0.3, -0.2, 0.4])
    moved = point + np.cross(world[0], point) + world[1] + world[2] * point
    for camera in filmed[::2]:
        own = toy.single(similarity(*world, camera))
        pose = alone(cameras, pose=own)(camera).trajectory
        quats = pose.quat[0], camera.trajectory.quat[0]
        places = pose.translation[0], camera.trajectory.translation[0]
        seen = [
            camera.lens.project(RigidTransform(q, x).inverse_apply(toy.single(p)))
            for q, x, p in zip(quats, places, (moved, point), strict=True)
        ]
        np.testing.assert_allclose(*seen, atol=20 * SMALL**2 * 10)


def test_frames_of_other_cameras_keep_what_was_recorded(filmed, cameras):
    given = Corrections(offset=toy.single([1, -1, 0, 0]))
    named = [("a", filmed[0]), ("held out", filmed[0])]
    first, other = refined_frames(given, cameras, NAMES, named)
    assert other is filmed[0]
    assert float(first.shutter.row_offset) == pytest.approx(
        float(filmed[0].shutter.row_offset) + 0.5
    )


def test_equal_lenses_share_what_is_found_of_them_also_where_others_are_scored(filmed):
    longer = eqx.tree_at(lambda c: c.lens.focal, filmed[0], 2 * filmed[0].lens.focal)
    pair = [filmed[0], filmed[2], longer]
    known = camera_set(np.arange(3), stack(pair), extent=2.0, refine=("lens",))
    not_refined = camera_set(np.arange(3), stack(pair), extent=2.0)
    np.testing.assert_array_equal(not_refined.lens, [0, 1, 2])
    np.testing.assert_array_equal(known.lens, [0, 0, 1])
    given = Corrections(
        lens=toy.single([[0.1, 0, 0], [0.3, 0, 0], [-0.2, 0, 0]]), shutter=toy.single(0.5)
    )
    np.testing.assert_allclose(fix_gauge(given, known).lens[:, 0], [0.2, 0.2, -0.2], atol=SAME)
    named = [
        *zip("abc", pair, strict=True),
        ("held out", longer),
        ("another", through(LENSES["f_theta"])),
    ]
    *_, c, held_out, another = refined_frames(given, known, "abc", named)
    np.testing.assert_array_equal(held_out.lens.focal, c.lens.focal)
    np.testing.assert_allclose(c.lens.focal, np.exp(-0.2) * longer.lens.focal, rtol=SAME)
    np.testing.assert_array_equal(held_out.shutter.row_step, c.shutter.row_step)
    assert eqx.tree_equal(another.lens, LENSES["f_theta"])


@pytest.mark.parametrize("name", LENSES)
def test_what_smaller_pictures_find_holds_for_the_whole_ones(name, filmed):
    """A run on scaled pictures writes the corrections of the cameras as they were recorded."""
    whole = through(LENSES[name])
    film = whole.film
    old, new = (film.width, film.height), (film.width // 4, film.height // 2)
    box = (0, 0, *old)

    def scaled(camera):
        lens = camera.lens.resized(old, box, new)
        resized = dataclasses.replace(film, width=new[0], height=new[1])
        return dataclasses.replace(camera, film=resized, lens=lens)

    small = scaled(whole)
    known = camera_set(np.arange(1), stack([small]), extent=2.0, refine=("lens",))
    row = jnp.arange(3 + bending(whole.lens).shape[0], dtype=jnp.float32)
    given = Corrections(lens=(0.02 * jnp.cos(row))[None])
    (found,) = refined_frames(given, known, "a", [("a", small)])
    (kept,) = refined_frames(given, known, "a", [("a", whole)])
    for a, b in zip(jax.tree.leaves(found.lens), jax.tree.leaves(scaled(kept).lens), strict=True):
        np.testing.assert_allclose(a, b, rtol=SAME, atol=SAME)


def test_gains_are_told_by_name_and_their_mean_is_one(cameras):
    told = gains(Corrections(exposure=toy.single(np.eye(4)[:, :3])), cameras, NAMES)
    assert tuple(told) == NAMES
    np.testing.assert_allclose(np.prod(list(told.values()), axis=0), 1, rtol=SAME)
    np.testing.assert_allclose(told["a"][0] / told["b"][0], np.e, rtol=SAME)
    assert gains(None, cameras, NAMES) == gains(Corrections(), cameras, NAMES) == {}


def test_the_mean_colour_matrix_is_the_identity_and_a_gain_follows_the_matrix(cameras):
    own = np.random.default_rng(3).normal(size=(4, 3, 3)) * 0.1
    given = Corrections(color_matrix=toy.single(own + 0.3))
    told = color_matrices(given, cameras, NAMES)
    expected = np.eye(3) + own - own.mean(axis=0)
    np.testing.assert_allclose([told[name] for name in NAMES], expected, atol=SAME)
    np.testing.assert_allclose(np.mean(list(told.values()), axis=0), np.eye(3), atol=SAME)
    assert color_matrices(None, cameras, NAMES) == {}
    light = toy.single(np.random.default_rng(4).uniform(size=(4, 3)))
    fixed = fix_gauge(given, cameras)
    seen = apply_color_response(color_response(fixed), light)
    np.testing.assert_allclose(seen, np.einsum("nij,nj->ni", expected, light), atol=SAME)
    gain = toy.single([[0.1, 0, -0.1], [0, 0, 0], [-0.1, 0, 0.1], [0, 0, 0]])
    both = fix_gauge(Corrections(exposure=gain, color_matrix=given.color_matrix), cameras)
    np.testing.assert_allclose(
        apply_color_response(color_response(both), light), np.exp(gain) * seen, atol=SAME
    )
    only = fix_gauge(Corrections(exposure=gain), cameras)
    np.testing.assert_allclose(
        apply_color_response(color_response(only), light), np.exp(gain) * light, atol=SAME
    )
    assert color_response(Corrections()) is None


def test_what_was_found_is_said_in_the_captures_units(filmed, cameras):
    pose = np.zeros((4, 6))
    pose[0, 0] = np.radians(2)
    given = Corrections(
        toy.single(pose), jnp.zeros((4, 3), jnp.float32), toy.single(np.log(0.5)),
        toy.single(np.eye(4)[:, :3]), toy.single([0.4 * np.eye(3), *np.zeros((3, 3, 3))]),
        toy.single([0.2, -0.2, 0, 0]),
    )  # fmt: skip
    said = corrections_summary(given, cameras, stack(filmed).shutter, "seconds")
    step = float(filmed[0].shutter.row_step)
    assert f"time of a row {step:.4g} -> {step / 2:.4g} (seconds)" in said
    assert "offsets -0.1 to 0.1 (seconds)" in said
    assert "colour matrices off the identity by up to 0.300" in said
    for word in ("poses turned by up to", "focal lengths x 1.0000;", "exposures x"):
        assert word in said


def test_a_readout_that_is_not_recorded_cannot_be_scaled():
    with pytest.raises(ValueError, match="every shutter.row_step of the capture is 0"):
        no_corrections(("shutter",), 4, toy.camera())


def test_the_set_looks_as_far_around_its_instants_as_its_shutters_do(filmed):
    owner, camera = np.repeat(np.arange(4), 2), stack(filmed)
    half = 0.1  # of a readout of 0.2
    expected = {(): half, ("shutter",): 1.5 * half, ("offset",): half + 0.25}
    for refine, reach in expected.items():
        known = camera_set(owner, camera, extent=2.0, refine=refine)
        assert (known.earlier, known.later) == pytest.approx((reach, reach), rel=1e-6)
    sharp = camera_set(owner, stack([toy.camera(a) for a in ANGLES for _ in range(2)]), extent=2.0)
    assert (sharp.earlier, sharp.later) == (0, 0)


def test_blur_takes_several_rays_and_nothing_else_does(filmed):
    camera = stack(filmed)
    assert rays_per_pixel(camera) == 1
    for where in (lambda c: c.aperture.radius, lambda c: c.shutter.exposure):
        assert rays_per_pixel(eqx.tree_at(where, camera, where(camera).at[3].set(0.1))) == 4
