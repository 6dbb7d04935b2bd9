"""Pictures that several fits share: read once for each size of tiles, in one room of memory."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.reconstruct.data import training_pictures as module
from gaussray.reconstruct.data.segments import training_views
from gaussray.reconstruct.data.still_cameras import camera_frames, median_picture
from gaussray.reconstruct.data.training_pictures import training_pictures
from gaussray.reconstruct.shared_results import SharedResults


TIMES = tuple(np.linspace(0, 1, 4).tolist())


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    folder = tmp_path_factory.mktemp("capture")
    return training_views(read_capture(toy.write_capture(folder, toy.scene(), times=TIMES)))


@pytest.fixture
def asked(views, tmp_path, monkeypatch):
    """Asks for pictures in tiles of a size; and what was read and evened out, in order."""
    shared, done = SharedResults(), []

    def noted(name, function):
        def call(*words, **options):
            done.append(name)
            return function(*words, **options)

        return call

    for name in ("footage", "equalization"):
        monkeypatch.setattr(module, name, noted(name, getattr(module, name)))

    def ask(side, memory=4.0):
        fit = replace(toy.SHORT.fit, tile_side=side, memory=memory)
        return training_pictures(
            views,
            replace(toy.SHORT, fit=fit),
            shared,
            evened_out=True,
            folder=tmp_path,
            report=lambda done: None,
        )

    return ask, done


def test_pictures_are_read_once_for_each_size_of_tiles_and_evened_out_once_for_all(asked):
    ask, done = asked
    first = ask(8)
    own = next(frames for frames, _ in camera_frames(first.footage))
    median = median_picture(first.footage, own)
    assert ask(8).footage is first.footage and ask(16).footage is not first.footage
    assert ask(16).footage is ask(16).footage and ask(8).footage is first.footage
    assert done == ["footage", "equalization", "footage"]
    # The median of whole pictures is known for tiles of any size.
    assert median_picture(ask(16).footage, own)[0] is median[0]
    np.testing.assert_array_equal(ask(16).footage.pictures(own), first.footage.pictures(own))


def test_what_does_not_fit_beside_the_others_is_kept_in_a_file(asked):
    ask, _ = asked
    size = 1e-9 * ask(8).footage.pixel.nbytes
    kept, other = ask(8, 1.5 * size).footage.pixel, ask(16, 1.5 * size).footage.pixel
    assert not isinstance(kept, np.memmap) and isinstance(other, np.memmap)
