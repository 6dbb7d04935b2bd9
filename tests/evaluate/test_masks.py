"""Which pixels an evaluation takes to move, against medians by NumPy."""

import dataclasses
import json
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.evaluate import masks
from gaussray.evaluate.masks import MotionMasks, levels_and_mask


W, H, COUNT = 9, 6, 7
LENS = {"fl_x": 8.0, "fl_y": 8.0, "cx": 4.5, "cy": 3.0, "w": W, "h": H}


def film(seed):
    """Levels that stay, but for noise and a square that goes through the picture."""
    dice = np.random.default_rng(seed)
    still = dice.integers(60, 190, (H, W, 3))
    frames = np.clip(still[None] + dice.integers(-9, 10, (COUNT, H, W, 3)), 0, 255)
    for t in range(COUNT):
        frames[t, 2:4, t : t + 2] = 255 * (t % 2)
    return frames.astype(np.uint8)


def capture_of(folder, films, moving=False):
    """A capture of cameras that each show a film; `moving` ones go on their way meanwhile."""
    frames = []
    for c, levels in films.items():
        for t, picture in enumerate(levels):
            matrix = np.eye(4)
            matrix[0, 3] = ord(c) + 0.1 * t * moving
            name = f"images/{c}/{t}.png"
            write_image(folder / name, picture)
            frames.append({"file_path": name, "camera": c, "time": t / COUNT, "split": "test"})
            frames[-1]["transform_matrix"] = matrix.tolist()
    (folder / "transforms.json").write_text(json.dumps({**LENS, "frames": frames}))
    return open_capture(folder).views


def far(levels, median):
    return np.any(np.abs(levels.astype(float) - median) > 25.5, axis=-1)


def test_what_differs_from_the_median_of_its_viewpoint_moves(tmp_path):
    films = {c: film(seed) for seed, c in enumerate("ab")}
    views = capture_of(tmp_path, films)
    pixels = MotionMasks(views)
    for c, levels in films.items():
        median, own = np.median(levels, axis=0), [v for v in views if v.camera_name == c]
        moves = np.array([far(picture, median) for picture in levels])
        assert moves.any() and not moves.all(axis=0).any()
        for view, expected in zip(own, moves, strict=True):
            np.testing.assert_array_equal(pixels.moving(view, levels_and_mask(view)[0]), expected)
            np.testing.assert_array_equal(pixels.static(view), ~moves.any(axis=0))


def test_several_viewpoints_are_looked_at_together_a_part_at_a_time(tmp_path, monkeypatch):
    views = capture_of(tmp_path, {c: film(seed) for seed, c in enumerate("abc")})
    alone, together = MotionMasks(views), MotionMasks(views)
    monkeypatch.setattr(masks, "_BYTES", 2.5 * film(0).nbytes)
    asked = []
    with ThreadPoolExecutor(2) as threads:
        run = threads.map
        monkeypatch.setattr(threads, "map", lambda f, some: asked.append(len(some)) or run(f, some))
        together.find(views, threads)
        together.find(views, threads)
    assert asked == [2, 1]
    for view in views:
        np.testing.assert_array_equal(together.static(view), alone.static(view))


def test_of_a_long_video_pictures_that_are_evenly_spread_tell(tmp_path, monkeypatch):
    monkeypatch.setattr(masks, "_MOST", 4)
    levels = film(0)
    view = capture_of(tmp_path, {"a": levels})[1]
    some = levels[[0, 2, 4, 6]]
    median = np.median(some, axis=0)
    pixels = MotionMasks(capture_of(tmp_path, {"a": levels}))
    np.testing.assert_array_equal(pixels.moving(view, levels[1]), far(levels[1], median))
    static = ~np.any([far(picture, median) for picture in some], axis=0)
    np.testing.assert_array_equal(pixels.static(view), static)


def test_what_a_mask_hides_tells_nothing_of_what_moves(tmp_path):
    levels = film(0)
    hidden = np.zeros((COUNT, H, W), bool)
    # A pixel that flashes where most pictures hide it, and one that all of them hide.
    hidden[1:, 0, 0] = hidden[:, 0, 1] = True
    levels[1:, 0, 0] = 255
    levels[::2, 0, 1] = 255
    views = capture_of(tmp_path, {"a": levels})
    for t, mask in enumerate(hidden):
        write_image(tmp_path / f"masks/{t}.png", np.where(mask, 0, 255).astype(np.uint8))
    views = [dataclasses.replace(v, mask=tmp_path / f"masks/{t}.png") for t, v in enumerate(views)]
    shown = np.where(hidden[..., None], np.nan, levels.astype(float))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the pixel that is never shown
        median = np.nanmedian(shown, axis=0)
    pixels = MotionMasks(views)
    for t, view in enumerate(views):
        np.testing.assert_array_equal(
            pixels.moving(view, levels_and_mask(view)[0]) & ~hidden[t], far(shown[t], median)
        )
    moves = np.array([far(picture, median) for picture in shown])
    np.testing.assert_array_equal(pixels.static(views[0]), ~moves.any(axis=0))
    assert pixels.static(views[0])[0, :2].all()


@pytest.mark.parametrize("moving", [True, False])
def test_nothing_is_said_of_a_picture_that_is_the_only_one_of_its_viewpoint(tmp_path, moving):
    levels = film(0) if moving else film(0)[:1]
    views = capture_of(tmp_path, {"a": levels}, moving)
    pixels = MotionMasks(views)
    for view, picture in zip(views, levels, strict=True):
        assert pixels.moving(view, picture) is None and pixels.static(view) is None
