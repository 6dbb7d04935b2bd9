"""Pictures in a window: nothing is stretched, and every place of them is found again."""

import numpy as np
import pytest

from gaussray.viewer.window import BACKGROUND, LAYOUTS, Pane, compose_window, panes, window_fov


PICTURE = np.arange(6 * 8 * 3, dtype=np.uint8).reshape(6, 8, 3) + 1
SHAPE = 8 / 6


@pytest.mark.parametrize("window", [0.4, 1.0, SHAPE, 1.7, 3.0])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_pictures_keep_their_shape_and_touch_two_edges(layout, window):
    for pane in panes(layout, window, SHAPE):
        assert pane.width * window / pane.height == pytest.approx(SHAPE)
        room = 0.5 if layout == "side by side" else 1.0
        assert pane.height == pytest.approx(1) or pane.width == pytest.approx(room)
        assert 0 <= pane.left and pane.left + pane.width <= 1 + 1e-9


def test_side_by_side_is_in_the_middle_of_each_half():
    left, right = panes("side by side", 4.0, SHAPE)
    assert (left.name, right.name) == ("pinhole", "camera")
    assert left.left + left.width / 2 == pytest.approx(0.25)
    assert right.left + right.width / 2 == pytest.approx(0.75)


@pytest.mark.parametrize("window", [0.5, 1.7, 3.1])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_click_finds_the_pixel_that_is_shown_there(layout, window):
    shown = [(pane, PICTURE + 100 * i) for i, pane in enumerate(panes(layout, window, SHAPE))]
    sheet = compose_window(shown, window, True)
    h, w = sheet.shape[:2]
    assert w / h == pytest.approx(window, abs=2 / min(h, w) * max(window, 1))
    for pane, picture in shown:
        for column, row in ((0, 0), (3, 2), (7, 5)):
            x = pane.left + (column + 0.5) / 8 * pane.width
            y = pane.top + (row + 0.5) / 6 * pane.height
            found = [(p.name, p.pixel((x, y), (8, 6))) for p, _ in shown if p.pixel((x, y), (8, 6))]
            if found and found[0][0] == pane.name:
                assert found == [(pane.name, (column, row))]
                # Panes begin at whole pixels of the window.
                i, j = int(y * h), int(x * w)
                near = sheet[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].reshape(-1, 3)
                known = [picture[row, column], np.full(3, 255)]
                # A line of two pixels parts what stands side by side.
                known += [np.array(BACKGROUND[True])] * (abs(x - 0.5) * w < 2)
                assert any((p == k).all() for p in near for k in known)


def test_a_split_shows_the_pinhole_at_the_left_and_a_line():
    shown = [
        (pane, np.full((6, 8, 3), code, np.uint8))
        for pane, code in zip(panes("split", SHAPE, SHAPE, 0.25), (10, 20), strict=True)
    ]
    sheet = compose_window(shown, SHAPE, True)
    assert sheet.shape == (6, 8, 3)
    assert (sheet[:, :2] == 10).all() and (sheet[:, 2] == 255).all() and (sheet[:, 3:] == 20).all()


def test_around_pictures_is_the_colour_of_the_page():
    pane = panes("camera", 3.0, SHAPE)
    dark, light = (
        compose_window([(pane[0], PICTURE)], 3.0, dark)[0, 0].mean() for dark in (True, False)
    )
    assert dark < 60 and light > 200


def test_outside_of_a_pane_there_is_no_pixel():
    pane = Pane("camera", 0.25, 0.0, 0.5, 1.0)
    assert pane.pixel((0.2, 0.5), (8, 6)) is None
    assert pane.pixel((0.5, 0.5), (8, 6)) == (4, 3)


def test_an_unknown_layout_is_refused():
    with pytest.raises(ValueError, match="the layout must be one of camera, pinhole"):
        panes("stack", 1.0, 1.0)


@pytest.mark.parametrize("window", [0.5, 1.0, 2.5])
def test_the_field_of_the_window_is_that_of_its_picture(window):
    """A point at the picture's right edge is seen at the same place by both cameras."""
    picture, field = 1.6, 70.0
    (pane,) = panes("camera", window, picture)
    slope = np.tan(np.deg2rad(field) / 2)
    rise = np.tan(window_fov(field, window, picture) / 2)
    across = slope / (rise * window)  # from -1 to 1 over the window's width
    assert across == pytest.approx(pane.width)
