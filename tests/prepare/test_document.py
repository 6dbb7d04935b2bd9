"""The files that `gaussray prepare` writes."""

import numpy as np
import pytest

from gaussray.io.ply import read_vertices
from gaussray.prepare.document import write_points


# Map coordinates need 64 bits.
MAP = (431042.7, 5403017.3, 211.9)


@pytest.mark.parametrize(("place", "step"), [((1.0, -2.0, 3.0), 2.0**-22), (MAP, 2.0**-30)])
def test_points_are_as_exact_as_their_place_asks_for(tmp_path, place, step):
    points = np.array([place, np.array(place) + [0.1, 0.2, -0.3]])
    levels = np.array([[9, 8, 7], [6, 5, 4]], np.uint8)
    write_points(tmp_path / "points3d.ply", points, levels)
    table = read_vertices(tmp_path / "points3d.ply")
    found = np.stack([table[axis] for axis in "xyz"], axis=-1)
    np.testing.assert_allclose(found, points, rtol=0, atol=step)
    np.testing.assert_array_equal(
        np.stack([table[c] for c in ("red", "green", "blue")], -1), levels
    )
