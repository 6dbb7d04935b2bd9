"""Names that tell depth maps, masks and calibrations from pictures of a camera."""

from pathlib import Path

import pytest

from gaussray.capture.side_folders import are_other_maps, holds_other_maps


@pytest.mark.parametrize(
    ("name", "other"),
    [
        *((name, True) for name in ("depth", "Masks", "depth_maps", "labels-v2", "normals")),
        *((name, True) for name in ("instances", "disp", "calibration", "chess_board 2")),
        *((name, True) for name in ("intrinsics", "calib_images")),
        # Each begins like one of them, or means something else.
        *((name, False) for name in ("normal", "maskerade", "dispatch", "instances_room")),
        *((name, False) for name in ("calibrated", "depthcam0", "left", "cam00", "")),
    ],
)
def test_a_folder_is_told_by_its_whole_name(name, other):
    assert holds_other_maps(Path("capture") / name) == other


@pytest.mark.parametrize(
    ("picture", "other"),
    [
        ("7.jpg", "7_mask.png"),
        ("7.color.jpg", "7.depth.png"),
        ("IMG_7.JPG", "DEPTH_7.PNG"),
        ("a 7.png", "a-7-Semantic.png"),
        ("rgb_7.png", "7_mask_depth.png"),
    ],
)
def test_a_map_is_told_by_the_picture_beside_it_alone(picture, other):
    pictures = [Path(picture), Path(other), Path("unrelated.png")]
    assert are_other_maps(pictures) == [False, True, False]
    assert are_other_maps(pictures[::-1]) == [False, True, False]
    assert not any(are_other_maps(pictures[1:]))


def test_a_word_within_a_word_is_no_map():
    assert not any(are_other_maps([Path("7.jpg"), Path("7_unmasked.jpg"), Path("7_masked.jpg")]))
