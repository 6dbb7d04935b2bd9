"""A logo over the pictures decides about no pose."""

import numpy as np
import pytest
from quads import arc, looking, picture, write_video

from gaussray.dataset.images import write_image
from gaussray.prepare import prepare_capture
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.features import MatchingPicture, raw_matches, read_keypoints, verified_matches
from gaussray.prepare.options import FramesOptions, PosesOptions, PrepareOptions, SyncOptions
from gaussray.prepare.overlays import check_overlays, without_overlays


colmap = pytest.importorskip("pycolmap")

SIZE = (320, 240)


def marked(shown):
    """A picture with a logo in a corner."""
    logo = np.random.default_rng(7).integers(0, 2, (12, 60, 3)) * 255
    result = shown.copy()
    result[180:228, 60:300] = logo.astype(np.uint8).repeat(4, 0).repeat(4, 1)
    return result


def database(folder, cameras, same, moved, views, logo=True):
    """Pictures of which every two share matches at the same place, in a corner or everywhere, and
    others elsewhere."""
    rng = np.random.default_rng(0)
    places = rng.uniform((20, 20), (200, 200), (same + moved, 2))
    if logo:
        places[:same] = rng.uniform((240, 200), (300, 230), (same, 2))
    pictures = [MatchingPicture(f"{k}.png", c, k, SIZE) for k, c in enumerate(cameras)]
    with colmap.Database.open(folder / "f.db") as db:
        camera = colmap.Camera(
            model="SIMPLE_PINHOLE", width=320, height=240, params=[300, 160, 120]
        )
        number, images = db.write_camera(camera), []
        for k, one in enumerate(pictures):
            write_image(folder / one.file, views[k])
            images.append(db.write_image(colmap.Image(name=one.file, camera_id=number), False))
            moves = (np.arange(same + moved) >= same)[:, None] * (3.0 * k, 0)
            db.write_keypoints(images[-1], (places + moves).astype(np.float32))
        rows = np.repeat(np.arange(same + moved, dtype=np.uint32)[:, None], 2, axis=1)
        for a in range(len(images)):
            for b in range(a + 1, len(images)):
                geometry = colmap.TwoViewGeometry()
                geometry.config = colmap.TwoViewGeometryConfiguration.UNCALIBRATED
                geometry.inlier_matches = rows
                db.write_matches(images[a], images[b], rows)
                db.write_two_view_geometry(images[a], images[b], geometry)
    by_file = {one.file: one for one in pictures}
    return folder / "f.db", by_file, read_keypoints(folder / "f.db", pictures)


@pytest.fixture(scope="module")
def views(painted):
    """Two views of the room from two sides, and one beside the first."""
    places = ((0, -3.5, 1.8), (4.5, 1.0, 1.8), (0.02, -3.5, 1.8))
    return [picture(looking(place), painted) for place in places]


@pytest.mark.parametrize(("moved", "linked"), [(5, False), (30, True), (60, True)])
def test_matches_at_the_same_place_are_taken_out(tmp_path, views, moved, linked):
    path, pictures, keypoints = database(tmp_path, "ab", 80, moved, views)
    (overlay,) = without_overlays(path, tmp_path, pictures, keypoints)
    assert (overlay.cameras, overlay.same, overlay.total) == (("a", "b"), 80, 80 + moved)
    assert not verified_matches(path)
    ((_, rows),) = raw_matches(path).items()
    assert len(rows) == moved and rows.min() >= 80
    with colmap.Database.open(path) as db:
        geometry = colmap.TwoViewGeometry()
        geometry.inlier_matches = rows.astype(np.uint32)
        db.write_two_view_geometry(1, 2, geometry)
    reason = check_overlays([overlay], path, pictures)
    assert bool(reason) != linked
    assert linked or f"a logo or a counter drawn over them (80 of {80 + moved} matches)" in reason


@pytest.mark.parametrize(
    ("cameras", "same", "shown", "logo"),
    [
        # A video and its copy; most matches elsewhere; a tripod's pictures, in which little moves;
        # a background too far away to move.
        ("ab", 80, (0, 2), True),
        ("ab", 30, (0, 1), True),
        ("aaa", 80, (0, 2, 0), True),
        ("ab", 80, (0, 1), False),
    ],
)
def test_other_matches_stay(tmp_path, views, cameras, same, shown, logo):
    shown = [views[k] for k in shown]
    path, pictures, keypoints = database(tmp_path, cameras, same, 40, shown, logo)
    before = verified_matches(path)
    assert not without_overlays(path, tmp_path, pictures, keypoints)
    after = verified_matches(path)
    assert {p: len(r) for p, r in after.items()} == {p: len(r) for p, r in before.items()}
    assert not check_overlays([], path, pictures)


def test_a_camera_with_a_logo_over_some_of_its_pictures_is_told_and_may_go_on(tmp_path, views):
    path, pictures, keypoints = database(tmp_path, "aa", 80, 20, views)
    (overlay,) = without_overlays(path, tmp_path, pictures, keypoints)
    assert overlay.cameras == ("a", "a") and "a: the pictures differ" in overlay.text
    assert not check_overlays([overlay], path, pictures)


def prepared(folder, degrees, painted, rig="auto"):
    """Two cameras that stand still so many degrees apart, with a logo over their pictures."""
    (folder / "in").mkdir()
    for name, pose in zip("ab", arc(2, -degrees / 2, degrees / 2), strict=True):
        write_video(folder / "in" / f"{name}.mp4", [marked(picture(pose, painted))] * 4)
    poses = PosesOptions(model="pinhole", rig=rig)
    options = PrepareOptions(SyncOptions(method="none"), FramesOptions(), poses)
    return prepare_capture(folder / "in", folder / "out", options=options)


@pytest.mark.parametrize("rig", ["auto", "moving"])
def test_two_sides_under_one_logo_are_refused_with_the_logo(tmp_path, painted, rig):
    with pytest.raises(PrepareError, match="a and b show different .* a logo") as told:
        prepared(tmp_path, 150, painted, rig)
    assert "poses.rig" not in str(told.value) and "cut it off" in str(told.value)


def test_neighbours_under_one_logo_have_poses(tmp_path, painted):
    facts = prepared(tmp_path, 10, painted)
    assert [one["registered"] for one in facts["cameras"].values()] == [1, 1]
    assert not any("show the same pictures" in one["text"] for one in facts["findings"])
