"""The shutter: which row sees the scene when."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from gaussray.camera.shutter import (
    DIRECTIONS,
    Shutter,
    check_shutter,
    first_and_last_pixels,
    global_shutter,
    interlaced_row_times,
    rolling_shutter,
    row_number,
    sample_time,
    time_window,
    with_readout_factors,
)


RESOLUTION = (8, 6)
# Times of order 10 in double precision.
EXACT = 1e-14


def shutter(row_offset=0.0, row_step=0.0, exposure=0.0, **choice):
    return Shutter(*(jnp.array(float(v)) for v in (row_offset, row_step, exposure)), **choice)


def time_of(shutter, column, row, u=0.5, time=3.0):
    pixel = jnp.array([column, row])
    return sample_time(shutter, pixel, RESOLUTION, jnp.array(time), jnp.array(u))


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_direction_as_data_reads_the_same_rows(direction):
    fixed = shutter(0.3, 0.1, direction=direction)
    free = with_readout_factors(fixed, RESOLUTION)
    for place in ((0, 0), (7, 0), (0, 5), (3, 2)):
        assert row_number(free, jnp.array(place), RESOLUTION) == row_number(
            fixed, jnp.array(place), RESOLUTION
        )
        assert time_of(free, *place) == time_of(fixed, *place)


@pytest.mark.parametrize("duration", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("position", [0.5, 0.0, -0.5], ids=["start", "center", "end"])
def test_row_times_are_blenders(duration, position):
    """t_i = F + cS + S (1 - d) ((i + 1)/H - 1/2), exposed during S d around it."""
    frame, length, height = 3.0, 1.6, RESOLUTION[1]
    readout = length * (1 - duration)
    blender = shutter(
        position * length + readout * (1 / height - 0.5), readout / height, length * duration
    )
    for i in range(height):
        mean = frame + position * length + readout * ((i + 1) / height - 0.5)
        half = length * duration / 2
        for u, expected in ((0.0, mean - half), (0.5, mean), (1.0, mean + half)):
            np.testing.assert_allclose(time_of(blender, 2, i, u), expected, rtol=EXACT)


@pytest.mark.parametrize(
    "direction, column, row, number",
    [
        ("top_to_bottom", 2, 0, 0),
        ("top_to_bottom", 2, 5, 5),
        ("bottom_to_top", 2, 5, 0),
        ("bottom_to_top", 2, 0, 5),
        ("left_to_right", 0, 4, 0),
        ("left_to_right", 7, 4, 7),
        ("right_to_left", 7, 4, 0),
        ("right_to_left", 0, 4, 7),
    ],
)
def test_rows_are_counted_along_the_direction_from_zero(direction, column, row, number):
    rolling = shutter(0.5, 0.25, direction=direction)
    assert row_number(rolling, jnp.array([column, row]), RESOLUTION) == number
    np.testing.assert_allclose(time_of(rolling, column, row), 3.5 + 0.25 * number, rtol=EXACT)
    moved = (column, 1) if "left" in direction else (1, row)
    assert time_of(rolling, *moved) == time_of(rolling, column, row)


def test_a_global_shutter_sees_all_rows_at_once():
    for row in (0, 5):
        assert time_of(global_shutter(), 3, row, u=0.9) == 3.0
        assert time_of(global_shutter(jnp.array(0.2)), 3, row, u=0.5) == 3.0


def test_samples_spread_evenly_over_the_exposure_around_the_row_time():
    u = (jnp.arange(64) + 0.5) / 64
    pixel, time = jnp.array([1.0, 2.0]), jnp.array(3.0)
    rolling = shutter(0.1, 0.01, 0.5)
    times = jax.vmap(lambda u: sample_time(rolling, pixel, RESOLUTION, time, u))(u)
    np.testing.assert_allclose(np.mean(times), 3.12, rtol=EXACT)
    np.testing.assert_allclose(np.diff(times), 0.5 / 64, rtol=1e-10)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("step", [0.02, -0.02])
def test_the_window_is_that_of_the_times_of_all_samples(direction, step):
    rolling = shutter(0.1, step, 0.3, direction=direction)
    corners = [(c, r) for c in (0, RESOLUTION[0] - 1) for r in (0, RESOLUTION[1] - 1)]
    times = [time_of(rolling, *c, u=u, time=0.0) for c in corners for u in (0.0, 1.0)]
    found = time_window(rolling, RESOLUTION)
    np.testing.assert_allclose(found, (min(times), max(times)), rtol=EXACT)
    both = jax.tree.map(lambda *x: jnp.stack(x), rolling, shutter(direction=direction))
    np.testing.assert_allclose(time_window(both, RESOLUTION), (min(times), max(max(times), 0)))


def test_gradients_are_right_in_every_parameter():
    def time(shutter, time):
        return sample_time(
            *jax.tree.map(jnp.asarray, (shutter, jnp.array([2.0, 5.0]))),
            RESOLUTION,
            jnp.asarray(time),
            jnp.array(0.9),
        )

    check_grads(time, (shutter(0.1, 0.02, 0.3), jnp.array(1.0)), order=1, modes=["rev"])
    step = jax.grad(lambda s: time_of(s, 2, 5, u=0.9))(shutter(0.1, 0.02, 0.3))
    np.testing.assert_allclose([step.row_offset, step.row_step, step.exposure], [1, 5, 0.4])


def test_single_precision_stays_single():
    single = jax.tree.map(lambda x: x.astype(jnp.float32), shutter(0.1, 0.02, 0.3))
    for pixel in (jnp.array([1, 2]), jnp.array([1.0, 2.0], jnp.float32)):
        time = sample_time(single, pixel, RESOLUTION, jnp.float32(1), jnp.float32(0.5))
        assert time.dtype == jnp.float32


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: shutter(exposure=-1), "shutter.exposure must be at least 0, got -1.0"),
        (lambda: shutter(row_step=np.nan), "shutter.row_step must be finite"),
        (lambda: shutter(row_offset=np.inf), "shutter.row_offset must be finite"),
        (lambda: rolling_shutter(np.nan, 6), "shutter.readout must be finite, got nan"),
        (lambda: shutter(direction="up"), "shutter.direction must be one of"),
    ],
)
def test_what_is_no_shutter_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()


TABLE = jnp.array([0.3, -0.2, 0.0, 0.7, 0.1, 0.4])


@pytest.mark.parametrize("first, early", [("even", 0), ("odd", 1)])
def test_interlaced_fields_are_read_one_after_the_other(first, early):
    table = interlaced_row_times(RESOLUTION[1], 0.4, first)
    np.testing.assert_allclose(table[early::2], -0.2)
    np.testing.assert_allclose(table[1 - early :: 2], 0.2)
    video = shutter(-0.05, 0.02, row_times=jnp.asarray(table))
    for row in range(RESOLUTION[1]):
        field = -0.2 if row % 2 == early else 0.2
        expected = 3.0 - 0.05 + 0.02 * row + field
        np.testing.assert_allclose(time_of(video, 4, row), expected, rtol=EXACT)


@pytest.mark.parametrize("direction", ["top_to_bottom", "bottom_to_top"])
def test_a_row_sees_the_scene_at_the_time_of_the_table_after_the_trigger(direction):
    late = shutter(0.5, 0.25, direction=direction, row_times=TABLE, trigger=jnp.array(2.0))
    for row in range(6):
        i = row if direction == "top_to_bottom" else 5 - row
        expected = 3 + 2 + 0.5 + 0.25 * i + TABLE[i]
        np.testing.assert_allclose(time_of(late, 1, row), expected, rtol=EXACT)
        assert time_of(late, 1, row) == time_of(late, 1.0, float(row))


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_window_and_decisive_pixels_of_a_table_are_those_of_all_its_rows(direction):
    width, height = RESOLUTION
    table = jnp.asarray(np.random.default_rng(3).normal(size=width if "left" in direction else 6))
    read = shutter(0.1, 0.02, 0.3, direction=direction, row_times=table, trigger=jnp.array(-1.5))
    check_shutter(read, RESOLUTION)
    pixels = [(c, r) for c in range(width) for r in range(height)]
    times = [float(time_of(read, *p, time=0.0)) for p in pixels]
    window = min(times) - 0.15, max(times) + 0.15
    np.testing.assert_allclose(time_window(read, RESOLUTION), window)
    decisive = [float(time_of(read, *p, time=0.0)) for p in first_and_last_pixels(read, RESOLUTION)]
    np.testing.assert_allclose((min(decisive), max(decisive)), (min(times), max(times)))
    both = jax.tree.map(lambda *x: jnp.stack(x), read, read)
    np.testing.assert_allclose(time_window(both, RESOLUTION), window)


def test_gradients_reach_every_row_of_a_table_and_the_trigger():
    read = shutter(row_times=TABLE, trigger=jnp.array(0.5))
    slope = jax.grad(lambda s: time_of(s, 2, 4))(read)
    np.testing.assert_array_equal(slope.row_times, [0, 0, 0, 0, 1, 0])
    assert slope.trigger == 1


@pytest.mark.parametrize(
    "build, message",
    [
        (lambda: shutter(row_times=TABLE * np.nan), "shutter.row_times must be finite"),
        (lambda: shutter(trigger=jnp.array(np.inf)), "shutter.trigger must be finite"),
        (
            lambda: check_shutter(shutter(row_times=TABLE[:4]), RESOLUTION),
            "one time for each of the picture's 6 rows, got 4",
        ),
        (
            lambda: check_shutter(shutter(row_times=TABLE, direction="left_to_right"), RESOLUTION),
            "one time for each of the picture's 8 columns, got 6",
        ),
        (lambda: interlaced_row_times(6, 0.1, "third"), "shutter.first_field must be one of"),
    ],
)
def test_what_no_table_or_trigger_can_be_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()
