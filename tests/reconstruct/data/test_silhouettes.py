"""Masks are silhouettes if they hide the border and differ; masks of a lens, of passers-by and
margins are none."""

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


def thing(i, inset=4):
    mask = np.zeros((SIZE, SIZE), bool)
    mask[inset + i % 2 : -inset, inset:-inset] = True
    return mask


def test_a_thing_that_is_cut_out_is_a_silhouette(views, tmp_path):
    assert not are_silhouettes(views)
    assert are_silhouettes(masked(views, tmp_path / "thing", thing))
    # It may reach to the border of some.
    assert are_silhouettes(
        masked(views, tmp_path / "near", lambda i: thing(i) | (thing(i, 1) if i == 0 else False))
    )


def test_what_a_lens_leaves_dark_is_none(views, tmp_path):
    assert not are_silhouettes(masked(views, tmp_path / "lens", lambda _: thing(0)))
    assert not are_silhouettes(masked(views[:1], tmp_path / "one", thing))


def test_passers_by_are_none(views, tmp_path):
    assert not are_silhouettes(masked(views, tmp_path / "people", lambda i: ~thing(i)))


def test_a_margin_is_none(views, tmp_path):
    around = [replace(view, margin=(2, 2, 2, 2 + i % 2)) for i, view in enumerate(views)]
    assert not are_silhouettes(around)

    def white(_):
        return np.ones((SIZE, SIZE), bool)

    in_margin = [
        replace(view, margin=(2, 2, 2, 2 + i % 2))
        for i, view in enumerate(masked(views, tmp_path / "white", white))
    ]
    assert not are_silhouettes(in_margin)


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
