"""Whole captures from videos and pictures of a room whose cameras are known."""

import json

import numpy as np
import pytest
from PIL import Image
from quads import (
    FOCAL,
    RATE,
    SIZE,
    arc,
    looking,
    mover_at,
    picture,
    textures,
    write_pictures,
    write_video,
)
from scipy.spatial.transform import Rotation

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.geometry import BLENDER_AXES
from gaussray.prepare import features, pipeline, prepare_capture
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.options import FramesOptions, PosesOptions, PrepareOptions, SyncOptions
from gaussray.prepare.standing_cameras import standing_cameras, tell_standing
from gaussray.report import write_page


pytest.importorskip("pycolmap")

CAMERAS, COUNT = 5, 12
# Errors of poses from pictures of 320 x 240, as a share of the distance and in degrees.
PLACE, TURN = 0.02, 0.7
TOGETHER = SyncOptions(method="none")


@pytest.fixture(scope="module")
def videos(tmp_path_factory, painted):
    """Videos of five cameras that stand still; the second one is brighter by half a stop."""
    folder = tmp_path_factory.mktemp("videos")
    for k, pose in enumerate(arc(CAMERAS)):
        gain = 2**0.5 if k == 1 else 1.0
        frames = [picture(pose, painted, mover_at(i / RATE), gain) for i in range(COUNT)]
        write_video(folder / f"cam{k}.mp4", frames)
    return folder


def world_from_camera(capture, name):
    """Camera to world [3, 4] in OpenCV axes, as transforms.json says."""
    document = json.loads((capture / "transforms.json").read_text())
    frame = next(f for f in document["frames"] if f.get("camera", f["file_path"]) == name)
    matrix = np.array(frame["transform_matrix"])[:3]
    matrix[:, :3] *= BLENDER_AXES
    return matrix


def write_tagged(path, levels, orientation):
    """A JPEG whose tag says how it is seen."""
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(np.ascontiguousarray(levels)).save(path, quality=97, exif=exif)


def compared(found, true):
    """Largest errors of place and turn after the similarity that fits the places best."""
    here = found[:, :, 3] - found[:, :, 3].mean(0)
    there = true[:, :, 3] - true[:, :, 3].mean(0)
    turn, _ = Rotation.align_vectors(there, here)
    scale = np.sqrt((there**2).sum() / (here**2).sum())
    places = np.linalg.norm(scale * turn.apply(here) - there, axis=1)
    turns = [
        np.degrees((Rotation.from_matrix(t) * (turn * Rotation.from_matrix(f)).inv()).magnitude())
        for f, t in zip(found[:, :, :3], true[:, :, :3], strict=True)
    ]
    return places.max(), max(turns)


def inverted(poses):
    return np.array([np.column_stack([p[:, :3].T, -p[:, :3].T @ p[:, 3]]) for p in poses])


@pytest.fixture(scope="module")
def prepared(videos, tmp_path_factory):
    out = tmp_path_factory.mktemp("capture")
    options = PrepareOptions(
        sync=TOGETHER,
        frames=FramesOptions(instants=2, readout=0.01),
        poses=PosesOptions(model="pinhole"),
    )
    return out, prepare_capture(videos, out, options=options)


@pytest.mark.ci
def test_poses_and_focal_length_are_those_of_the_cameras(prepared):
    out, facts = prepared
    names = [f"cam{k}" for k in range(CAMERAS)]
    found = np.array([world_from_camera(out, name) for name in names])
    place, turn = compared(found, inverted(arc(CAMERAS)))
    assert place < PLACE * 5
    assert turn < TURN
    assert facts["still"] and facts["points"] > 100
    assert facts["cameras"]["cam0"]["lens"]["fl_x"] == pytest.approx(FOCAL, rel=0.03)


def test_the_capture_opens_with_times_shutters_and_points(prepared):
    out, _ = prepared
    capture = open_capture(out)
    assert len(capture.views) == CAMERAS * COUNT and capture.time_unit == "seconds"
    assert {view.camera_name for view in capture.views} == {f"cam{k}" for k in range(CAMERAS)}
    times = sorted({view.time for view in capture.views})
    assert times == pytest.approx(np.arange(COUNT) / RATE, abs=1e-5)
    shutter = capture.views[0].camera.shutter
    # The middle row is exposed at the frame's time.
    assert float(shutter.row_offset) == pytest.approx(-0.005)
    assert float(shutter.row_step) * (SIZE[1] - 1) == pytest.approx(0.01)
    assert capture.points is not None and len(capture.points.position) > 100


def test_points_lie_on_the_quads_and_have_their_colours(prepared):
    _, facts = prepared
    assert facts["cameras"]["cam0"]["error"][0] < 1
    levels = {one["subject"]: one["level"] for one in facts["findings"]}
    assert levels["cameras"] == levels["lens"] == levels["epipolar lines"] == "good"


def test_a_brighter_camera_is_measured(prepared):
    _, facts = prepared
    gains = np.array([one["exposure"] for one in facts["cameras"].values()])
    others = np.delete(gains, 1, axis=0)
    assert gains[1] - others.mean(0) == pytest.approx(0.5, abs=0.1)
    assert np.abs(others - others.mean(0)).max() < 0.1
    worst = [one for one in facts["findings"] if one["subject"] == "exposure"]
    assert worst[0]["level"] == "warn" and "cam1" in worst[0]["text"]


def test_the_report_shows_pictures_and_lines(prepared):
    out, facts = prepared
    text = write_page("prepare", out).read_text()
    assert text.count("<image ") == 2 * len(facts["epipolar"]) > 0
    assert "fit.refine=[exposure]" in text and text.count("<path d=") > 10
    # A sentence begins with a capital, unless it begins with a camera's name.
    assert "<dd>cam1 differs from" in text and "<dd>The videos start together" in text


@pytest.fixture
def toml(tmp_path):
    """Writes the true cameras, or others in their place, as Pose2Sim does."""

    def write(poses, distortion=(0.0, 0.0, 0.0, 0.0)):
        text = ""
        for k, pose in enumerate(poses):
            vector = Rotation.from_matrix(pose[:, :3]).as_rotvec().tolist()
            centre = [SIZE[0] / 2 - 0.5, SIZE[1] / 2 - 0.5]
            matrix = [[FOCAL, 0.0, centre[0]], [0.0, FOCAL, centre[1]], [0.0, 0.0, 1.0]]
            text += f"[cam{k}]\nsize = {list(SIZE)}\nmatrix = {matrix}\nrotation = {vector}\n"
            text += f"translation = {pose[:, 3].tolist()}\ndistortions = {list(distortion)}\n"
        path = tmp_path / "rig.toml"
        path.write_text(text)
        return str(path)

    return write


def known(path):
    return PrepareOptions(
        sync=TOGETHER, frames=FramesOptions(instants=1), poses=PosesOptions(calibration=path)
    )


def test_known_cameras_stay_and_points_are_where_surfaces_are(videos, tmp_path, toml):
    out = tmp_path / "capture"
    facts = prepare_capture(videos, out, options=known(toml(arc(CAMERAS))))
    assert facts["calibrated"] and facts["cameras"]["cam0"]["error"][0] < 0.7
    for k, pose in enumerate(inverted(arc(CAMERAS))):
        assert world_from_camera(out, f"cam{k}") == pytest.approx(pose, abs=1e-6)
    points = np.asarray(open_capture(out).points.position)
    # The floor and the back wall hold most of what all cameras see.
    on = (np.abs(points[:, 2]) < 0.05) | (np.abs(points[:, 1] - 4) < 0.05)
    assert on.mean() > 0.3


def test_lenses_with_large_coefficients_see_points_too(videos, tmp_path, toml):
    """k3 = 1.05 moves what is 0.3 focal lengths from the centre by less than 0.1 pixels."""
    path = toml(arc(CAMERAS), (0.0, 0.0, 0.0, 0.0, 1.05))
    assert prepare_capture(videos, tmp_path / "capture", options=known(path))["points"] > 100


def test_poses_do_not_stay_beside_pictures_that_are_replaced(videos, tmp_path, toml, monkeypatch):
    def stopped(*_):
        assert not (tmp_path / "transforms.json").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "copy_media", stopped)
    (tmp_path / "transforms.json").write_text("{}")
    with pytest.raises(PrepareError, match="does not exist|must name every camera"):
        prepare_capture(videos, tmp_path, options=known(toml(arc(1))))
    assert (tmp_path / "transforms.json").exists()
    with pytest.raises(KeyboardInterrupt):
        prepare_capture(videos, tmp_path, options=known(toml(arc(CAMERAS))))


def test_photographs_from_one_place_are_not_matched_with_each_other(
    tmp_path, toml, painted, monkeypatch
):
    poses, matched = [*arc(3, -15, 15), arc(3, -15, 15)[0]], []
    folder = tmp_path / "photos"
    for k, pose in enumerate(poses):
        write_image(folder / f"cam{k}.png", picture(pose, painted))
    match = features.match_features

    def match_and_note(database, pairs, seed):
        matched.extend(pairs)
        match(database, pairs, seed)

    monkeypatch.setattr(features, "match_features", match_and_note)
    facts = prepare_capture(folder, tmp_path / "out", options=known(toml(poses)))
    assert facts["points"] > 100 and len(matched) == 5
    assert {"000", "003"} not in [{a[:3], b[:3]} for a, b in matched]
    (warning,) = (one for one in facts["findings"] if "the same pose" in one["text"])
    assert warning["level"] == "warn" and warning["text"].startswith("cam0 and cam3 have")


def test_a_camera_without_a_pose_is_left_out_with_its_video(videos, tmp_path, toml):
    path = toml(arc(CAMERAS))
    with open(path, "a") as file:
        file.write("ignore = true\n")
    out = tmp_path / "capture"
    facts = prepare_capture(videos, out, options=known(path))
    names = [f"cam{k}" for k in range(CAMERAS - 1)]
    assert list(facts["cameras"]) == names
    assert {view.camera_name for view in open_capture(out).views} == set(names)
    (first, *_) = (one for one in facts["findings"] if one["level"] == "warn")
    assert first["text"].startswith(f"cam{CAMERAS - 1}: left out") and first["remedy"]


def test_the_calibration_of_other_cameras_is_refused_with_a_remedy(videos, tmp_path, toml):
    out = tmp_path / "capture"
    path = toml(arc(CAMERAS)[::-1])
    with pytest.raises(PrepareError, match="check the order of the cameras"):
        prepare_capture(videos, out, options=known(path))
    assert not (out / "transforms.json").exists() and (out / "prepare.json").exists()


def test_photographs_of_one_camera_make_a_static_capture(tmp_path, painted):
    folder, poses = tmp_path / "photos", arc(7, -30, 30)
    write_pictures(folder, poses, painted)
    out = tmp_path / "capture"
    options = PrepareOptions(poses=PosesOptions(model="pinhole"))
    facts = prepare_capture(folder, out, options=options)
    assert not facts["still"] and facts["cameras"]["photos"]["registered"] == 7
    # The capture says itself that it is static, so opening it warns of nothing.
    capture = open_capture(out)
    assert len({view.camera_name for view in capture.views}) == 7


@pytest.mark.ci
def test_photographs_keep_a_given_lens_and_are_placed_by_it(tmp_path, painted):
    folder, poses = tmp_path / "photos", arc(7, -30, 30)
    write_pictures(folder, poses, painted)
    path, out = tmp_path / "sensor.yaml", tmp_path / "capture"
    # Of pictures of twice the size; pixel centres are at whole numbers.
    numbers = [2 * FOCAL, 2 * FOCAL, SIZE[0] - 0.5, SIZE[1] - 0.5]
    path.write_text(f"intrinsics: {numbers}\nresolution: {[2 * side for side in SIZE]}\n")
    options = PrepareOptions(poses=PosesOptions(lens=str(path)))
    facts = prepare_capture(folder, out, options=options)
    assert facts["cameras"]["photos"]["registered"] == 7
    texts = [finding["text"] for finding in facts["findings"]]
    assert any("it is scaled" in text for text in texts)
    frames = json.loads((out / "transforms.json").read_text())["frames"]
    lens = {"fl_x": FOCAL, "fl_y": FOCAL, "cx": SIZE[0] / 2, "cy": SIZE[1] / 2}
    assert all(frame | lens == frame and "k1" not in frame for frame in frames)
    found = [world_from_camera(out, frame["file_path"]) for frame in frames]
    place, turn = compared(np.array(found), inverted(poses))
    assert place < PLACE * 5 and turn < TURN


@pytest.mark.ci
def test_photographs_of_several_sizes_are_placed_together(tmp_path, painted):
    """Three of seven lie on their side; one of these is stored upright with EXIF's orientation."""
    folder, poses = tmp_path / "photos", arc(7, -30, 30)
    for k, pose in enumerate(poses):
        lying = k in (1, 2, 4)
        levels = picture(pose, painted, size=SIZE if lying else SIZE[::-1])
        write_image(folder / f"{k}.png", levels)
    turned = picture(poses[4], painted).swapaxes(0, 1)[::-1]  # 6: its first row is at the right
    (folder / "4.png").unlink()
    write_tagged(folder / "4.jpg", turned, 6)
    options = PrepareOptions(poses=PosesOptions(model="pinhole"))
    facts = prepare_capture(folder, tmp_path / "capture", options=options)
    assert facts["cameras"]["photos"]["sizes"] == [list(SIZE[::-1]), list(SIZE)]
    assert facts["cameras"]["photos"]["registered"] == 7
    files = sorted(one.image.relative_to(tmp_path / "capture").as_posix()
                   for one in open_capture(tmp_path / "capture").views)  # fmt: skip
    found = np.array([world_from_camera(tmp_path / "capture", file) for file in files])
    place, turn = compared(found, inverted(poses))
    assert place < 5 * PLACE and turn < TURN


def test_a_camera_that_moves_among_others_that_stand_still(tmp_path, painted):
    """Four cameras stand still, a fifth one walks; a quad moves before all of them."""
    count, fixed = 8, arc(4)
    angles = np.radians(np.linspace(-25, 25, count))
    path = [looking((4.2 * np.sin(a), 1.5 - 4.2 * np.cos(a), 2.6)) for a in angles]
    for k in range(5):
        poses = path if k == 4 else [fixed[k]] * count
        frames = [picture(p, painted, mover_at(i / RATE)) for i, p in enumerate(poses)]
        (tmp_path / "in").mkdir(exist_ok=True)
        write_video(tmp_path / "in" / f"cam{k}.mp4", frames)
    options = PrepareOptions(
        sync=TOGETHER, frames=FramesOptions(instants=3), poses=PosesOptions(model="pinhole")
    )
    facts = prepare_capture(tmp_path / "in", tmp_path / "capture", options=options)
    assert [one["still"] for one in facts["cameras"].values()] == [True] * 4 + [False]
    document = json.loads((tmp_path / "capture" / "transforms.json").read_text())
    frames = sorted(document["frames"], key=lambda one: (one["camera"], one["time"]))
    assert len(frames) == 5 * count
    found = np.array([one["transform_matrix"] for one in frames])[:, :3]
    found[:, :, :3] *= BLENDER_AXES
    assert np.ptp(found[:count], axis=0).max() == 0
    place, turn = compared(
        np.concatenate([found[: 4 * count : count], found[4 * count :]]),
        inverted([*fixed, *path]),
    )
    assert place < 5 * PLACE and turn < TURN


@pytest.mark.ci
def test_a_camera_that_moves_has_a_pose_for_each_timestamp(tmp_path, painted):
    angles = np.radians(np.linspace(-20, 20, 10))
    path = [looking((5 * np.sin(a), 1.5 - 5 * np.cos(a), 1.8)) for a in angles]
    (tmp_path / "in").mkdir()
    write_video(tmp_path / "in" / "walk.mp4", [picture(pose, painted) for pose in path])
    options = PrepareOptions(frames=FramesOptions(instants=3), poses=PosesOptions(model="pinhole"))
    facts = prepare_capture(tmp_path / "in", tmp_path / "capture", options=options)
    assert not facts["still"] and facts["cameras"]["walk"]["registered"] == 10
    views = open_capture(tmp_path / "capture").views
    places = np.array([np.asarray(view.camera.trajectory.translation[0]) for view in views])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() < 1.3 * steps.min()


def refused(folder, match, **options):
    """Preparing a folder ends with this message and without a capture."""
    out = folder.with_name("capture")
    with pytest.raises((PrepareError, OSError), match=match):
        prepare_capture(folder, out, options=PrepareOptions(sync=TOGETHER, **options))
    assert not (out / "transforms.json").exists()


@pytest.mark.parametrize(("instants", "times"), [(5, 1), (2, 2)])
def test_features_of_few_timestamps_are_found_once(tmp_path, painted, monkeypatch, instants, times):
    for name, begin in (("a", -12), ("b", 2)):
        write_pictures(tmp_path / "in" / name, arc(4, begin, begin + 10), painted)
    extracted, extract = [], features.extract_features

    def counted(database, *arguments):
        extracted.append(database)
        extract(database, *arguments)

    monkeypatch.setattr(features, "extract_features", counted)
    options = PrepareOptions(sync=TOGETHER, frames=FramesOptions(instants=instants))
    facts = prepare_capture(tmp_path / "in", tmp_path / "out", options=options)
    assert not facts["cameras"]["a"]["still"] and facts["cameras"]["b"]["registered"] == 4
    assert len(extracted) == times


def test_black_videos_are_refused(tmp_path):
    (tmp_path / "in").mkdir()
    for name in "ab":
        write_video(tmp_path / "in" / f"{name}.mp4", [np.zeros((120, 160, 3), np.uint8)] * 4)
    refused(tmp_path / "in", "show texture, but all 2 cameras' .* an even colour.*not black")


@pytest.mark.parametrize("rig", ["auto", "moving"])
def test_pictures_without_features_are_refused_before_they_are_compared(
    tmp_path, monkeypatch, capsys, rig
):
    """A smooth picture shows something, but nothing that could be found again."""
    (tmp_path / "in").mkdir()
    shade = np.linspace(20, 230, 160) + np.linspace(-20, 20, 120)[:, None]
    frame = np.repeat(shade.astype(np.uint8)[..., None], 3, axis=-1)
    for name in "ab":
        write_video(tmp_path / "in" / f"{name}.mp4", [frame] * 4)
    monkeypatch.setattr(pipeline, "check_details", lambda sources: None)
    monkeypatch.setattr(features, "match_features", None)
    refused(tmp_path / "in", "show texture, got 0 features a picture", poses=PosesOptions(rig=rig))
    assert "move" not in capsys.readouterr().out


def test_cameras_that_share_no_feature_are_not_said_to_move(tmp_path, monkeypatch, capsys):
    pictures = [features.MatchingPicture(f"{k}.png", "ab"[k % 2], k, (64, 48)) for k in range(4)]
    monkeypatch.setattr(features, "match_features", lambda *_: None)
    monkeypatch.setattr(features, "read_keypoints", lambda *_: {})
    monkeypatch.setattr(features, "raw_matches", lambda *_: {})
    assert standing_cameras(tmp_path, pictures, 0) is None
    everyone = frozenset("ab")
    tell_standing(None, everyone)
    assert "taken to move (poses.rig=still" in capsys.readouterr().out
    tell_standing(frozenset("a"), everyone)
    assert "stand still (a) or move (b)" in capsys.readouterr().out


def test_videos_of_different_rooms_are_refused(tmp_path, painted):
    (tmp_path / "in").mkdir()
    for k, pose in enumerate(arc(2, -5, 5)):
        frame = picture(pose, textures(seed=20) if k else painted)
        write_video(tmp_path / "in" / f"{k}.mp4", [frame] * 4)
    refused(tmp_path / "in", "add cameras between, or give a calibration")


def test_a_failure_repeats_which_videos_hold_two_views(tmp_path, painted):
    (tmp_path / "in").mkdir()
    poses = [looking((x, -3.5, 1.9), (x, 1.5, 0.8)) for x in (-0.05, 0.05)]
    both = np.concatenate([picture(pose, painted) for pose in poses], axis=1)
    write_video(tmp_path / "in" / "a.mp4", [both] * 4)
    with pytest.warns(CaptureWarning, match="a.mp4: the picture looks like two views side by side"):
        refused(tmp_path / "in", "^a.mp4 seems to hold several views.* a single camera")


@pytest.mark.parametrize("count", [1, 4])
def test_a_lone_camera_that_stands_still_is_refused(tmp_path, painted, count):
    (tmp_path / "in").mkdir()
    write_video(tmp_path / "in" / "a.mp4", [picture(arc(1)[0], painted)] * count)
    refused(tmp_path / "in", "got a single picture or a single camera.*poses.rig=moving")


@pytest.mark.parametrize("turn", [0.0, 3.0])
def test_pictures_from_one_place_are_refused(tmp_path, painted, turn):
    """The camera stays as it is, or turns."""
    targets = np.linspace(-turn / 2, turn / 2, 6)
    poses = [looking((0, -3.5, 1.9), (x, 1.5, 0.8)) for x in targets]
    write_pictures(tmp_path / "in", poses, painted)
    refused(
        tmp_path / "in",
        "got pictures without parallax.*move the camera sideways.*one plane.*calibration=FILE",
    )


def test_a_broken_picture_is_refused(tmp_path, painted):
    write_pictures(tmp_path / "in", arc(3, -10, 10), painted)
    path = tmp_path / "in" / "001.png"
    path.write_bytes(path.read_bytes()[:5000])
    refused(tmp_path / "in", "001.png: the picture is truncated or corrupt.*Copy it again")


def test_pictures_of_several_sizes_of_one_of_several_cameras_are_refused(tmp_path, painted):
    for name in "ab":
        write_pictures(tmp_path / "in" / name, arc(2, -10, 10), painted)
    write_image(tmp_path / "in" / "b" / "z.png", picture(arc(1)[0], painted, size=(300, 240)))
    refused(tmp_path / "in", "z.png.*one size.*folder of their own")


def test_a_broken_video_is_refused(tmp_path, painted):
    (tmp_path / "in").mkdir()
    for name in "ab":
        write_video(tmp_path / "in" / f"{name}.mp4", [picture(arc(1)[0], painted)] * 4)
    path = tmp_path / "in" / "b.mp4"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    refused(tmp_path / "in", "b.mp4: the video is truncated or corrupt.*encode it again")


def test_the_lens_of_a_fisheye_is_found(tmp_path, painted):
    for k, pose in enumerate(arc(7, -24, 24, 3.2)):
        levels = picture(pose, painted, focal=150.0, size=(400, 300), fisheye=True)
        write_image(tmp_path / "in" / f"cam{k}" / "0.png", levels)
    options = PrepareOptions(poses=PosesOptions(model="opencv_fisheye"))
    facts = prepare_capture(tmp_path / "in", tmp_path / "out", options=options)
    lenses = [one["lens"] for one in facts["cameras"].values() if one["registered"]]
    assert len(lenses) == 7 and lenses[0]["camera_model"] == "OPENCV_FISHEYE"
    assert lenses[0]["fl_x"] == pytest.approx(150, rel=0.02)
    assert facts["cameras"]["cam0"]["fov"] == pytest.approx(np.degrees(400 / 150), rel=0.03)
