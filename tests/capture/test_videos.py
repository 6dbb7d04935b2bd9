"""Frames of videos: the right one, upright, in its colours, and every way to be no video."""

import av
import films
import numpy as np
import pytest

from gaussray.capture import videos
from gaussray.capture.errors import CaptureError
from gaussray.capture.videos import (
    decode_frames,
    frame_of,
    frame_path,
    is_video,
    read_frame,
    read_video,
)


# Eight-bit limited-range YUV, and what a codec loses of an even picture.
CODES = 4


@pytest.fixture
def opened(monkeypatch):
    """The paths of all files opened since."""
    paths, original = [], av.open

    def counted(path, *rest, **options):
        paths.append(path)
        return original(path, *rest, **options)

    monkeypatch.setattr(videos.av, "open", counted)
    return paths


@pytest.mark.parametrize("suffix", films.CODECS)
def test_size_number_and_order_of_the_frames_in_every_container(tmp_path, suffix):
    path = films.film(tmp_path / f"cam{suffix}", films.shades(10))
    assert read_video(path) == (48, 32, 10)
    assert [films.index_of(p) for p in decode_frames(path, range(10))] == list(range(10))


@pytest.mark.parametrize("tags", [(1, 1), (1, 5), (1, 6), (2, 1), (2, 5), None])
def test_range_and_matrix_of_the_file_give_the_same_colours(tmp_path, tags):
    color = (200, 60, 30)
    path = films.film(tmp_path / "c.mp4", [np.full((32, 48, 3), color, np.uint8)], tags=tags)
    assert np.abs(read_frame(path, 0).astype(int) - color).max() <= CODES


def test_chosen_frames_are_decoded_once_as_they_are_asked_for(tmp_path, opened):
    path = films.film(tmp_path / "c.mp4", films.shades(10))
    opened.clear()
    frames = decode_frames(path, [1, 4, 4, 9])
    assert films.index_of(next(frames)) == 1
    before = len(opened)
    assert [films.index_of(frame) for frame in frames] == [4, 4, 9]
    assert len(opened) == before == 2  # to look at its packets, and to decode it


def test_single_frames_go_on_from_the_last_one(tmp_path, opened):
    path = films.film(tmp_path / "c.mp4", films.shades(10))
    opened.clear()
    assert [films.index_of(read_frame(path, i)) for i in (0, 2, 2, 7)] == [0, 2, 2, 7]
    assert len(opened) == 2
    assert films.index_of(read_frame(path, 3)) == 3
    assert len(opened) == 3


def test_a_video_that_was_written_anew_is_read_anew(tmp_path):
    path = films.film(tmp_path / "c.mp4", films.shades(4))
    assert read_video(path).frames == 4 and films.index_of(read_frame(path, 3)) == 3
    films.film(path, films.shades(6)[::-1])
    assert read_video(path).frames == 6 and films.index_of(read_frame(path, 3)) == 2


def test_the_path_of_a_frame_and_back(tmp_path):
    path = frame_path(tmp_path / "cam00.MP4", 12)
    assert path == tmp_path / "cam00.MP4" / "0012"
    assert frame_of(path) == (tmp_path / "cam00.MP4", 12)
    for other in ("cam00.mp4/0001.png", "cam00/0001", "cam00.mp4", "cam00.mp4/-1", "c.mp4/x1"):
        assert frame_of(tmp_path / other) is None
    assert is_video(tmp_path / "a.webm") and not is_video(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("matrix", "quarters"), [((0, 1, -1, 0), 1), ((-1, 0, 0, -1), 2), ((0, -1, 1, 0), 3)]
)
def test_a_turned_video_is_shown_upright(tmp_path, matrix, quarters):
    # The matrix takes (x, y), y down, to (a x + c y, b x + d y): (0, 1, -1, 0) turns clockwise.
    path = films.turn(films.film(tmp_path / "c.mp4", films.shades(3)), matrix)
    height, width = (48, 32) if quarters % 2 else (32, 48)
    assert read_video(path) == (width, height, 3)
    expected = np.rot90(films.shades(3)[2], -quarters)
    assert np.abs(read_frame(path, 2).astype(int) - expected).mean() <= CODES


def test_a_video_that_is_turned_aslant_is_refused(tmp_path):
    path = films.turn(films.film(tmp_path / "c.mp4", films.shades(3)), (0.6, 0.8, -0.8, 0.6))
    with pytest.raises(CaptureError, match="c.mp4: a video must be turned by quarters"):
        read_video(path)


def test_frames_at_uneven_times_are_refused(tmp_path):
    steady = [3000 * i for i in range(8)]
    films.film(tmp_path / "even.mp4", films.shades(8), pts=[t + t % 7 for t in steady])
    assert read_video(tmp_path / "even.mp4").frames == 8
    late = [*steady[:5], *(t + 3000 for t in steady[5:])]
    films.film(tmp_path / "gap.mp4", films.shades(8), pts=late)
    with pytest.raises(CaptureError, match="gap.mp4.*evenly spaced.*after frame 4.*fps=30"):
        read_video(tmp_path / "gap.mp4")


@pytest.mark.parametrize("suffix", films.CODECS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.7, 0.9])
def test_a_truncated_video_is_refused(tmp_path, suffix, share):
    path = films.cut(films.film(tmp_path / f"c{suffix}", films.shades(19)), share)
    with pytest.raises((OSError, CaptureError), match=f"c{suffix}: .* is truncated"):
        read_video(path)


def test_a_video_whose_index_comes_last_and_is_cut_off(tmp_path):
    path = films.film(tmp_path / "c.mp4", films.shades(10), faststart=False)
    with pytest.raises(OSError, match="c.mp4: the video is truncated or corrupt"):
        read_video(films.cut(path, 0.5))


def test_a_video_that_is_damaged_in_the_middle(tmp_path):
    dice = np.random.default_rng(0)
    frames = [dice.integers(0, 256, (32, 48, 3), np.uint8) for _ in range(10)]
    path = films.film(tmp_path / "c.mp4", frames)
    data = bytearray(path.read_bytes())
    start = len(data) // 2
    data[start : start + 800] = bytes(800)
    path.write_bytes(data)
    assert read_video(path).frames == 10
    with pytest.raises(OSError, match="c.mp4: the video is truncated or corrupt"):
        list(decode_frames(path, range(10)))


def test_what_is_no_video(tmp_path):
    with pytest.raises(FileNotFoundError, match="c.mp4: the video does not exist"):
        read_frame(tmp_path / "c.mp4", 0)
    (tmp_path / "t.mp4").write_text("hello")
    with pytest.raises(OSError, match="t.mp4: the video is truncated or corrupt"):
        read_video(tmp_path / "t.mp4")
    with av.open(str(tmp_path / "sound.mp4"), "w") as file:
        stream = file.add_stream("aac", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.sample_rate = 8000
        file.mux(stream.encode(frame))
        file.mux(stream.encode())
    with pytest.raises(CaptureError, match="sound.mp4: a video must hold a stream of pictures"):
        read_video(tmp_path / "sound.mp4")


@pytest.mark.parametrize("index", [-1, 3])
def test_a_frame_beyond_the_end(tmp_path, index):
    path = films.film(tmp_path / "c.mp4", films.shades(3))
    with pytest.raises(CaptureError, match=f"index of a frame must be in 0 ... 2, got {index}"):
        read_frame(path, index)
