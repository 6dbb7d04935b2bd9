"""Training pictures of the toy scene, whole and in tiles to measure on."""

import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.data.pictures import footage
from gaussray.reconstruct.simplify.tile_views import TrainingViews, tile_views


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Training pictures of the toy scene."""
    capture = read_capture(toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene()))
    views = [view for view in capture.views if view.split == "train"]
    return footage(views, side=toy.SHORT.trace.bundle)


@pytest.fixture(scope="module")
def whole(seen):
    """All tiles of three instants, as they fall to them."""
    return tile_views(TrainingViews(seen, seen.camera), tiles=4, instants=3, weigh=12, seed=0)
