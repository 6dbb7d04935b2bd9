"""Attempts to find poses: those that fail are followed by simpler ones."""

import threading

import numpy as np
import pytest
from reconstructions import FOCAL, around, reconstruction

from gaussray.prepare import mapping
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.missing_poses import missing_poses_reason
from gaussray.prepare.options import PosesOptions


colmap = pytest.importorskip("pycolmap")

PICTURES = 6


@pytest.fixture
def database(tmp_path):
    """Six pictures of one camera with distortion, none of which matches another."""
    path = tmp_path / "features.db"
    with colmap.Database.open(path) as db:
        camera = colmap.Camera(
            model="SIMPLE_RADIAL", width=320, height=240, params=[FOCAL, 160, 120, 0.1]
        )
        number = db.write_camera(camera)
        for k in range(PICTURES):
            db.write_image(colmap.Image(name=f"{k + 1}.png", camera_id=number), False)
    return path


def registered(count, bend=0.0):
    found = reconstruction(around(PICTURES), bend=bend)
    for number in range(count + 1, PICTURES + 1):
        found.deregister_frame(found.image(number).frame_id)
    return found


def tried(monkeypatch, database, *found, best=12, **options):
    """The poses that are found if attempts end like this, and how the attempts were made. The best
    pair has so many matches."""
    made, left = [], list(found)
    monkeypatch.setattr(mapping, "best_pair", lambda database: best)

    def incremental(database, pictures, out, options, **_):
        with colmap.Database.open(database) as db:
            model = db.read_all_cameras()[0].model.name
        made.append((model, not options.ba_refine_focal_length))
        reconstruction = left.pop(0)
        return {} if reconstruction is None else {0: reconstruction}

    monkeypatch.setattr(colmap, "incremental_mapping", incremental)
    options = PosesOptions(**options)
    return mapping.estimate_poses(database, database.parent, options), made


def test_one_attempt_is_enough_if_most_pictures_have_a_pose(monkeypatch, database):
    model, made = tried(monkeypatch, database, registered(3))
    assert len(model.pictures) == 3 and made == [("SIMPLE_RADIAL", False)]


@pytest.mark.parametrize("first", [None, registered(2), registered(6, bend=12.0)])
def test_a_failed_attempt_is_repeated_without_distortion(monkeypatch, database, first, capsys):
    model, made = tried(monkeypatch, database, first, registered(5))
    assert len(model.pictures) == 5
    assert made == [("SIMPLE_RADIAL", False), ("SIMPLE_PINHOLE", False)]
    assert "poses.model=radial: once more with pinhole" in capsys.readouterr().out


def test_at_last_the_focal_length_is_held(monkeypatch, database):
    model, made = tried(monkeypatch, database, registered(2), None, registered(6))
    assert len(model.pictures) == 6
    assert made[-1] == ("SIMPLE_PINHOLE", True)
    # It is learnt once all pictures have a pose.
    assert model.lenses[0]["fl_x"] != FOCAL
    assert model.lenses[0]["fl_x"] == pytest.approx(FOCAL, rel=0.03)


def test_a_given_lens_is_fixed_and_tried_once(monkeypatch, database):
    fixed = []

    def incremental(database, pictures, out, options, **_):
        refined = options.ba_refine_focal_length or options.ba_refine_extra_params
        posed = options.mapper.abs_pose_refine_focal_length
        with colmap.Database.open(database) as db:
            cameras = {camera.camera_id for camera in db.read_all_cameras()}
        fixed.append(not (refined or posed) and options.constant_cameras == cameras)
        return {0: registered(2)}

    monkeypatch.setattr(colmap, "incremental_mapping", incremental)
    model = mapping.poses_with_given_lenses(database, database.parent, PosesOptions())
    # Two of six pictures are poor, but another lens is no remedy.
    assert fixed == [True] and len(model.pictures) == 2 and model.focal_source == "lens"
    assert model.lenses[0]["fl_x"] == FOCAL


def test_a_later_attempt_counts_only_if_it_is_better(monkeypatch, database):
    model, _ = tried(monkeypatch, database, registered(2), None, None)
    assert len(model.pictures) == 2
    with pytest.raises(PrepareError):
        tried(monkeypatch, database, None, None, None)


def test_what_is_likely_to_fail_is_tried_once(monkeypatch, database, capsys):
    made = []
    monkeypatch.setattr(mapping, "best_pair", lambda database: 80)
    monkeypatch.setattr(colmap, "incremental_mapping", lambda *_, **__: made.append(1) or {})
    with pytest.raises(PrepareError):
        mapping.estimate_poses(database, database.parent, PosesOptions(), once=True)
    assert made == [1] and "attempts." not in capsys.readouterr().out.splitlines()[0]


def test_a_single_picture_is_not_tried(tmp_path, monkeypatch):
    path = tmp_path / "one.db"
    with colmap.Database.open(path) as db:
        camera = colmap.Camera(
            model="SIMPLE_PINHOLE", width=320, height=240, params=[FOCAL, 160, 120]
        )
        db.write_image(colmap.Image(name="1.png", camera_id=db.write_camera(camera)), False)
    monkeypatch.delattr(colmap, "incremental_mapping")
    with pytest.raises(PrepareError, match="single camera that stands still") as told:
        mapping.estimate_poses(path, tmp_path, PosesOptions())
    # Of one camera that stands still a calibration makes no points.
    assert "calibration" not in str(told.value)


def test_a_pinhole_is_not_tried_twice(monkeypatch, database):
    _, made = tried(monkeypatch, database, registered(2), registered(6), model="pinhole")
    assert [held for _, held in made] == [False, True]


def test_pictures_from_one_place_are_not_tried_again(monkeypatch, database):
    monkeypatch.setattr(mapping, "flat_pairs", lambda database: (1.0, 10))
    with pytest.raises(PrepareError):
        tried(monkeypatch, database, None)


def test_pictures_of_which_no_pair_has_enough_matches_are_not_tried_again(monkeypatch, database):
    # A second attempt would fail here, because it has no end.
    with pytest.raises(PrepareError, match="must show texture"):
        tried(monkeypatch, database, None, best=11)


def test_progress_counts_the_pictures_of_each_attempt(tmp_path, database, monkeypatch):
    reports = []

    class Recorder(mapping.Progress):
        def report(self, done, note=""):
            super().report(done, note)
            reports.append((done, note))

    def incremental(*_, initial_image_pair_callback, next_image_callback):
        for placed in (3, PICTURES):
            initial_image_pair_callback()
            for _ in range(placed - 2):
                next_image_callback()
        return {0: registered(PICTURES)}

    said = []
    monkeypatch.setattr(mapping, "Progress", Recorder)
    monkeypatch.setattr(mapping, "say", said.append)
    monkeypatch.setattr(colmap, "incremental_mapping", incremental)
    mapping.estimate_poses(database, tmp_path, PosesOptions())
    first, second = "have a pose in attempt 1", "have a pose in attempt 2"
    assert reports[:5] == [(2, first), (3, first), *((k, second) for k in (2, 3, 4))]
    # All pictures are no end: the mapper goes on.
    assert reports[5:] == [(5, second)]
    text = f"{PICTURES} of {PICTURES} pictures have a pose in the best of 2 attempts."
    assert said[-1] == text


def test_a_search_that_places_nothing_tells_that_it_goes_on(tmp_path, database, monkeypatch):
    told = threading.Event()

    class Recorder(mapping.Progress):
        def report(self, done, note=""):
            assert (done, note) == (0, "two are sought to begin with")
            told.set()

    def incremental(*_, **__):
        # Nothing is placed, and it ends once that is told, at the latest after so many seconds.
        assert told.wait(20.0)
        return {0: registered(5)}

    monkeypatch.setattr(mapping, "_BEAT", 0.01)
    monkeypatch.setattr(mapping, "Progress", Recorder)
    monkeypatch.setattr(colmap, "incremental_mapping", incremental)
    mapping.estimate_poses(database, tmp_path, PosesOptions())


def test_progress_of_poses_has_no_time_left_before_the_end(tmp_path, database, monkeypatch):
    lines = []

    class Written(mapping.Progress):
        """Writes every report."""

        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options | {"patience": 0.0, "write": lines.append})

        def report(self, done, note=""):
            self.shown = -float("inf")
            super().report(done, note)

    def incremental(*_, initial_image_pair_callback, next_image_callback):
        initial_image_pair_callback()
        for _ in range(3):
            next_image_callback()
        return {0: registered(5)}

    monkeypatch.setattr(mapping, "Progress", Written)
    monkeypatch.setattr(colmap, "incremental_mapping", incremental)
    mapping.estimate_poses(database, tmp_path, PosesOptions())
    assert len(lines) == 4 and not any("left" in line for line in lines)
    assert lines[-1].startswith("poses 5/6  have a pose in attempt 1")


def test_cameras_without_distortion_keep_the_rest(monkeypatch, database):
    tried(monkeypatch, database, None, registered(6))
    with colmap.Database.open(database) as db:
        (camera,) = db.read_all_cameras()
    assert camera.model.name == "SIMPLE_PINHOLE"
    assert np.allclose(camera.params, [FOCAL, 160, 120])


def pair(path, matches, homography=False):
    """A database of two pictures, of which one geometry explains so many matches."""
    rows = np.repeat(np.arange(matches, dtype=np.uint32)[:, None], 2, axis=1)
    kinds = colmap.TwoViewGeometryConfiguration
    with colmap.Database.open(path) as db:
        number = db.write_camera(
            colmap.Camera(model="SIMPLE_PINHOLE", width=320, height=240, params=[FOCAL, 160, 120])
        )
        images = [
            db.write_image(colmap.Image(name=f"{k}.png", camera_id=number), False) for k in (1, 2)
        ]
        for image in images:
            db.write_keypoints(image, np.random.default_rng(image).uniform(0, 200, (100, 2)))
        geometry = colmap.TwoViewGeometry()
        geometry.config = kinds.PLANAR_OR_PANORAMIC if homography else kinds.UNCALIBRATED
        geometry.inlier_matches = rows
        db.write_two_view_geometry(*images, geometry)
    return path


@pytest.mark.parametrize("still", [False, True])
def test_matches_that_give_no_poses_are_counted_and_remedies_named(tmp_path, still):
    reason = missing_poses_reason(pair(tmp_path / "a.db", 80), still)
    assert "got 80 verified matches" in reason and "poses.calibration=FILE" in reason
    assert ("poses.rig=moving frames.rate=1" in reason) == still
    reason = missing_poses_reason(pair(tmp_path / "b.db", 20), still)
    assert "50 of a pair, got 20" in reason and "add cameras between" in reason


def test_of_two_pictures_a_homography_alone_tells_that_there_is_no_parallax(tmp_path):
    """Whatever becomes a point of it: no third picture tests that."""
    assert mapping.lacks_parallax(pair(tmp_path / "a.db", 80, homography=True), 160)
    assert not mapping.lacks_parallax(pair(tmp_path / "b.db", 80), 160)


def test_two_pictures_alone_make_points_and_others_need_a_third(tmp_path, database, monkeypatch):
    asked = []

    def incremental(database, pictures, out, options, **_):
        asked.append(options)
        return {}

    monkeypatch.setattr(colmap, "incremental_mapping", incremental)
    for path in (database, pair(tmp_path / "two.db", 80)):
        with pytest.raises(PrepareError):
            mapping.estimate_poses(path, tmp_path, PosesOptions(model="opencv_fisheye"))
    usual, (many, two) = colmap.IncrementalPipelineOptions(), asked
    assert many.triangulation.ignore_two_view_tracks
    assert many.mapper.init_min_tri_angle == usual.mapper.init_min_tri_angle
    assert many.mapper.filter_min_tri_angle == usual.mapper.filter_min_tri_angle
    assert many.triangulation.min_angle == usual.triangulation.min_angle
    assert not two.triangulation.ignore_two_view_tracks
    assert two.mapper.init_min_tri_angle < 2
