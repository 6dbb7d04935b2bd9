"""Segments follow each other without a gap, on disk too."""

import dataclasses

import jax
import numpy as np
import pytest
import toy

from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.segmented import Clip, segment_at, segment_edges, segments_of
from gaussray.scene.store import load_scene, save_scene, scene_info


def part(begin, end, speed=0.0):
    return dataclasses.replace(toy.scene(speed=speed), time_range=toy.single([begin, end]))


@pytest.fixture(scope="module")
def clip():
    """Three segments, of which the second moves."""
    return Clip((part(0, 0.25), part(0.25, 0.5, speed=0.5), part(0.5, 1)))


@pytest.fixture
def path(tmp_path, clip):
    save_scene(tmp_path / "scene.npz", clip, info={"by": "a test"})
    return tmp_path / "scene.npz"


def same(one, two):
    assert jax.tree.structure(one) == jax.tree.structure(two)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_array_equal(a, b)


def test_every_time_has_its_segment(clip):
    np.testing.assert_array_equal(segment_edges(clip), [0.25, 0.5])
    np.testing.assert_array_equal(clip.time_range, [0, 1])
    shown = [segment_at(clip, time) for time in (-1.0, 0.0, 0.2, 0.25, 0.4, 0.5, 1.0, 2.0)]
    expected = [clip.segments[i] for i in (0, 0, 0, 1, 1, 2, 2, 2)]
    assert all(a is b for a, b in zip(shown, expected, strict=True))


def test_a_scene_is_its_own_segment():
    scene = toy.scene()
    assert segments_of(scene) == (scene,) and not len(segment_edges(scene))
    assert segment_at(scene, 0.7) is scene


@pytest.mark.parametrize("ranges", [[(0, 0.5), (0.6, 1)], [(0, 0.5), (0.4, 1)], [(0, 1), (1, 1)]])
def test_segments_that_do_not_meet_are_refused(ranges):
    with pytest.raises(ValueError, match="segment 2 of a clip must begin where the one before"):
        Clip(tuple(part(*pair) for pair in ranges))


def test_a_clip_of_nothing_is_refused():
    with pytest.raises(ValueError, match="at least one segment"):
        Clip(())


def test_what_is_written_is_read_again(path, clip):
    same(load_scene(path.parent), clip)
    assert scene_info(path) == {"by": "a test"}


def test_each_segment_is_kept_as_precisely_as_was_said(tmp_path, clip):
    precision = ["full", "compact", "full"]
    for name in "once", "twice":
        save_scene(tmp_path / f"{name}.npz", clip, precision=precision)
        once, clip = clip, load_scene(tmp_path / f"{name}.npz")
    same(once, clip)
    read = load_scene(tmp_path / "once.npz").segments
    same(read[0], part(0, 0.25))
    whole = part(0.25, 0.5, speed=0.5)
    assert (np.asarray(read[1].static.mean) != np.asarray(whole.static.mean)).any()


@pytest.mark.parametrize("segments", [None, 3, ["x"], [{"version": 4}], [{}]])
def test_a_header_that_lists_no_segments_is_refused(path, segments):
    header, array = read_arrays(path, "gaussray-scene", 4)
    write_arrays(path, header | {"segments": segments}, array)
    with pytest.raises(ValueError, match="scene.npz: the header does not list its segments"):
        load_scene(path)


def test_a_header_that_lists_too_many_or_none_is_refused(path):
    header, array = read_arrays(path, "gaussray-scene", 4)
    write_arrays(path, header | {"segments": header["segments"] + [{"version": 1}]}, array)
    with pytest.raises(ValueError, match="segment 4: the array 'time_range' is missing"):
        load_scene(path)
    write_arrays(path, header | {"segments": []}, array)
    with pytest.raises(ValueError, match="at least one segment, got none. The scene is damaged"):
        load_scene(path)


def test_segments_on_disk_that_do_not_meet_are_refused(path):
    header, array = read_arrays(path, "gaussray-scene", 4)
    array["1.time_range"] = np.float32([0.3, 0.5])
    write_arrays(path, header, array)
    with pytest.raises(ValueError, match="scene.npz: segment 2 of a clip must begin where"):
        load_scene(path)


def test_a_range_that_is_no_pair_is_refused(path):
    header, array = read_arrays(path, "gaussray-scene", 4)
    array["1.time_range"] = np.float32([0.25])
    write_arrays(path, header, array)
    with pytest.raises(ValueError, match="segment 2: the array 'time_range' must hold two times"):
        load_scene(path)
