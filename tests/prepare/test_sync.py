"""One clock for all cameras."""

import pathlib

import numpy as np
import pytest
from quads import RATE, arc, mover_at, picture, textures, write_video

from gaussray.prepare import sync
from gaussray.prepare.consensus import Consensus, consensus
from gaussray.prepare.correlation import Delay, confidence, parabola_peak
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.motion import MOTION_RATE, motion_scores, motion_signal
from gaussray.prepare.options import SyncOptions
from gaussray.prepare.sources import Source, find_sources
from gaussray.prepare.sync import (
    Estimate,
    is_one_recording,
    join_estimates,
    solve_offsets,
    synchronise,
)


SMALL = (80, 60)


def test_a_peak_that_is_twice_the_next_one_is_certain_and_an_equal_one_is_nothing():
    lags = np.arange(5.0)
    assert confidence(np.array([0, 1, 0, 0, 2.0]), lags, 1) == 1
    assert confidence(np.array([0, 2, 0, 0, 2.0]), lags, 1) == 0
    assert confidence(np.array([0, 2, 0, 0, 3.0]), lags, 1) == pytest.approx(0.5)


def test_the_maximum_of_a_parabola_is_found_between_samples():
    x = np.arange(7.0)
    assert parabola_peak(5 - (x - 3.3) ** 2, 3) == pytest.approx(3.3)


def test_offsets_are_exact_if_pairs_agree_and_one_lies():
    true = np.array([0, 0.5, -1.25, 2.0])
    pairs = [(i, j, Delay(true[j] - true[i], 1.0)) for i in range(4) for j in range(i + 1, 4)]
    pairs[2] = (0, 3, Delay(7.0, 0.5))
    found = solve_offsets(4, pairs, 0.3)
    # The lie still weighs a little: its residual of 5 s against 20 ms.
    assert found.offsets == pytest.approx(true, abs=2e-3)


def test_a_camera_that_no_trusted_pair_links_is_unknown():
    found = solve_offsets(3, [(0, 1, Delay(1.0, 0.9)), (1, 2, Delay(3.0, 0.1))], 0.3)
    assert found.offsets[1] == pytest.approx(1.0) and np.isnan(found.offsets[2])
    # Whatever is known of the others, the first one cannot be compared with them.
    alone = solve_offsets(3, [(0, 1, Delay(1.0, 0.1)), (1, 2, Delay(3.0, 0.9))], 0.3)
    assert np.isnan(alone.offsets).all()


def test_videos_that_sound_does_not_link_are_placed_by_motion():
    nan, zeros = np.nan, np.zeros(4)
    sound = Estimate(np.array([nan, 0.0, 0.5, nan]), np.array([0, 1, 1, 0.1]), zeros)
    motion = Estimate(np.array([0.0, 0.3, 0.7, 2.0]), np.array([0.8, 0.8, 0.8, 0.6]), zeros)
    found = join_estimates(sound, motion, zeros)
    # Sound says 0.5 s between 1 and 2, motion 0.4: they stay 0.5 apart, in the middle of motion.
    assert found.offsets == pytest.approx([0, 0.25, 0.75, 2.0])
    assert found.confidence == pytest.approx([0.8, 1, 1, 0.6])


def test_without_motion_the_videos_with_sound_stay_together():
    nan, zeros = np.nan, np.zeros(3)
    sound = Estimate(np.array([nan, 0.0, 0.5]), np.array([0.0, 1, 1]), zeros)
    found = join_estimates(sound, Estimate(np.full(3, nan), zeros, zeros), np.array([0, 0.1, 0.2]))
    assert found.offsets[1:] == pytest.approx([0.1, 0.6]) and np.isnan(found.offsets[0])


def test_all_pairs_together_overrule_a_wrong_pair():
    rng, most, true = np.random.default_rng(0), 60, np.array([0, 20, -15])
    scores = {}
    for i, j in ((0, 1), (0, 2), (1, 2)):
        scores[i, j] = rng.uniform(0, 0.5, 2 * most + 1)
        scores[i, j][true[j] - true[i] + most] = 3.0
    scores[0, 2][most + 40] = 4.0
    found = consensus(scores, 3, [0.0] * 3, 3)
    assert np.round(found.offsets) == pytest.approx(true)


def test_scores_are_of_the_lag_that_was_put_in():
    rng = np.random.default_rng(1)
    signal = rng.normal(size=900)
    coefficients, scores = motion_scores(signal[:600], signal[100:700], 200)
    assert scores.argmax() - 200 == 100 and coefficients.max() == pytest.approx(1)


def test_a_signal_has_unit_variance_and_no_slow_change():
    times = np.arange(0, 12, 1 / 30)
    energy = np.exp(0.3 * times + np.sin(9 * times))
    signal = motion_signal(times, energy)
    assert signal.std() == pytest.approx(1) and abs(signal.mean()) < 1e-9
    middle = signal[int(3 * MOTION_RATE) : -int(3 * MOTION_RATE)]
    half = len(middle) // 2
    assert abs(middle[:half].mean() - middle[half:].mean()) < 0.2


@pytest.fixture(scope="module")
def late(tmp_path_factory, painted):
    """Three silent videos of one motion; the second and third start later."""
    folder, starts = tmp_path_factory.mktemp("late"), {"a": 0.0, "b": 1.0, "c": 2.2}
    for (name, start), pose in zip(starts.items(), arc(3), strict=True):
        times = start + np.arange(int(9 * RATE)) / RATE
        frames = [picture(pose, painted, mover_at(t), focal=75.0, size=SMALL) for t in times]
        write_video(folder / f"{name}.mp4", frames)
    return folder, starts


def test_silent_videos_are_synchronised_by_what_moves(late):
    folder, starts = late
    found = synchronise(find_sources(folder), SyncOptions())
    assert found.method == "motion" and min(found.confidence.values()) > 0.3
    assert found.offsets == pytest.approx(starts, abs=0.5 / RATE)


def test_videos_with_sound_are_synchronised_by_it(tmp_path):
    rate, noise = 16000, np.random.default_rng(2).normal(size=16000 * 6) * 0.2
    blank = [np.zeros((32, 48, 3), np.uint8)] * 45
    for name, start in (("a", 0.0), ("b", 0.75)):
        sound = noise[round(start * rate) :][: 3 * rate]
        write_video(tmp_path / f"{name}.mp4", blank, sound=sound, sound_rate=rate)
    found = synchronise(find_sources(tmp_path), SyncOptions())
    assert found.method == "sound"
    assert found.offsets["b"] == pytest.approx(0.75, abs=0.002)


@pytest.mark.ci
@pytest.mark.parametrize("track", ["none", "silence"])
def test_a_muted_video_is_synchronised_by_motion_and_the_others_by_sound(tmp_path, painted, track):
    rate, noise = 16000, np.random.default_rng(3).normal(size=16000 * 12) * 0.2
    starts = {"a": 0.0, "b": 1.0, "c": 2.2}
    for (name, start), pose in zip(starts.items(), arc(3), strict=True):
        times = start + np.arange(int(9 * RATE)) / RATE
        frames = [picture(pose, painted, mover_at(t), focal=75.0, size=SMALL) for t in times]
        sound = noise[round(start * rate) :][: 9 * rate]
        if name == "a":
            sound = None if track == "none" else np.zeros(9 * rate)
        write_video(tmp_path / f"{name}.mp4", frames, sound=sound, sound_rate=rate)
    found = synchronise(find_sources(tmp_path), SyncOptions())
    assert found.method == "sound and motion" and min(found.confidence.values()) > 0.3
    assert found.offsets == pytest.approx(starts, abs=0.5 / RATE)
    assert found.offsets["c"] - found.offsets["b"] == pytest.approx(1.2, abs=0.002)


def test_offsets_that_are_known_are_used(late):
    options = SyncOptions(offsets=(0.0, 1.5, 2.0))
    assert synchronise(find_sources(late[0]), options).offsets == {"a": 0, "b": 1.5, "c": 2}
    with pytest.raises(PrepareError, match="a number for each of the 3 cameras"):
        synchronise(find_sources(late[0]), SyncOptions(offsets=(1.0,)))


@pytest.mark.parametrize(
    ("offsets", "one"),
    [
        ([0.0, 0.12, -0.02], True),
        ([0.0, 0.17, 0.0], False),
        ([0.0, 0.12, -0.06], False),
        ([0.0], False),
    ],
)
def test_equal_videos_less_than_a_frame_apart_start_together(offsets, one):
    assert is_one_recording(np.array(offsets), rate=6.0) is one


@pytest.mark.parametrize(
    ("counts", "rates", "expected"),
    [
        ([48, 20, 48, 48], 6, [0.0, 0.1, 0.0, 0.0]),
        ([48, 48, 48, 48], 6, [0.0, 0.0, 0.0, 0.0]),
        ([48, 20, 20, 47], 6, [0.0, 0.03, 0.03, 0.02]),
        # A frame of those two is shorter than what lies between them.
        ([480, 480, 20, 47], [60, 60, 6, 6], [0.0, 0.1, -0.04, 0.02]),
        ([48, 48, 48, 48], [6, 3, 6, 6], [0.0, 0.1, 0.0, 0.0]),
    ],
)
def test_videos_of_one_length_start_together_beside_others(monkeypatch, counts, rates, expected):
    """Motion finds delays of 0.1, -0.04 and 0.02 s, at 6 frames a second."""
    found = [0.0, 0.1, -0.04, 0.02]
    samples = Consensus(np.array(found) * MOTION_RATE, np.ones(4))
    monkeypatch.setattr(sync, "consensus", lambda *_: samples)
    monkeypatch.setattr(sync, "motion_energy", lambda source, on_frame: np.zeros(source.count))
    monkeypatch.setattr(sync, "motion_signal", lambda times, energy: np.zeros(10_000))
    most = round(SyncOptions().longest * MOTION_RATE)
    ones = np.ones(2 * most + 1)
    monkeypatch.setattr(sync, "motion_scores", lambda *_: (ones, ones))
    path = pathlib.Path("a.mp4")
    sources = [
        Source(f"{k}", path, (), np.arange(count) / rate, ((64, 48),))
        for k, (count, rate) in enumerate(zip(counts, np.broadcast_to(rates, 4), strict=True))
    ]
    offsets = synchronise(sources, SyncOptions(method="motion")).offsets
    assert list(offsets.values()) == pytest.approx(expected, abs=1e-6)


def test_sound_is_not_demanded_of_silent_videos(late):
    with pytest.raises(PrepareError, match="got sound and a, b, c"):
        synchronise(find_sources(late[0]), SyncOptions(method="sound"))


@pytest.mark.parametrize("count", [1, 2])
def test_videos_of_a_frame_or_two_start_together(tmp_path, count):
    frames = list(np.random.default_rng(0).integers(0, 255, (count, 48, 64, 3), np.uint8))
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4", frames)
    found = synchronise(find_sources(tmp_path), SyncOptions())
    assert found.offsets == {"a": 0.0, "b": 0.0}
    assert found.method == ("none" if count == 1 else "motion")


def test_progress_is_told_while_videos_are_compared_by_motion(tmp_path, monkeypatch):
    reports = []

    class Recorder:
        def __init__(self, name, total, patience):
            reports.append((name, total))

        def report(self, done):
            reports.append(done)

    monkeypatch.setattr(sync, "Progress", Recorder)
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4", [picture(arc(1)[0], textures(), size=SMALL)] * 4)
    synchronise(find_sources(tmp_path), SyncOptions(method="motion"))
    assert reports == [("synchronising", 8), *range(1, 9)]
