"""Every ray of a frame is of one segment, also at the edges."""

import dataclasses

import jax
import numpy as np
import pytest
import toy

from gaussray.camera.sampling import shifted_samples, sobol_samples
from gaussray.camera.shutter import DIRECTIONS, Shutter, interlaced_row_times
from gaussray.render.segments import LEAST, segment_rays


EDGES = np.array([0.4, 0.5])
# Times in single precision.
SINGLE = 1e-6


def filmed(offset, step, exposure=0.0, direction=DIRECTIONS[0], time=0.45, size=(7, 5), **more):
    shutter = Shutter(*map(toy.single, (offset, step, exposure)), direction, **more)
    camera = dataclasses.replace(toy.camera(time=time, width=size[0], height=size[1]))
    return jax.device_get(dataclasses.replace(camera, shutter=shutter))


def times(camera, count):
    """When each sample of each row looks, by the definition."""
    film, shutter = camera.film, camera.shutter
    sideways = shutter.direction in ("left_to_right", "right_to_left")
    row = np.arange(film.width if sideways else film.height)[None]
    u = np.asarray(sobol_samples(count), np.float64)[:, 4:]
    value = (float(x) for x in (camera.time, shutter.row_offset, shutter.row_step))
    time, offset, step = value
    return time + offset + step * row + float(shutter.exposure) * (u - 0.5)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("count", [1, 8])
@pytest.mark.parametrize("exposure", [0.0, 0.03])
@pytest.mark.parametrize("step", [0.05, -0.05])
def test_every_sample_of_every_row_is_of_the_segment_that_shows_its_time(
    direction, count, exposure, step
):
    camera = filmed(-2 * step, step, exposure, direction)
    found = segment_rays(camera, EDGES, count)
    assert [i for i, _ in found] == [0, 1, 2]
    seen = np.array([share.mask for _, share in found])
    assert (seen.sum(axis=0) == 1).all()
    np.testing.assert_array_equal(
        np.argmax(seen, axis=0), np.searchsorted(EDGES, times(camera, count), side="right")
    )


def test_fields_triggers_and_batches_of_samples_have_times_of_their_own():
    table, late = interlaced_row_times(5, 0.06), 0.02
    more = {"row_times": toy.single(table), "trigger": toy.single(late)}
    camera = filmed(-0.02, 0.01, 0.05, time=0.44, **more)
    for batch in (None, 0, 3):
        number = jax.numpy.asarray(batch or 0)
        u = sobol_samples(8) if batch is None else shifted_samples(8, number)
        u = np.asarray(u, np.float64)[:, 4:]
        time = 0.44 + late - 0.02 + 0.01 * np.arange(5) + table + 0.05 * (u - 0.5)
        owner = np.searchsorted(EDGES, time, side="right")
        found = segment_rays(camera, EDGES, 8, batch)
        assert [i for i, _ in found] == np.unique(owner).tolist() == [0, 1, 2]
        for i, share in found:
            np.testing.assert_array_equal(share.mask, owner == i)


def test_a_segment_spans_the_times_between_its_edges_and_the_frames_ends():
    found = segment_rays(filmed(-0.1, 0.05), EDGES, 1)
    spans = [np.asarray(share.span) for _, share in found]
    np.testing.assert_allclose(spans, [[0.35, 0.4], [0.4, 0.5], [0.5, 0.55]], atol=SINGLE)


def test_a_span_is_never_of_no_length_and_lies_inside():
    # The last row is right at the edge.
    (_, before), (_, after) = segment_rays(filmed(-0.1, 0.025, time=0.5), EDGES[1:], 1)
    assert before.span[0] == pytest.approx(0.4, abs=SINGLE)
    assert after.span[0] == 0.5 and after.span[1] - after.span[0] == pytest.approx(
        LEAST * 0.1, abs=SINGLE
    )
    np.testing.assert_array_equal(after.mask, [[False] * 4 + [True]])


@pytest.mark.parametrize(("time", "segment"), [(0.1, 0), (0.4, 1), (0.45, 1), (0.5, 2), (9.0, 2)])
def test_a_frame_of_one_time_is_of_one_segment(time, segment):
    assert segment_rays(filmed(0.0, 0.0, time=time), EDGES, 4) == [(segment, None)]


def test_an_exposure_that_only_touches_an_edge_is_of_one_segment():
    assert segment_rays(filmed(0.0, 0.0, 0.1, time=0.45), EDGES, 4) == [(1, None)]


def test_without_segments_a_frame_is_whole():
    assert segment_rays(filmed(-0.1, 0.05), np.zeros(0), 4) == [(0, None)]
