"""Brightness of the cameras, by the points that they share and by their pictures."""

from dataclasses import replace

import numpy as np
import pytest

from gaussray.color import srgb_encode
from gaussray.dataset.images import write_image
from gaussray.prepare.exposure import (
    LEAST_SHARED,
    ObservedLevels,
    exposure_gains,
    observed_levels,
    picture_gains,
)
from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import Observations, SparseModel


def placed(counts, size=(64, 48)):
    """Cameras that see the first so many of the points."""
    point = np.concatenate([np.arange(count) for count in counts])
    picture = np.repeat(np.arange(len(counts)), counts)
    xy = np.stack([10 + point % 40, 10 + point // 40], axis=1).astype(float)
    seen = Observations(point, picture, point, xy, np.zeros(len(point)))
    files = [f"{k}.png" for k in range(len(counts))]
    lens = {"w": size[0], "h": size[1]}
    points = np.zeros((max(counts), 3))
    poses = np.zeros((len(files), 3, 4))
    model = SparseModel(files, poses, [lens] * len(files), points, seen)
    pictures = {f: MatchingPicture(f, f"cam{k}", 0, size) for k, f in enumerate(files)}
    keypoints = {f: Keypoints(xy, np.zeros(len(point), int)) for f in files}
    return Placement(model, pictures, keypoints, {}, frozenset(), known=True)


def encoded(light):
    """8-bit levels of linear light."""
    return np.round(255 * srgb_encode(np.asarray(light)))


def test_gains_are_found_by_shared_points():
    placement = placed([40, 40])
    light = np.tile(np.linspace(0.1, 0.4, 40), 2)[:, None] * np.repeat([1.0, 2.0], 40)[:, None]
    levels = np.repeat(encoded(light), 3, axis=1)
    gains = exposure_gains(placement, ObservedLevels(levels, {"cam0": 150.0, "cam1": 200.0}, {}))
    assert [count for _, count in gains.values()] == [40, 40]
    np.testing.assert_allclose(gains["cam0"][0], -0.5, atol=0.05)
    np.testing.assert_allclose(gains["cam1"][0], 0.5, atol=0.05)


def test_gains_of_pictures_are_found_where_a_camera_is_on_its_way():
    placement = placed([40, 40, 40, 5])
    gain = np.repeat([0.5, 1.0, 2.0, 1.0], [40, 40, 40, 5])
    scene = np.linspace(0.1, 0.4, 40)[placement.model.observations.point]
    levels = ObservedLevels(np.repeat(encoded((scene * gain)[:, None]), 3, axis=1), {}, {})
    assert picture_gains(placement, levels) == {}
    pictures = {
        name: replace(x, camera="phone", instant=k)
        for k, (name, x) in enumerate(placement.pictures.items())
    }
    found = picture_gains(replace(placement, pictures=pictures), levels)
    assert list(found) == ["phone 0", "phone 1", "phone 2", "phone 3"]
    for stops, expected in zip(found.values(), (-1, 0, 1), strict=False):
        np.testing.assert_allclose(stops, expected, atol=0.05)
    # One that shares too few points is unknown.
    assert np.isnan(found["phone 3"]).all()
    # Each is compared with those of its own camera; one of another camera with none.
    other = pictures | {"2.png": replace(pictures["2.png"], camera="other")}
    found = picture_gains(replace(placement, pictures=other), levels)
    assert list(found) == ["phone 0", "phone 1", "phone 3"]
    np.testing.assert_allclose(np.stack(list(found.values()))[:2, 0], [-0.5, 0.5], atol=0.05)


@pytest.mark.parametrize(("brightest", "stops"), [(15.0, -5.4), (0.0, -9.3), (150.0, 0.0)])
def test_a_camera_without_shared_points_is_darker_or_unknown(brightest, stops):
    placement = placed([40, 40, LEAST_SHARED - 1])
    levels = np.full((len(placement.model.observations.point), 3), 100.0)
    levels[80:] = 8
    bright = {"cam0": 120.0, "cam1": 120.0, "cam2": brightest}
    gain, count = exposure_gains(placement, ObservedLevels(levels, bright, {}))["cam2"]
    assert count == 0
    np.testing.assert_allclose(gain, stops, atol=0.2)


def test_pictures_have_brightness_without_any_observation(tmp_path):
    files = {}
    for k, level in enumerate((200, 9)):
        path = tmp_path / f"{k}.png"
        shown = np.full((48, 64, 3), level, np.uint8)
        # One channel is enough to hide the light.
        shown[: 12 * k, :, 1] = 255
        write_image(path, shown)
        files[f"cam{k}"] = [path]
    levels = observed_levels(placed([30, 0]), files)
    assert levels.brightest == {"cam0": 200.0, "cam1": 255.0}
    assert levels.clipped == {"cam0": 0.0, "cam1": 0.25}
    assert np.all(levels.observed == 200)
