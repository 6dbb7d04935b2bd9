"""Poses that contradict the pictures are told, and how they must be read where that helps."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.open import open_capture
from gaussray.dataset.images import write_image
from gaussray.reconstruct.checks import matched_details, pose_check as checked
from gaussray.reconstruct.checks.focal_check import FocalFit
from gaussray.reconstruct.checks.matched_details import (
    DetailMatch,
    Details,
    PosedViews,
    is_of_one_thing,
)
from gaussray.reconstruct.checks.odd_views import odd_views_sentence
from gaussray.reconstruct.checks.pose_check import (
    REMEDIES,
    Misfit,
    PoseCheck,
    pose_check,
    warn_of_wrong_poses,
)
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.data.segments import training_views


W, H, FOCAL = 160, 120, 150.0
# Pixels that details of a sharp rendering lie off their lines, in the median.
PIXELS = 0.3
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def looking(eye, at):
    """Camera-to-world matrix in OpenCV's axes."""
    forward = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(forward, [0.1, 1.0, 0.2])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, eye], axis=1)
    return pose


def scenery(count=6, nod=0.0):
    """Poses around a painted wall with a step in it, and what they see of it; their target goes up
    and down."""
    paint = gaussian_filter(np.random.default_rng(0).normal(size=(400, 400, 3)), (2, 2, 0))
    paint = np.clip(0.5 + 0.5 * paint / paint.std(), 0, 1)
    poses, pictures = [], []
    row, column = np.mgrid[:H, :W] + 0.5
    ray = np.stack([(column - W / 2) / FOCAL, (row - H / 2) / FOCAL, np.ones((H, W))], axis=-1)
    for angle in np.linspace(-0.5, 0.5, count):
        eye = np.array([3 * np.sin(angle), 0.5 * np.cos(5 * angle), 0.4 - 3 * np.cos(angle)])
        pose = looking(eye, np.array([0, nod * np.sin(9 * angle), 0]))
        world = ray @ pose[:3, :3].T
        shown = np.zeros((H, W, 3))
        for depth, half in ((0.6, 9.0), (0.0, 0.7)):
            place = eye + world * ((depth - eye[2]) / world[..., 2:])
            texel = 200 + 90 * place[..., 1], 200 + 90 * place[..., 0]
            color = np.stack(
                [map_coordinates(paint[..., c], texel, order=1, mode="wrap") for c in range(3)], -1
            )
            near = (np.abs(place[..., :2]) < half).all(axis=-1)
            shown = np.where(near[..., None], color, shown)
        poses.append(pose)
        pictures.append((255 * shown + 0.5).astype(np.uint8))
    return poses, pictures


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Seen pictures with poses that are written by a rule."""
    same = scenery()
    # Only pictures whose cameras turn up and down tell their focal length.
    nodding = scenery(nod=0.5)
    root = tmp_path_factory.mktemp("poses")

    def lay(name, written, focal=FOCAL):
        poses, pictures = same if focal == FOCAL else nodding
        folder = root / name
        frames = []
        for k, pose in enumerate(poses):
            write_image(folder / f"{k}.png", pictures[k])
            frames.append({"file_path": f"{k}.png", "transform_matrix": written(pose).tolist()})
        document = {"w": W, "h": H, "fl_x": focal, "fl_y": focal, "cx": W / 2, "cy": H / 2}
        document |= {"static": True, "split": "train", "frames": frames}
        (folder / "transforms.json").write_text(json.dumps(document))
        return footage(training_views(open_capture(folder)), side=8, bundle=8)

    return lay


WRITTEN = {
    "": lambda pose: pose @ FLIP,
    "opencv": lambda pose: pose,
    "inverse": lambda pose: np.linalg.inv(pose @ FLIP),
    "opencv_inverse": np.linalg.inv,
}


@pytest.mark.parametrize("reading", WRITTEN)
def test_details_tell_how_poses_must_be_read(shown, reading):
    found = pose_check(shown(reading or "right", WRITTEN[reading]))
    near = found.near
    assert near.matches >= checked.TELLING_MATCHES and near.others.keys() == REMEDIES.keys()
    errors = {"": near.error, **near.others}
    if reading:
        assert found.reading == reading and errors[reading] < PIXELS < 5 * PIXELS < near.error
        assert f"They fit if the poses are {REMEDIES[reading]}." in found.sentence
    else:
        assert near.error < PIXELS and found.reading == found.sentence == ""
        assert min(near.others.values()) > 5 * PIXELS


def test_pictures_that_look_elsewhere_tell_axes_where_neighbours_do_not():
    alike = Misfit(449, 0.7, {**dict.fromkeys(REMEDIES, 1.6), "opencv": 0.15})
    turned = Misfit(93, 4.1, {**dict.fromkeys(REMEDIES, 9.0), "opencv": 0.9})
    found = PoseCheck(alike, turned)
    assert found.reading == "opencv" and "4.1 pixels off" in found.sentence
    # Few matches, or another reading that is hardly better, tell nothing.
    assert PoseCheck(alike, turned._replace(matches=29)).sentence == ""
    assert PoseCheck(alike, turned._replace(error=2.6)).sentence == ""


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_focal_length_that_is_wrong_for_all_pictures_is_told(shown, factor):
    found = pose_check(shown(f"long{factor}", WRITTEN[""], FOCAL / factor))
    assert found.near.focal is not None and found.reading == ""
    assert found.near.focal.factor == pytest.approx(factor, rel=0.03)
    assert found.near.focal.error < 2 * PIXELS
    assert f"if the focal length is {found.near.focal.words}. Correct" in found.sentence
    assert "fit.refine=[pose] mends" not in found.sentence


@pytest.mark.parametrize("reading", REMEDIES)
def test_wrong_axes_are_told_with_a_wrong_lens(shown, reading):
    found = pose_check(shown(f"both_{reading}", WRITTEN[reading], FOCAL / 0.8))
    assert found.near.reading == found.turned.reading == ""
    assert found.reading == reading and found.near.focal is not None
    assert found.near.focal.factor == pytest.approx(0.8, rel=0.03)
    assert f"The poses seem to be {REMEDIES[reading]}. Then they fit (0." in found.sentence
    assert f"if the focal length is also {found.near.focal.words}." in found.sentence


def test_other_axes_that_fit_far_better_are_told_honestly():
    nothing = Misfit(0, 0.0, dict.fromkeys(REMEDIES, 0.0))
    near = Misfit(189, 27.0, {**dict.fromkeys(REMEDIES, 20.0), "opencv": 3.6})
    found = PoseCheck(near, nothing)
    assert found.reading == "opencv"
    assert "They fit far better (3.6 pixels) if the poses are camera-to-world" in found.sentence
    assert "Something else is off as well" in found.sentence
    focal = FocalFit(0.85, 0.7, 585.0, 640)
    both = PoseCheck(near._replace(focal=focal), nothing).sentence
    assert "Something else" not in both
    assert f"Then they fit (0.7 pixels) if the focal length is also {focal.words}." in both
    # Few matches, errors within the limits, readings that are hardly worse, or a bad best one.
    for less in (
        near._replace(matches=29),
        near._replace(matches=60, error=3.9),
        near._replace(others={**near.others, "inverse": 10.0}),
        near._replace(error=60.0, others={**dict.fromkeys(REMEDIES, 50.0), "opencv": 5.1}),
    ):
        assert PoseCheck(less, nothing).reading == ""


def test_nothing_is_tried_below_the_limits(shown, monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr(checked, "focal_fit", never)
    assert pose_check(shown("fine", WRITTEN[""])).near.focal is None


def test_turned_pairs_leave_out_views_that_look_the_same_way():
    angles = np.array([0.0, 0.1, 0.4, 0.5])
    turns = np.array(
        [[[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]] for a in angles]
    )
    eye = np.stack([angles, 0 * angles, 0 * angles], axis=1)
    assert matched_details.nearest_pairs(turns, eye, 1.0) == [(0, 1), (2, 3)]
    assert matched_details.nearest_pairs(turns, eye, checked.TURNED_COSINE) == [
        (0, 2),
        (1, 2),
        (1, 3),
    ]


def test_poses_of_something_else_fit_in_no_reading(shown):
    def moved(pose):
        other = pose @ FLIP
        other[:3, 3] = np.roll(other[:3, 3], 1)
        return other

    with pytest.warns(CaptureWarning, match="do not fit together: .* those of other pictures"):
        warn_of_wrong_poses(shown("moved", moved))


def with_mixed_matches(views, share):
    """The views, of whose matches so large a share, in every pair, is of details that only look
    alike, as those of a pattern that repeats."""
    matched = views.matches

    def mixed(pairs):
        for match in matched(pairs):
            count = len(match.other.ray)
            order, wrong = np.arange(count), np.arange(int(share * count))
            order[: len(wrong)] = np.random.default_rng(0).permutation(wrong)
            yield match._replace(other=match.other.part(order))

    views.matches = lambda pairs: list(mixed(pairs))
    return views


def test_right_poses_are_not_called_wrong_where_most_details_only_look_alike(shown, monkeypatch):
    pictures = shown("alike_near", WRITTEN[""])
    for share in (0.6, 0.8, 1.0):
        views = with_mixed_matches(PosedViews(pictures), share)
        monkeypatch.setattr(checked, "PosedViews", lambda _, views=views: views)
        assert pose_check(pictures).sentence == ""
    # Without a look at whether they are of one thing, they would be.
    monkeypatch.setattr(checked, "is_of_one_thing", lambda _: True)
    assert "do not fit together" in pose_check(pictures).sentence


def test_wrong_poses_are_told_where_some_details_only_look_alike(shown, monkeypatch):
    pictures = shown("alike_wrong", WRITTEN["opencv"])
    views = with_mixed_matches(PosedViews(pictures), 0.3)
    monkeypatch.setattr(checked, "PosedViews", lambda _: views)
    assert pose_check(pictures).reading == "opencv"


def test_few_details_of_which_a_quarter_lies_on_its_lines_tell_nothing():
    nothing = Misfit(0, 0.0, dict.fromkeys(REMEDIES, 0.0))
    for quarter, told in ((1.2, False), (1.3, True)):
        near = Misfit(20, 16.0, dict.fromkeys(REMEDIES, 16.0), quarter=quarter)
        assert bool(PoseCheck(near, nothing).sentence) == told
    assert "the poses may be right: keep them" in PoseCheck(near, nothing).sentence


def one_turned(index, degrees):
    """Poses of which one is turned upwards."""
    count = itertools.count()
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(4)
    turn[1:3, 1:3] = [[c, -s], [s, c]]
    return lambda pose: (pose @ turn if next(count) == index else pose) @ FLIP


@pytest.mark.parametrize("index", [1, 2])
def test_a_camera_that_was_turned_is_named_and_the_others_fit(shown, index):
    pictures = shown(f"turned{index}", one_turned(index, 4))
    sentence = odd_views_sentence(PosedViews(pictures))
    assert f"poses put them (0.1 pixels), but those of {index} lie " in sentence
    assert "; those of" not in sentence
    with pytest.warns(CaptureWarning, match="moved or turned since"):
        warn_of_wrong_poses(pictures)


def test_a_camera_of_its_own_name_can_be_held_out(shown):
    pictures = shown("named", one_turned(2, 4))
    names = np.array([f"cam{k}" for k in range(len(pictures.name))])
    sentence = odd_views_sentence(PosedViews(dataclasses.replace(pictures, name=names)))
    assert "those of cam2 lie " in sentence and "pixels off with cam1" in sentence
    assert sentence.endswith("capture.test=['cam2'].")


def test_one_pair_of_few_matches_names_no_camera(shown):
    # Cameras at the ends of the row share details with one other camera alone.
    assert odd_views_sentence(PosedViews(shown("end", one_turned(3, 4)))) == ""


def test_no_camera_is_named_where_all_fit_or_matches_are_of_things_that_look_alike(
    shown, monkeypatch
):
    assert odd_views_sentence(PosedViews(shown("fit", WRITTEN[""]))) == ""
    turned = PosedViews(shown("alike", one_turned(2, 4)))
    matched = turned.matches

    def mixed(pairs):
        """Every detail matches another one."""
        for match in matched(pairs):
            count = len(match.other.ray)
            order = np.random.default_rng(0).permutation(count)
            odd = 2 in (match.first, match.second)
            yield match._replace(other=match.other.part(order)) if odd else match

    monkeypatch.setattr(turned, "matches", mixed)
    assert odd_views_sentence(turned) == ""


def test_nothing_is_said_of_pictures_without_details(shown, monkeypatch):
    monkeypatch.setattr(matched_details, "_DETAILS", 6)
    found = pose_check(shown("few", WRITTEN["opencv"]))
    assert found.near.matches < checked.TELLING_MATCHES and found.sentence == ""


@pytest.mark.parametrize(
    ("matches", "error", "wrong"),
    [
        *((14, 40.0, False), (15, 9.0, False), (15, 11.0, True)),
        *(
            (40, 3.9, False),
            (40, 4.1, True),
            (149, 2.2, False),
            (150, 2.2, True),
            (900, 1.4, False),
        ),
    ],
)
def test_the_more_details_match_the_less_they_may_be_off(matches, error, wrong):
    nothing = Misfit(0, 0.0, dict.fromkeys(REMEDIES, 0.0))
    found = PoseCheck(Misfit(matches, error, dict.fromkeys(REMEDIES, error)), nothing)
    assert bool(found.sentence) == wrong


@pytest.mark.parametrize(
    ("matches", "right", "of_one_thing"),
    [(20, 17, True), (100, 70, True), (200, 150, True), (40, 16, False), (200, 80, False)],
)
def test_matches_are_of_one_thing_if_most_fit_some_pose(matches, right, of_one_thing):
    """Noise of 0.7 pixels in both views, through two lenses."""
    rng = np.random.default_rng(matches)
    point = rng.uniform([-1, -0.8, 2], [1, 0.8, 4], (matches, 3))
    turn = np.array([[0.995, 0, 0.0998], [0, 1, 0], [-0.0998, 0, 0.995]])
    seen = point, (point - [0.3, 0, 0]) @ turn.T
    sides = []
    for focal, place in zip((300.0, 250.0), seen, strict=True):
        pixel = focal * place[:, :2] / place[:, 2:] + rng.normal(0, 0.7, (matches, 2))
        if sides:
            pixel[right:] = rng.uniform([-150, -115], [150, 115], (matches - right, 2))
        ray = np.concatenate([pixel / focal, np.ones((matches, 1))], axis=1)
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        sides.append(Details(pixel, ray, np.zeros((matches, 128), np.uint8), 1, 1 / focal))
    assert is_of_one_thing(DetailMatch(0, 1, *sides)) == of_one_thing
