"""Delays between sound tracks."""

import numpy as np
import pytest
from quads import write_video

from gaussray.prepare.sound import SOUND_RATE, read_sound, sound_delay


SAMPLE = 1.5 / SOUND_RATE  # seconds: a peak lies on a sample


@pytest.fixture
def noise():
    return np.random.default_rng(3).normal(size=6 * SOUND_RATE) * 0.2


@pytest.mark.parametrize("delay", [-1.25, 0.0, 0.4])
def test_the_delay_of_a_track_is_found(noise, delay):
    # The second camera starts `delay` seconds after the first: its clock needs that much added.
    start = SOUND_RATE * 2
    late = start + round(delay * SOUND_RATE)
    first, second = noise[start : start + 2 * SOUND_RATE], noise[late : late + 2 * SOUND_RATE]
    found = sound_delay(first, second, 3.0)
    assert found.seconds == pytest.approx(delay, abs=SAMPLE) and found.confidence > 0.9


def test_an_echo_and_another_microphone_change_nothing(noise):
    heard = noise + 0.6 * np.roll(noise, 300) + 0.3 * np.roll(noise, 900)
    heard = np.convolve(heard, [0.5, 0.3, -0.2, 0.1], "same")
    delay = 0.5
    late = round(delay * SOUND_RATE)
    found = sound_delay(noise[: 4 * SOUND_RATE], heard[late : late + 4 * SOUND_RATE], 3.0)
    assert found.seconds == pytest.approx(delay, abs=SAMPLE) and found.confidence > 0.3


def test_other_sounds_have_no_confidence(noise):
    other = np.random.default_rng(4).normal(size=len(noise))
    assert sound_delay(noise, other, 3.0).confidence < 0.2


def test_a_track_is_read_at_the_common_rate(tmp_path):
    rate, tone = 16000, 440.0
    samples = 0.5 * np.sin(2 * np.pi * tone * np.arange(rate) / rate)
    frames = [np.zeros((32, 48, 3), np.uint8)] * 5
    write_video(tmp_path / "a.mp4", frames, sound=samples, sound_rate=rate)
    track, _ = read_sound(tmp_path / "a.mp4")
    spectrum = np.abs(np.fft.rfft(track))
    peak = np.fft.rfftfreq(len(track), 1 / SOUND_RATE)[spectrum.argmax()]
    assert peak == pytest.approx(tone, abs=2)
    assert len(track) == pytest.approx(SOUND_RATE, rel=0.2)
