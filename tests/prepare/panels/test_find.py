"""Videos of several views or maps are told, ordinary pictures are not."""

import warnings

import numpy as np
import pytest
from quads import looking, picture, write_video
from scipy.ndimage import gaussian_filter

from gaussray.capture.errors import CaptureWarning
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.panels.failures import holds_views, panels_in_errors
from gaussray.prepare.panels.find import find_panels, panel_signs, warn_of_panels
from gaussray.prepare.sources import find_sources


SIZE = (240, 180)


def warn(path, picture):
    warn_of_panels([path], [panel_signs(picture)])


def layout(picture):
    """Rows and columns of the panels that are found, and which are kept."""
    (found,) = find_panels([panel_signs(picture)])
    return None if found is None else (*found.layout, found.pictures)


LEFT, RIGHT = "crop=iw/2:ih:0:0 'cam a_left.mp4'", "crop=iw/2:ih:iw/2:0 'cam a_right.mp4'"
UPPER, LOWER = "crop=iw:ih/2:0:0 'cam a_upper.mp4'", "crop=iw:ih/2:0:ih/2 'cam a_lower.mp4'"


@pytest.fixture(scope="module")
def views(painted):
    """The room from two places side by side."""
    poses = [looking((x, -3.5, 1.8), target=(x, 1.5, 0.8)) for x in (0.0, 0.06)]
    return [picture(pose, painted, size=SIZE) for pose in poses]


@pytest.mark.parametrize(
    ("axis", "how", "first", "second"),
    [
        (1, "two views side by side", LEFT, RIGHT),
        (0, "two views one above", UPPER, LOWER),
    ],
)
def test_two_views_in_a_picture_are_told_with_the_cuts(tmp_path, views, axis, how, first, second):
    write_video(tmp_path / "cam a.mp4", [np.concatenate(views, axis)] * 3)
    with pytest.warns(CaptureWarning) as told:
        assert len(find_sources(tmp_path)) == 1
    (text,) = [str(warning.message) for warning in told]
    assert text.startswith(f"{tmp_path / 'cam a.mp4'}: ") and how in text
    assert f"`ffmpeg -i '{tmp_path / 'cam a.mp4'}' -vf {first}`" in text and second in text


def test_narrowed_views_are_told_if_they_are_very_alike_and_widened_again(tmp_path, views):
    narrowed = np.concatenate([views[0][:, ::2]] * 2, axis=1)
    with pytest.warns(CaptureWarning, match=r"crop=iw/2:ih:0:0,scale=2\*iw:ih a_left.mp4"):
        warn(tmp_path / "a.mp4", narrowed)
    warn(tmp_path / "a.mp4", np.concatenate([v[:, ::2] for v in views], axis=1))


def test_one_view_is_not_taken_for_two(tmp_path, painted, views):
    wide = picture(looking((0, -3.5, 1.8)), painted, size=(480, 180))
    mirrored = np.concatenate([views[0], views[0][:, ::-1]], axis=1)
    rng = np.random.default_rng(0)
    plain = rng.integers(127, 130, (180, 480, 3)).astype(np.uint8)
    # Edges across the cut continue in the other half: a pole, a horizon.
    pole = np.full((480, 240, 3), 90, np.uint8)
    pole[:, 100:130] = 200
    noise = rng.integers(0, 30, (480, 240, 1)).astype(np.uint8)
    horizon = (pole + noise).transpose(1, 0, 2)
    for one in (wide, mirrored, plain, pole + noise, horizon, np.zeros((20, 60, 3), np.uint8)):
        warn(tmp_path / "a.mp4", np.ascontiguousarray(one))
    warn(tmp_path / "a.mp4", views[0])


def test_two_square_views_are_cut_and_not_stretched(tmp_path, views):
    square = np.concatenate([view[:, 30:210] for view in views], axis=1)
    with pytest.warns(CaptureWarning, match="two views side by side") as told:
        warn(tmp_path / "a.mp4", square)
    assert "scale=" not in str(told[0].message)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(180, 480), (240, 480), (480, 240), (480, 640)])
@pytest.mark.parametrize("period", [12, 20, 33])
def test_tiles_and_bricks_are_not_two_views(tmp_path, size, period):
    rows, columns = np.indices(size)
    noise = np.random.default_rng(0).normal(0, 4, size)
    tiles = np.where((rows % period < period // 8) | (columns % period < period // 8), 60, 190)
    course = rows // (period // 2)
    shifted = columns + course % 2 * (period // 2)
    bricks = np.where((rows % (period // 2) < 1) | (shifted % period < period // 10), 190, 110)
    board = (rows // period + columns // period) % 2 * 150 + 50
    for levels in (tiles, bricks, board):
        grey = (levels + noise).clip(0, 255).astype(np.uint8)
        warn(tmp_path / "a.mp4", np.repeat(grey[..., None], 3, axis=2))


@pytest.fixture(scope="module")
def simulated():
    """What a simulator writes into one video: a coloured picture, its depth and its mask."""
    rng = np.random.default_rng(3)
    depth = np.tile(np.linspace(60, 220, 240), (180, 1))
    mask, color = np.zeros((180, 240)), rng.integers(86, 92, (180, 240, 3)).astype(float)
    color += np.linspace(0, 90, 180)[:, None, None] * (1, 0.4, 0.1)
    for k in range(6):
        y, x = rng.integers(0, 130), rng.integers(0, 190)
        place = slice(y, y + 30), slice(x, x + 30)
        depth[place], mask[place] = 30 + 10 * k, 40 + 40 * k
        color[place] = rng.integers(0, 256, 3)
    grey = [np.repeat(one[..., None], 3, axis=2) for one in (depth, mask)]
    return [one.clip(0, 255).astype(np.uint8) for one in (color, *grey)]


def test_of_a_picture_with_depth_and_mask_the_picture_alone_is_kept(tmp_path, simulated):
    with pytest.warns(
        CaptureWarning, match="three panels side by side, of which only the left"
    ) as w:
        warn(tmp_path / "in_hand.mp4", np.concatenate(simulated, axis=1))
    text = str(w[0].message)
    assert "crop=iw/3:ih:0:0 in_hand_left.mp4" in text and "in_hand_middle" not in text
    assert layout(np.concatenate(simulated[1:] + simulated[:1], axis=1)) == (1, 3, (2,))
    assert layout(np.concatenate(simulated, axis=0)) == (3, 1, (0,))
    # Half a picture of depth in an ordinary shape, and maps that are black at the cut between them.
    assert layout(np.concatenate([one[:, ::2] for one in simulated[:2]], axis=1)) == (1, 2, (0,))
    dark = [one // 32 for one in simulated[1:]]
    assert layout(np.concatenate([simulated[0], *dark], axis=1)) == (1, 3, (0,))


@pytest.fixture(scope="module")
def unlike(painted):
    """Four views of the room with cameras of other exposures, without its noise of single pixels,
    which hides a seam."""
    poses = [looking((x, -3.5, 1.8), target=(-x, 1.5, 0.8)) for x in (-2.0, 0.0, 2.0, 1.0)]
    shown = [picture(pose, painted, size=SIZE) for pose in poses]
    gains = (1.0, 0.6, 0.9, 0.5)
    return [
        (gain * gaussian_filter(one, (2, 2, 0))).astype(np.uint8)
        for gain, one in zip(gains, shown, strict=True)
    ]


def test_three_views_and_grids_are_found_by_their_seams(unlike):
    assert layout(np.concatenate(unlike[:3], axis=1)) == (1, 3, (0, 1, 2))
    assert layout(np.concatenate(unlike, axis=1)) == (1, 4, (0, 1, 2, 3))
    assert layout(np.concatenate(unlike[:3], axis=0)) == (3, 1, (0, 1, 2))
    a, b, c, d = unlike
    rows = [np.concatenate(pair, axis=1) for pair in ((a, c), (d, b))]
    assert layout(np.concatenate(rows, axis=0)) == (2, 2, (0, 1, 2, 3))


def test_of_a_grid_each_panel_has_a_command(tmp_path, unlike):
    a, d, b, c = unlike
    with pytest.warns(CaptureWarning, match="looks like 2 x 2 views") as told:
        warn(
            tmp_path / "a.mp4",
            np.concatenate([np.concatenate([a, b], 1), np.concatenate([c, d], 1)]),
        )
    text = str(told[0].message)
    for place in ("0:0 a_upper_left", "iw/2:0 a_upper_right", "0:ih/2 a_lower_left"):
        assert f"crop=iw/2:ih/2:{place}.mp4" in text
    assert "crop=iw/2:ih/2:iw/2:ih/2 a_lower_right.mp4" in text


@pytest.mark.parametrize("size", [(480, 640), (360, 640), (480, 1440), (480, 1600)])
def test_door_frames_and_windows_are_no_seams(size):
    """Posts have two edges, and openings lie elsewhere than at the cuts to the pixel."""
    rng = np.random.default_rng(1)
    height, width = size
    for third in (width // 3, width // 2, 2 * width // 3):
        for bar in (1, 2, 3, 6, 12, 30):
            door = rng.integers(90, 100, (*size, 3)).astype(np.uint8)
            for at in {third, width - third}:
                door[:, at - bar // 2 : at - bar // 2 + bar] = (30, 60, 20)
            assert layout(door) is None
            door[:, third : third + width // 5] = (200, 180, 40)
            assert layout(door) is None
    window = rng.integers(150, 220, (*size, 3)).astype(np.uint8)
    for k in range(1, 4):
        window[:, k * width // 4 - 4 : k * width // 4 + 4] = 40
        window[k * height // 4 - 4 : k * height // 4 + 4] = 40
    assert layout(window) is None
    # The bars of a test picture lie at the halves and quarters, too.
    bars = np.repeat(rng.integers(0, 256, (1, 8, 3)), width // 8, axis=1).repeat(height, axis=0)
    assert layout(bars.astype(np.uint8)) is None


def test_beside_a_video_of_panels_less_is_asked_of_another_one(unlike):
    """Of unlike views a third of the seam is clear: alone, that is no sign."""
    left, right = unlike[0], unlike[2].copy()
    right[:110, :40] = left[:110, -40:][:, ::-1]
    doubtful, sure = np.concatenate([left, right], 1), np.concatenate([left, left], 1)
    signs = [panel_signs(one) for one in (doubtful, sure)]
    assert find_panels(signs[:1]) == [None]
    assert [one and (*one.layout,) for one in find_panels(signs)] == [(1, 2), (1, 2)]
    # A single view of this size, and panels of another size.
    wide = panel_signs(np.repeat(left, 2, axis=1))
    assert find_panels([wide, signs[1]])[0] is None
    other = panel_signs(np.concatenate([left[:144, :192]] * 2, 1))
    found = find_panels([signs[0], other])
    assert found[0] is None and found[1] is not None


def test_views_are_sure_by_two_signs(tmp_path, views, unlike):
    """They are alike, and a seam is between them: then poses are tried once."""
    smooth = [gaussian_filter(view, (1.5, 1.5, 0)) for view in views]
    dark = [smooth[0], (0.4 * smooth[1]).astype(np.uint8)]
    single, plain, sure = (
        np.concatenate(pair, axis=1) for pair in ((views[0], views[0][:, ::-1]), unlike[:2], dark)
    )
    for name, shown, expected in (("a", single, False), ("b", plain, False), ("c", sure, True)):
        path = tmp_path / name
        path.mkdir()
        write_video(path / "v.mp4", [shown] * 2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CaptureWarning)
            (source,) = find_sources(path)
        assert holds_views(source) == expected


def test_a_failure_begins_with_which_videos_hold_panels(tmp_path, views):
    write_video(tmp_path / "a.mp4", [np.concatenate(views, 1)] * 3)
    write_video(tmp_path / "b.mp4", [views[0]] * 3)
    with pytest.warns(CaptureWarning, match="two views side by side"):
        sources = find_sources(tmp_path)
    with pytest.raises(PrepareError, match="^a.mp4 seems to hold .* failed: no poses.$"):
        with panels_in_errors(sources):
            raise PrepareError("no poses.")
    with pytest.raises(PrepareError, match="^no poses.$"), panels_in_errors(sources[1:]):
        raise PrepareError("no poses.")
