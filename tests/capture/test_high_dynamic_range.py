"""Frames in high dynamic range become sRGB levels: values of the standards, and a file."""

import av
import numpy as np
import pytest

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.high_dynamic_range import relative_light, standard_levels
from gaussray.capture.videos import decode_frames, read_video


def levels(value, curve, wide=True):
    signal = np.full((1, 1, 3), round(65535 * value), np.uint16)
    return standard_levels(signal, curve, wide=wide)[0, 0]


@pytest.mark.parametrize(
    ("curve", "signal", "light"),
    [
        # HLG: reference white, the joint of both parts, and the peak (BT.2100: 1/12, 1).
        *(("HLG", 0.75, 1.0), ("HLG", 0.5, 1 / 12 / 0.26496), ("HLG", 1.0, 1 / 0.26496)),
        # PQ: 203 and 100 cd/m2 (BT.2408: 58 and 51 %), and the peak of 10000.
        *(("PQ", 0.5807, 1.0), ("PQ", 0.5081, 100 / 203), ("PQ", 1.0, 10000 / 203)),
    ],
)
def test_light_is_that_of_the_standards(curve, signal, light):
    assert relative_light(np.array([signal]), curve)[0] == pytest.approx(light, rel=3e-3)


@pytest.mark.parametrize("curve", ["HLG", "PQ"])
def test_greys_stay_grey_and_in_order_and_the_peak_is_white(curve):
    grey = np.array([levels(x, curve) for x in np.linspace(0, 1, 50)]).astype(int)
    # Rows of the matrix sum to 1 within a ten-thousandth.
    assert np.ptp(grey, axis=1).max() <= 1 and np.all(np.diff(grey[:, 0]) >= 0)
    assert grey[0, 0] == 0 and grey[-1, 0] == 255
    # Reference white lies one knee above the knee: half of what is above it, a little more.
    half = 255 * (1.055 * 0.7 ** (1 / 2.4) - 0.055)
    white = levels(0.75 if curve == "HLG" else 0.5807, curve)[0]
    assert half - 1 <= white <= half + 3


def test_light_is_proportional_below_the_knee():
    # An eighteenth of white by HLG's square root: 0.5 sqrt(12 x 0.26496 x 0.18).
    expected = 255 * (1.055 * 0.18 ** (1 / 2.4) - 0.055)
    assert levels(0.5 * np.sqrt(12 * 0.26496 * 0.18), "HLG")[0] == pytest.approx(expected, abs=1)


def test_a_wide_gamut_becomes_more_saturated():
    signal = np.full((1, 1, 3), (40000, 20000, 20000), np.uint16)
    narrow, wide = (standard_levels(signal, "HLG", wide=w)[0, 0].astype(int) for w in (False, True))
    assert wide[0] > narrow[0] and wide[1] < narrow[1]


def test_a_video_is_read_as_its_frames_are_mapped(tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.color_trc = 18
        for k in range(3):
            grey = np.full((48, 64, 3), 100 + 20 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
        container.mux(stream.encode())
    with pytest.warns(CaptureWarning, match=r"high dynamic range \(HLG\).*mapped to sRGB"):
        assert read_video(path).frames == 3
    shown = [frame[24, 32].astype(int) for frame in decode_frames(path, range(3))]
    expected = [levels((100 + 20 * k) / 255, "HLG", wide=False) for k in range(3)]
    assert np.abs(np.array(shown) - expected).max() <= 4
