"""Two cameras: that stand still, in two places or in one, and that move."""

import json

import numpy as np
import pytest
from quads import arc, looking, picture, write_video

from gaussray.capture.open import open_capture
from gaussray.prepare import prepare_capture, timeline
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.options import FramesOptions, PosesOptions, PrepareOptions, SyncOptions


pytest.importorskip("pycolmap")

# Degrees: two pictures of 320 x 240 tell the turn between them and the way from one to the other.
TURN, WAY = 1.0, 6.0
PINHOLE = PosesOptions(model="pinhole")


def prepared(folder, paths, painted, frames=None):
    """The facts of videos whose cameras are at these places at each time."""
    (folder / "in").mkdir()
    for name, poses in paths.items():
        write_video(folder / "in" / f"{name}.mp4", [picture(pose, painted) for pose in poses])
    options = PrepareOptions(SyncOptions(method="none"), frames or FramesOptions(), PINHOLE)
    return prepare_capture(folder / "in", folder / "out", options=options)


def degrees(cosine):
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_two_cameras_that_stand_still_have_poses(tmp_path, painted):
    poses = arc(2, -5, 5)
    facts = prepared(tmp_path, {n: [p] * 4 for n, p in zip("ab", poses, strict=True)}, painted)
    assert facts["still"] and facts["points"] > 100
    assert [one["registered"] for one in facts["cameras"].values()] == [1, 1]
    views = {view.camera_name: view.camera for view in open_capture(tmp_path / "out").views}
    document = json.loads((tmp_path / "out" / "transforms.json").read_text())
    found = {f["camera"]: np.array(f["transform_matrix"])[:3] for f in document["frames"]}
    assert set(found) == set(views) == {"a", "b"}
    # Camera to world in OpenGL axes.
    for matrix in found.values():
        matrix[:, 1:3] *= -1
    (a, b), (first, second) = (found["a"], found["b"]), poses
    true = second[:, :3] @ first[:, :3].T
    turn = b[:, :3].T @ a[:, :3]
    assert degrees((np.trace(turn @ true.T) - 1) / 2) < TURN
    way = a[:, :3].T @ (b[:, 3] - a[:, 3])
    places = [-pose[:, :3].T @ pose[:, 3] for pose in poses]
    expected = first[:, :3] @ (places[1] - places[0])
    assert degrees(way @ expected / np.linalg.norm(way) / np.linalg.norm(expected)) < WAY


@pytest.mark.parametrize("turn", [0.2, 3.0])
def test_two_cameras_in_one_place_are_refused(tmp_path, painted, turn):
    poses = [looking((0, -3.5, 1.9), (x, 1.5, 0.8)) for x in (-turn / 2, turn / 2)]
    with pytest.raises(PrepareError, match="got pictures without parallax"):
        prepared(tmp_path, {n: [p] * 4 for n, p in zip("ab", poses, strict=True)}, painted)


@pytest.mark.parametrize("rate", [0.0, 15.0])
def test_of_two_cameras_that_move_every_kth_timestamp_is_used(
    tmp_path, painted, monkeypatch, capsys, rate
):
    """Ten timestamps of two cameras, and at most eight pictures."""
    monkeypatch.setattr(timeline, "MOST_OF_ONE", 8)
    paths = {
        name: [
            looking((4.5 * np.sin(a), 1.5 - 4.5 * np.cos(a), height))
            for a in np.radians(np.linspace(-15, 15, 10))
        ]
        for name, height in (("high", 2.2), ("low", 1.6))
    }
    facts = prepared(tmp_path, paths, painted, FramesOptions(rate=rate, instants=3))
    used = 10 if rate else 4
    document = json.loads((tmp_path / "out" / "transforms.json").read_text())
    for name in paths:
        frames = [one for one in document["frames"] if one["camera"] == name]
        numbers = [int(one["file_path"].split("/")[-1]) for one in frames]
        assert numbers == list(range(0, 10, 1 if rate else 3))
        assert [one["time"] for one in frames] == pytest.approx(np.array(numbers) / 15, abs=1e-6)
        assert facts["cameras"][name]["pictures"] == facts["cameras"][name]["registered"] == used
    assert facts["timestamps"] == used and not facts["still"]
    lines = [line for line in capsys.readouterr().out.splitlines() if "timestamps are used" in line]
    if rate:
        assert not lines
    else:
        (line,) = lines
        assert line.startswith("high, low: the cameras move") and "4 of 10 timestamps" in line
        assert "frames.rate=15 takes them all" in line
