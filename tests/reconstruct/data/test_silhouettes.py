"""Masks are silhouettes if they hide the rim of what all show: those of a lens and of passers-by
are none, nor are margins."""

from dataclasses import replace

import numpy as np
import pytest
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.reconstruct.data.silhouettes import are_silhouettes


SIZE = toy.SIZE


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    folder = toy.write_capture(tmp_path_factory.mktemp("in"), toy.scene(speed=0), times=(0.0,))
    return read_capture(folder).views


def masked(views, folder, mask_of):
    """The views with masks, of which a function of the view's number makes one."""
    folder.mkdir()
    result = []
    for i, view in enumerate(views):
        path = folder / f"{i}.png"
        write_image(path, np.repeat(mask_of(i)[..., None], 3, axis=-1).astype(np.uint8) * 255)
        result.append(replace(view, mask=path))
    return result


def thing(i):
    """A thing that is in another corner of the middle from each side."""
    mask = np.zeros((SIZE, SIZE), bool)
    row, column = 2 + 5 * (i % 2), 2 + 5 * (i // 2 % 2)
    mask[row : row + 7, column : column + 7] = True
    return mask


def circle(radius):
    y, x = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    return x**2 + y**2 < radius**2


def test_a_thing_that_is_cut_out_is_a_silhouette(views, tmp_path):
    assert not are_silhouettes(views)
    cut_out = masked(views, tmp_path / "thing", thing)
    assert are_silhouettes(cut_out)
    # It may fill one picture.
    assert are_silhouettes(masked(views, tmp_path / "near", lambda i: thing(i) | (i == 0)))
    # What a margin hides is not known.
    assert not are_silhouettes([replace(cut_out[0], margin=(1, 0, 0, 0)), *cut_out[1:]])


def test_what_a_lens_leaves_dark_is_none(views, tmp_path):
    radius = SIZE / 2 - 1
    lens = masked(views, tmp_path / "lens", lambda _: circle(radius))
    assert not are_silhouettes(lens)
    # Lenses differ a little, and passers-by may be hidden, too.
    others = masked(views, tmp_path / "lenses", lambda i: circle(radius - 0.4 * (i % 2)))
    assert not are_silhouettes(others)
    people = masked(views, tmp_path / "people", lambda i: circle(radius) & ~thing(i))
    assert not are_silhouettes(people)


def test_passers_by_are_none(views, tmp_path):
    assert not are_silhouettes(masked(views, tmp_path / "people", lambda i: ~thing(i)))
    assert not are_silhouettes(masked(views[:1], tmp_path / "one", thing))


def test_alpha_that_is_a_mask_counts(views, tmp_path):
    cut_out = []
    for i, view in enumerate(views):
        path = tmp_path / f"{i}.png"
        picture = np.full((SIZE, SIZE, 4), 100, np.uint8)
        picture[..., 3] = 255 * thing(i)
        write_image(path, picture)
        cut_out.append(replace(view, image=path, background="mask"))
    assert are_silhouettes(cut_out)
    assert not are_silhouettes([replace(view, background="black") for view in cut_out])
