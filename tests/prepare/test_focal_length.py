"""Whether pictures tell the focal length, of reconstructions whose truth is known."""

import numpy as np
import pytest
from quads import looking
from reconstructions import FOCAL, around, reconstruction

from gaussray.prepare.focal_length import expected_focal_lengths, settled_focal_length
from gaussray.prepare.options import PosesOptions


colmap = pytest.importorskip("pycolmap")

# The error of a focal length that the noise leaves.
NEAR = 0.03


def straight(count=6):
    """A camera that goes sideways and does not turn: a longer focal length is the same room,
    farther away."""
    first = looking((0.0, -4.0, 1.5))
    return [np.column_stack([first[:, :3], first[:, 3] + [0.25 * k, 0, 0]]) for k in range(count)]


def parameters(reconstruction):
    return reconstruction.cameras[1].params


def test_cameras_that_turn_tell_the_focal_length():
    given = reconstruction(around())
    settled, source = settled_focal_length(given, {1: 1.2 * FOCAL})
    assert source == "pictures" and settled is given


def test_a_camera_that_goes_straight_gets_what_fits_without_distortion():
    settled, source = settled_focal_length(reconstruction(straight(), 1.3 * FOCAL, 0.2), {})
    assert source == "guess"
    assert parameters(settled)[3] == 0
    assert parameters(settled)[0] > 0.5 * FOCAL


def test_a_camera_that_goes_straight_gets_the_expected_focal_length():
    given = reconstruction(straight(), 1.3 * FOCAL)
    settled, source = settled_focal_length(given, {1: FOCAL})
    assert source == "expected"
    assert parameters(settled)[0] == FOCAL and abs(parameters(settled)[3]) < NEAR
    # The given one is left as it is.
    assert parameters(given)[0] == 1.3 * FOCAL


@pytest.mark.parametrize(
    ("options", "prior", "expected"),
    [
        (PosesOptions(), False, {}),
        (PosesOptions(fov=60.0), False, {1: FOCAL}),
        (PosesOptions(), True, {1: FOCAL}),
        # All fisheyes are taken to have a prior, so that matches are verified by rays.
        (PosesOptions(model="opencv_fisheye"), True, {}),
    ],
)
def test_focal_lengths_are_expected_of_fields_of_view_and_exif(tmp_path, options, prior, expected):
    with colmap.Database.open(tmp_path / "features.db") as db:
        camera = colmap.Camera(model="SIMPLE_PINHOLE", width=8, height=6, params=[FOCAL, 4, 3])
        camera.has_prior_focal_length = prior
        db.write_camera(camera)
    assert expected_focal_lengths(tmp_path / "features.db", options) == expected
