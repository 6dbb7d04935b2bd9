"""Pictures whose pose cannot be right are left out, and named."""

import dataclasses
import json

import numpy as np
import pytest

from gaussray.dataset.images import write_image
from gaussray.prepare import pipeline, poses
from gaussray.prepare.features import Keypoints, MatchingPicture
from gaussray.prepare.findings.cameras import camera_findings
from gaussray.prepare.findings.points import point_findings
from gaussray.prepare.options import FramesOptions, PosesOptions, PrepareOptions
from gaussray.prepare.placement import Placement
from gaussray.prepare.sources import Source
from gaussray.prepare.sparse_model import Observations, SparseModel, camera_centres
from gaussray.prepare.stray_poses import without_strays
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import common_timeline


pytest.importorskip("pycolmap")

LENS = {"camera_model": "PINHOLE", "w": 64, "h": 48, "fl_x": 50.0, "fl_y": 50.0}
LENS |= {"cx": 32.0, "cy": 24.0}
# All pictures see all points, but for the last one of the points: the first two pictures alone.
POINTS = 120


def placed(centres, still=(), known=False):
    """Photographs at these places; they look along z at points 5 ahead."""
    count = len(centres)
    poses = np.tile(np.eye(4)[:3], (count, 1, 1))
    poses[:, :, 3] = -np.array(centres, float)
    points = np.random.default_rng(0).uniform(-1, 1, (POINTS, 3)) + (0, 0, 5)
    point, picture = (x.ravel() for x in np.meshgrid(range(POINTS), range(count), indexing="ij"))
    mine = (point < POINTS - 1) | (picture < 2)
    point, picture = point[mine], picture[mine]
    seen = Observations(point, picture, point, np.zeros((len(point), 2)), np.zeros(len(point)))
    names = [f"000/{k:04d}.jpg" for k in range(count)]
    pictures = {name: MatchingPicture(name, "photos", k, (64, 48), f"IMG_{k}.jpg")
                for k, name in enumerate(names)}  # fmt: skip
    model = SparseModel(names, poses, [LENS] * count, points, seen, "pictures")
    keypoints = {name: Keypoints(np.zeros((POINTS, 2)), np.full(POINTS, k))
                 for k, name in enumerate(names)}  # fmt: skip
    return Placement(model, pictures, keypoints, {}, frozenset(still), known)


def with_few(placement, picture, count):
    """The placement in which a picture has so many observations left."""
    seen = placement.model.observations
    mine = np.flatnonzero(seen.picture == picture)
    left = np.delete(np.arange(len(seen.point)), mine[count:])
    values = {f.name: getattr(seen, f.name)[left] for f in dataclasses.fields(seen)}
    model = dataclasses.replace(placement.model, observations=Observations(**values))
    return dataclasses.replace(placement, model=model)


def ring(*more):
    return [(np.cos(k), np.sin(k), 0.0) for k in range(5)] + list(more)


def test_a_picture_far_outside_is_left_out_and_named():
    found = placed(ring((734924.4, 141099.1, 748746.1)))
    kept, (finding,) = without_strays(found)
    assert len(kept.model.pictures) == 5 and np.abs(camera_centres(kept.model)).max() <= 1
    assert finding.level == "warn" and "IMG_5.jpg (more than 50 times as far" in finding.text
    assert finding.remedy
    assert finding.text.startswith("1 of 6 poses cannot be right, and the picture is left out: IMG")
    # It is not told of again, as if it had got no pose, and not all are said to have one.
    assert camera_findings(kept) == []
    pictures = kept.pictures | {"7.jpg": MatchingPicture("7.jpg", "photos", 6, (64, 48), "IMG_6")}
    (missing,) = camera_findings(dataclasses.replace(kept, pictures=pictures))
    assert missing.text == "6 of 7 pictures have a pose; left out: IMG_6"
    seen = kept.model.observations
    assert seen.picture.max() == 4 and len(kept.model.points) == POINTS
    assert len(seen.point) == 5 * POINTS - 3


def test_a_capture_of_which_most_poses_cannot_be_right_is_refused():
    kept, _ = without_strays(placed(ring((734924.4, 141099.1, 748746.1))))
    kept = dataclasses.replace(kept, strays=frozenset(kept.model.pictures[1:]))
    few = dataclasses.replace(kept.model, pictures=kept.model.pictures[:1])
    (finding,) = camera_findings(dataclasses.replace(kept, model=few))
    assert finding.level == "refuse"
    assert finding.text == "only 1 of 6 pictures have a pose that can be right"


def test_points_that_a_single_picture_is_left_to_see_go_with_the_others():
    kept, _ = without_strays(placed([(9e9, 0, 0), *ring()]))
    assert len(kept.model.points) == POINTS - 1
    assert kept.model.observations.point.max() == POINTS - 2


def test_a_picture_with_hardly_an_observation_is_left_out_unless_its_camera_stands_still():
    found = with_few(placed(ring()), 3, 14)
    kept, (finding,) = without_strays(found)
    assert "000/0003.jpg" not in kept.model.pictures and len(kept.model.pictures) == 4
    assert "IMG_3.jpg (fewer than 15 observations)" in finding.text
    for other in (
        with_few(placed(ring()), 3, 15),
        with_few(placed(ring(), still={"photos"}), 3, 2),
        with_few(placed(ring((9e9, 0, 0)), known=True), 3, 2),
        placed([(0, 0, 0)] * 4 + ring()[:3]),  # most stand in one place
    ):
        assert without_strays(other) == (other, [])


def test_a_weak_pose_of_one_of_many_photographs_is_told():
    (finding,) = point_findings(with_few(placed(ring()), 3, 20))
    assert finding.text.startswith("IMG_3.jpg: fewer than 100 observations")
    (finding,) = point_findings(placed(ring()))
    assert finding.level == "good"


def test_a_capture_is_written_without_the_strays(tmp_path, monkeypatch):
    found = placed(ring((734924.4, 141099.1, 748746.1)))
    monkeypatch.setattr(pipeline, "find_poses", lambda *_: found)
    for k in range(6):
        write_image(
            tmp_path / "photos" / f"IMG_{k}.png",
            np.random.default_rng(k).integers(0, 256, (48, 64, 3), np.uint8),
        )
    facts = pipeline.prepare_capture(tmp_path / "photos", tmp_path / "out")
    frames = json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]
    assert [frame["file_path"][-5:] for frame in frames] == [f"{k}.png" for k in range(5)]
    told = [one["text"] for one in facts["findings"] if one["level"] == "warn"]
    assert any("IMG_5.jpg (more than" in text for text in told)
    assert facts["cameras"]["photos"]["registered"] == 5


def test_doubt_about_motion_comes_first(tmp_path, monkeypatch):
    found = with_few(placed(ring((9e9, 0, 0))), 3, 20)
    model = dataclasses.replace(found.model, focal_source="guess")
    found = dataclasses.replace(found, model=model, rig_untold=True)
    # Not all see more than a hundred points any more.
    monkeypatch.setattr("gaussray.prepare.findings.doubtful_motion.OBSERVATIONS", POINTS + 1)
    monkeypatch.setattr(pipeline, "find_poses", lambda *_: found)
    for k in range(6):
        levels = np.random.default_rng(k).integers(0, 256, (48, 64, 3), np.uint8)
        write_image(tmp_path / "photos" / f"IMG_{k}.png", levels)
    # Photographs without a time are taken to be of a camera that moves.
    frames = PrepareOptions(frames=FramesOptions(rate=10.0))
    facts = pipeline.prepare_capture(tmp_path / "photos", tmp_path / "out", options=frames)
    first, second = facts["findings"][:2]
    assert "the motion that was estimated is doubtful" in first["text"]
    assert second["text"].startswith("1 of 6 poses cannot be right")


@pytest.mark.parametrize("told", [True, False])
def test_that_pictures_do_not_tell_which_cameras_stand_still_is_kept(tmp_path, monkeypatch, told):
    found = placed(ring())
    everyone = [Source("photos", tmp_path, (), np.arange(5) / 10, ((64, 48),))]
    zeros = {"photos": 0.0}
    line = common_timeline(everyone, Sync("none", zeros, zeros, zeros), FramesOptions())
    shown = list(found.pictures.values())
    monkeypatch.setattr(poses, "standing_cameras", lambda *_: frozenset() if told else None)
    monkeypatch.setattr(poses, "_write_pictures", lambda *_: shown)
    monkeypatch.setattr(poses, "_placed", lambda *_: found)
    for name in ("_extract", "_check_features"):
        monkeypatch.setattr(poses, name, lambda *_: None)
    monkeypatch.setattr(poses, "full_pictures", lambda *_: frozenset())
    options = PrepareOptions(poses=PosesOptions(fov=0.0 if told else 60.0))
    kept = poses.find_poses(everyone, line, {"photos": []}, None, tmp_path, options)
    assert kept.rig_untold is not told and kept.fov_given is not told
