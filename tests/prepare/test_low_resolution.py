"""Whether two pictures show the same, at low resolution."""

import numpy as np
import pytest
from quads import looking, picture

from gaussray.prepare.low_resolution import details_differ, low_details


@pytest.fixture(scope="module")
def views(painted):
    places = ((0, -3.5, 1.8), (0.02, -3.5, 1.8), (4.5, 1.0, 1.8))
    return [picture(looking(place), painted) for place in places]


def test_copies_and_neighbours_show_the_same_and_other_views_differ(views):
    first, near, far = map(low_details, views)
    small = low_details(views[0][::2, ::2])
    dark = low_details((0.5 * views[0]).astype(np.uint8))
    assert not any(details_differ(first, other) for other in (first, near, small, dark))
    assert details_differ(first, far)


def test_plain_and_tiny_pictures_tell_nothing(views):
    plain = low_details(np.full((240, 320, 3), 255, np.uint8))
    tiny = low_details(views[2][:40, :40])
    assert not details_differ(low_details(views[0]), plain)
    assert not details_differ(low_details(views[0]), tiny)
