"""Pictures of a clip: every ray sees the segment that shows its time, whatever the shutter does."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture, Rim
from gaussray.camera.shutter import interlaced_row_times
from gaussray.render.dataset import render_dataset
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.formats.convert import export_model
from gaussray.scene.segmented import Clip, scene_size


pytestmark = pytest.mark.usefixtures("known_sizes")

ONE = RenderOptions(samples=1)
# Where bodies go at steady speed, arcs through key states are exact but for rounding.
ROUNDING = 2e-4
EDGE = 0.5


def filmer(scene, options=ONE):
    return Renderer(scene, options=options, trace=toy.TRACE)


@pytest.fixture(scope="module")
def whole(known_sizes):
    return filmer(toy.carried(0.0, 1.0))


@pytest.fixture(scope="module")
def cut(known_sizes):
    """The same in two segments, each of which knows its own times alone."""
    return filmer(Clip((toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0))))


@pytest.mark.parametrize(
    "time", [*(pytest.param(x, marks=pytest.mark.slow) for x in (0.0, 0.7, 1.0)), 0.3, EDGE]
)
def test_a_clip_shows_at_every_time_what_the_whole_scene_shows(whole, cut, time):
    for camera in (toy.camera(time=time), toy.rolling(toy.camera(time=time))):
        one, two = whole(camera), cut(camera)
        for name in ("color", "alpha", "depth"):
            np.testing.assert_allclose(getattr(two, name), getattr(one, name), atol=ROUNDING)


@pytest.mark.slow
def test_without_division_a_frame_across_the_edge_would_be_wrong(whole):
    """What the test above can tell."""
    camera = toy.rolling(toy.camera(time=EDGE), readout=0.4)
    alone = filmer(toy.carried(0.0, EDGE))(camera)
    assert np.abs(alone.color - whole(camera).color).max() > 100 * ROUNDING


@pytest.mark.parametrize("chunk_rows", [0, 1])
def test_each_row_across_the_edge_is_that_of_a_picture_at_its_time(whole, chunk_rows):
    scene = Clip((toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0, light=0.5)))
    camera = toy.rolling(toy.camera(time=EDGE + 0.03), readout=0.2)
    options = RenderOptions(samples=1, chunk_rows=chunk_rows)
    rolled, still = filmer(scene, options)(camera), filmer(scene)
    shutter = camera.shutter
    for row in (0, 4, 5, 6, 15):
        time = float(camera.time) + float(shutter.row_offset) + row * float(shutter.row_step)
        frame = still(toy.camera(time=time))
        np.testing.assert_allclose(rolled.color[row], frame.color[row], atol=ROUNDING)
    dimmed = np.abs(rolled.color - whole(camera).color).max(axis=(1, 2)) > 10 * ROUNDING
    assert not dimmed[0] and dimmed[15]


def test_an_exposure_across_the_edge_is_the_mean_over_its_time():
    scene = Clip((toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0, light=0.5)))
    blurred = toy.camera(time=EDGE + 0.05)
    shutter = eqx.tree_at(lambda s: s.exposure, blurred.shutter, toy.single(0.2))
    blurred = dataclasses.replace(blurred, shutter=shutter)
    frame = filmer(scene, RenderOptions(samples=4))(blurred)
    still = filmer(scene)
    moments = EDGE + 0.05 + 0.2 * (np.arange(4) / 4 + 0.125 - 0.5)
    each = [still(toy.camera(time=time)) for time in moments]
    np.testing.assert_allclose(frame.color, np.mean([x.color for x in each], axis=0), atol=ROUNDING)
    np.testing.assert_allclose(frame.alpha, np.mean([x.alpha for x in each], axis=0), atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("chunk_rows", [0, 1])
def test_fields_on_either_side_of_the_edge_are_those_of_their_times(chunk_rows):
    scene = Clip((toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0, light=0.5)))
    camera, late = toy.camera(time=EDGE), 0.01
    shutter = dataclasses.replace(
        camera.shutter,
        row_times=toy.single(interlaced_row_times(toy.SIZE, 0.2)),
        trigger=toy.single(late),
    )
    options = RenderOptions(samples=1, chunk_rows=chunk_rows)
    found = filmer(scene, options)(dataclasses.replace(camera, shutter=shutter))
    still = filmer(scene)
    for field, time in enumerate((EDGE - 0.1 + late, EDGE + 0.1 + late)):
        expected = still(toy.camera(time=time))
        for key in ("color", "alpha"):
            ours, theirs = getattr(found, key)[field::2], getattr(expected, key)[field::2]
            np.testing.assert_allclose(ours, theirs, atol=ROUNDING)


@pytest.mark.slow
def test_samples_are_added_to_a_clip_as_to_the_whole():
    """The same batches, however the frame is divided, behind a rim that darkens."""
    options = RenderOptions(samples=4, error=1e-6, samples_most=20)
    camera = toy.camera(time=EDGE)
    wide = Aperture(*map(toy.single, (0.1, 2, 0, 1)), rim=Rim(*map(toy.single, (0.1, 0.2))))
    shutter = dataclasses.replace(camera.shutter, exposure=toy.single(0.2))
    camera = dataclasses.replace(camera, aperture=wide, shutter=shutter)
    parts = Clip((toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0)))
    expected, found = (filmer(x, options)(camera) for x in (toy.carried(0.0, 1.0), parts))
    assert found.samples == expected.samples == 20
    for key in ("color", "alpha", "error"):
        np.testing.assert_allclose(getattr(found, key), getattr(expected, key), atol=ROUNDING)
    np.testing.assert_allclose(found.depth, expected.depth, atol=10 * ROUNDING)


def test_a_film_shows_the_frames_one_by_one(cut):
    times = [0.1, 0.45, EDGE, 0.55, 0.9]
    cameras = [toy.rolling(toy.camera(time=time)) for time in times]
    cameras.insert(2, toy.camera(time=0.9))
    film = list(cut.render_frames(cameras))
    assert len(film) == len(cameras)
    for frame, camera in zip(film, cameras, strict=True):
        np.testing.assert_allclose(frame.color, cut(camera).color, atol=ROUNDING)


@pytest.mark.slow
def test_an_instant_of_a_clip_is_exported_from_its_segment(tmp_path):
    parts = toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0, light=0.5)
    for time, own in ((0.2, parts[0]), (EDGE, parts[1]), (0.8, parts[1])):
        found, _ = export_model(Clip(parts), tmp_path / "a.ply", time, color="linear")
        expected, _ = export_model(own, tmp_path / "b.ply", time, color="linear")
        for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(a, b)
    with pytest.raises(ValueError, match=r"time must be given .* in its range 0 ... 1"):
        export_model(Clip(parts), tmp_path / "a.ply")


def test_the_facts_of_a_clip_are_those_of_all_its_segments():
    one = toy.carried(0.0, EDGE)
    facts, single = scene_size(Clip((one, toy.carried(EDGE, 1.0)))), scene_size(one)
    assert facts == {name: 2 * value for name, value in single.items()} | {"segments": 2}


def test_labels_of_a_clip_are_refused(tmp_path):
    clip = Clip((toy.carried(0.0, EDGE), toy.carried(EDGE, 1.0)))
    with pytest.raises(ValueError, match="fit.segment=0"):
        renderer = Renderer(clip, options=ONE, trace=toy.TRACE)
        options = DatasetOptions(labels=["flow_forward"])
        render_dataset(renderer, toy.records(), tmp_path, options=options, quiet=True)
    assert not any(tmp_path.iterdir())
