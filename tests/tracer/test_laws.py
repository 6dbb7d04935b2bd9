"""What must not change the image: laws, for scenes that Hypothesis draws."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import Phase, given, settings, strategies as st
from scenes import CAPACITY, COUNT, OPTIONS, gaussians, look, rays, resting, shot, stacked

from gaussray.geometry import multiply, normalize_quaternion, rotation_matrix
from gaussray.scene.gaussians import Gaussians
from gaussray.tracer.motion import Motion
from gaussray.tracer.options import TraceOptions


# Mean absolute difference of what rays see. Order of sums alone; places that are rounded anew.
REORDERED, MOVED = 1e-6, 1e-5
# Other bundles, rounds, groups and chunks than OPTIONS.
OTHER = TraceOptions(k=16, bundle=4, levels=1, group=2, chunk=16, transmittance_min=0.0)
ANY_SCENE = st.integers(0, 2**16)
# The same examples each time, and few: all share what is compiled. What fails is not made smaller.
quick = settings(
    max_examples=8, derandomize=True, deadline=None, database=None, phases=[Phase.generate]
)


def seen(motion, lines, options=OPTIONS):
    """What rays see, after making sure that all of it is there."""
    pixels, report = look(motion, lines, options=options, capacity=CAPACITY)
    assert int(report.dropped) == int(report.skipped) == 0
    return stacked(pixels)


def drawn(seed):
    """A scene and rays through it."""
    return resting(gaussians(COUNT, seed=seed)), shot(rays(seed=seed + 1))


def changed(motion, **parts):
    """The same scene with other arrays."""
    return Motion(motion.time, Gaussians(**(vars(motion.gaussians) | parts)))


def apart(a, b):
    """Mean absolute difference."""
    return np.mean(np.abs(a - b))


@quick
@given(ANY_SCENE, st.integers(0, 2**16))
def test_the_order_in_which_gaussians_are_listed_does_not_matter(seed, shuffle):
    motion, lines = drawn(seed)
    g, order = motion.gaussians, np.random.default_rng(shuffle).permutation(COUNT)
    mixed = Gaussians(
        g.mean[:, order], g.quat[:, order], g.scale[:, order], g.opacity[order], g.harmonics[order]
    )
    assert apart(seen(Motion(motion.time, mixed), lines), seen(motion, lines)) < REORDERED


@quick
@given(ANY_SCENE, st.integers(-40, 40))
def test_in_another_unit_of_length_not_a_bit_differs(seed, power):
    """Powers of two, from 1e-12 to 1e12: no rounding, so nothing but depth knows."""
    motion, lines = drawn(seed)
    g, factor = motion.gaussians, np.float32(2.0**power)
    larger = changed(motion, mean=g.mean * factor, scale=g.scale * factor)
    image = seen(larger, type(lines)(lines.origin * factor, lines.direction, lines.time))
    image[:, 4] /= factor
    np.testing.assert_array_equal(image, seen(motion, lines))


@quick
@given(ANY_SCENE, st.integers(0, 2**16))
def test_moving_scene_and_camera_together_changes_nothing(seed, way):
    motion, lines = drawn(seed)
    # One colour from all sides: harmonics do not turn with the scene.
    flat = motion.gaussians.harmonics.at[:, 1:].set(0)
    motion = changed(motion, harmonics=flat)
    dice, g = np.random.default_rng(way), motion.gaussians
    turn = normalize_quaternion(jnp.asarray(dice.normal(size=4), jnp.float32))
    shift = jnp.asarray(dice.uniform(-3, 3, 3), jnp.float32)
    matrix = rotation_matrix(turn)
    quat = multiply(jnp.broadcast_to(turn, g.quat.shape), g.quat)
    moved = changed(motion, mean=_turned(matrix, g.mean) + shift[None, None], quat=quat)
    origin = _turned(matrix, lines.origin) + shift[None]
    other = type(lines)(origin, _turned(matrix, lines.direction), lines.time)
    assert apart(seen(moved, other), seen(motion, lines)) < MOVED


def _turned(matrix, x):
    return jnp.matmul(x, matrix.T, precision=jax.lax.Precision.HIGHEST)


@quick
@given(ANY_SCENE)
def test_bundles_rounds_groups_and_chunks_are_a_matter_of_speed(seed):
    motion, lines = drawn(seed)
    assert apart(seen(motion, lines, OTHER), seen(motion, lines)) < REORDERED


@quick
@given(ANY_SCENE, st.floats(0.05, 0.95), st.floats(0.1, 0.9))
def test_an_opacity_split_between_two_in_one_place_blends_to_itself(seed, opacity, share):
    """Along rays through the middle: 1 - (1 - a)^s (1 - a)^(1 - s) is a."""
    shown = gaussians(COUNT, seed=seed)
    parts = [1 - (1 - opacity) ** s for s in (share, 1 - share)]
    whole = np.zeros(COUNT)
    whole[0] = opacity
    split = np.zeros(COUNT)
    split[:2] = parts
    for x in (shown.mean, shown.quat, shown.scale, shown.harmonics):
        x[1] = x[0]
    lines = rays(seed=seed + 1)
    aim = shown.mean[0] - lines.origin
    lines = lines._replace(direction=aim / np.linalg.norm(aim, axis=-1, keepdims=True))
    one, two = (seen(resting(shown._replace(opacity=x)), shot(lines)) for x in (whole, split))
    # A part that is cut off, below 1/255, is missing.
    kept = np.where(np.array(parts) > 1 / 255, 0, parts).sum()
    assert apart(two, one) < MOVED + kept * max(1.0, np.max(np.abs(one)))
