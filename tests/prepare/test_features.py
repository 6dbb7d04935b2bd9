"""Features and matches do not depend on the numbers that COLMAP gives to pictures."""

import numpy as np
import pytest
from quads import SIZE, arc, picture

from gaussray.dataset.images import write_image
from gaussray.prepare import features
from gaussray.prepare.colmap import pycolmap, quiet_colmap
from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.full_pictures import full_pictures
from gaussray.prepare.merging import staying_share
from gaussray.prepare.options import PosesOptions


pytest.importorskip("pycolmap")

OPTIONS = PosesOptions(model="pinhole")


def written(folder, levels):
    """Pictures of one camera at following timestamps."""
    for k, level in enumerate(levels):
        write_image(folder / f"000/{k:04d}.png", level)
    return [MatchingPicture(f"000/{k:04d}.png", "cam", k, SIZE) for k in range(len(levels))]


def extract(database, folder, pictures):
    with quiet_colmap():
        features.extract_features(database, folder, [pictures], OPTIONS)


@pytest.mark.parametrize("listed", [slice(None), slice(None, None, -1)])
def test_a_camera_that_stands_still_does_so_whatever_its_pictures_numbers(
    tmp_path, painted, listed
):
    level = picture(arc(3)[1], painted)
    pictures, database = written(tmp_path, [level, level]), tmp_path / "features.db"
    extract(database, tmp_path, pictures[listed])
    first, last = (one.file for one in pictures)
    with quiet_colmap():
        features.match_features(database, [(first, last)], 0)
        keypoints = features.read_keypoints(database, pictures)
        for matches in (features.raw_matches(database), features.verified_matches(database)):
            assert list(matches) == [(first, last)]
            rows = matches[first, last]
            assert len(rows) > 100
            # The pictures are equal, so that matches are at one place: columns are not swapped.
            assert np.allclose(keypoints[first].xy[rows[:, 0]], keypoints[last].xy[rows[:, 1]])
            assert staying_share(keypoints[first], keypoints[last], rows, SIZE) == 1


def test_pictures_are_numbered_in_their_order_and_not_in_that_of_threads(tmp_path, painted):
    # The features of the first picture take longest: other threads end before.
    plain = np.full((*SIZE[::-1], 3), 128, np.uint8)
    pictures = written(tmp_path, [picture(arc(3)[1], painted), *[plain] * 4])
    database = tmp_path / "features.db"
    extract(database, tmp_path, pictures)
    with pycolmap().Database.open(database) as db:
        numbers = {image.name: image.image_id for image in db.read_all_images()}
    assert sorted(numbers, key=numbers.__getitem__) == [one.file for one in pictures]


def test_features_lie_where_masks_are_white(tmp_path, painted):
    level = picture(arc(3)[1], painted)
    pictures, database = written(tmp_path, [level, level]), tmp_path / "features.db"
    mask = np.zeros_like(level)
    mask[:, : SIZE[0] // 2] = 255
    write_image(tmp_path / "masks/000/0000.png.png", np.full_like(mask, 255))
    write_image(tmp_path / "masks/000/0001.png.png", mask)
    with quiet_colmap():
        features.extract_features(database, tmp_path, [pictures], OPTIONS, tmp_path / "masks")
        keypoints = features.read_keypoints(database, pictures)
    whole, half = (keypoints[one.file].xy[:, 0] for one in pictures)
    assert whole.max() > SIZE[0] / 2 + 20
    # Positions are refined after the mask has been looked at.
    assert len(half) > 50 and half.max() < SIZE[0] / 2 + 2


def test_pictures_with_as_many_features_as_are_taken_are_told_from_others(tmp_path, painted):
    pictures = written(tmp_path, [picture(arc(3)[1], painted)])
    for most, reached in ((100, True), (8192, False)):
        database = tmp_path / f"{most}.db"
        options = PosesOptions(model="pinhole", features=most)
        with quiet_colmap():
            features.extract_features(database, tmp_path, [pictures], options)
        full = {pictures[0].file} if reached else set()
        assert full_pictures(database, most) == full


@pytest.mark.parametrize("size", [(600, 300), (4800, 60)])
def test_a_picture_is_not_full_where_all_levels_of_scale_were_taken(tmp_path, size):
    """COLMAP takes whole levels: more features than asked for may be all that there are."""
    noise = np.random.default_rng(0).integers(0, 256, (size[1], size[0], 3), np.uint8)
    write_image(tmp_path / "0.png", noise)
    pictures = [features.MatchingPicture("0.png", "a", 0, size)]

    def found(most):
        database = tmp_path / f"{most}.db"
        with quiet_colmap():
            options = PosesOptions(model="pinhole", features=most)
            features.extract_features(database, tmp_path, [pictures], options)
            xy = features.read_keypoints(database, pictures)["0.png"].xy
        return len(np.unique(xy, axis=0)), full_pictures(database, most)

    every, full = found(100_000)
    assert every > 200 and not full
    # One less than there are.
    count, full = found(every - 1)
    assert count == every and not full
    # The finest level alone is left out.
    count, full = found(every // 4)
    assert every // 4 <= count < every and full == {"0.png"}


def test_a_picture_of_which_a_mask_leaves_half_may_have_more_features(tmp_path, painted):
    level = picture(arc(3)[1], painted)
    pictures, masks = written(tmp_path, [level]), tmp_path / "masks"
    mask = np.zeros_like(level)
    mask[:, : SIZE[0] // 2] = 255
    write_image(masks / "000/0000.png.png", mask)
    for most, reached in ((100, True), (8192, False)):
        database = tmp_path / f"{most}.db"
        options = PosesOptions(model="pinhole", features=most)
        with quiet_colmap():
            features.extract_features(database, tmp_path, [pictures], options, masks)
        full = {pictures[0].file} if reached else set()
        assert full_pictures(database, most, masks) == full
