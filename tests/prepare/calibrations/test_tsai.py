"""Files of Tsai's camera model, against Tsai's own formulas."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from gaussray.prepare.calibrations.assign import assign_cameras
from gaussray.prepare.calibrations.lens_file import read_lenses
from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.calibrations.tsai import MOST_OFF, opencv_distortion, read_tsai
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.sources import Source


# PETS 2009 has such pixels: wider in the frame buffer than on the sensor.
TSAI = {
    "width": 768, "height": 576, "ncx": 795, "nfx": 752, "dx": 4.85e-3, "dy": 4.65e-3,
    "dpx": 4.85e-3 * 795 / 752, "dpy": 4.65e-3, "focal": 5.5, "kappa1": 5e-3,
    "cx": 380.5, "cy": 290.25, "sx": 1.02,
    "tx": -4800.0, "ty": 551.0, "tz": 4966.0, "rx": 1.9, "ry": 0.5, "rz": 0.18,
}  # fmt: skip
PARTS = {
    "Geometry": "width height ncx nfx dx dy dpx dpy",
    "Intrinsic": "focal kappa1 cx cy sx",
    "Extrinsic": "tx ty tz rx ry rz",
}


def text_of(values):
    parts = (
        f"<{part} " + " ".join(f'{key}="{values[key]!r}"' for key in keys.split() if key in values)
        for part, keys in PARTS.items()
    )
    return '<?xml version="1.0"?>\n<Camera name="camera0">\n' + "/>\n".join(parts) + "/>\n</Camera>"


def write(path, **changes):
    values = {key: value for key, value in (TSAI | changes).items() if value is not None}
    path.write_text(text_of(values))
    return path


def tsai_pixel(point, values):
    """Where Tsai's camera sees a point of the world."""
    sa, ca = math.sin(values["rx"]), math.cos(values["rx"])
    sb, cb = math.sin(values["ry"]), math.cos(values["ry"])
    sg, cg = math.sin(values["rz"]), math.cos(values["rz"])
    turn = np.array([
        [cb * cg, cg * sa * sb - ca * sg, sa * sg + ca * cg * sb],
        [cb * sg, sa * sb * sg + ca * cg, ca * sb * sg - cg * sa],
        [-sb, cb * sa, ca * cb],
    ])  # fmt: skip
    x, y, z = turn @ point + [values["tx"], values["ty"], values["tz"]]
    flat = np.array([values["focal"] * x / z, values["focal"] * y / z])
    # Of rd (1 + kappa1 rd^2) = ru by bisection.
    straight, low, high = np.hypot(*flat), 0.0, 2 * np.hypot(*flat)
    for _ in range(80):
        middle = (low + high) / 2
        if middle * (1 + values["kappa1"] * middle**2) < straight:
            low = middle
        else:
            high = middle
    distorted = flat * low / straight
    u = values["cx"] + values["sx"] * distorted[0] / values["dpx"]
    return np.array([u, values["cy"] + distorted[1] / values["dpy"]])


def our_pixel(point, camera):
    """Where OpenCV's lens sees it; the middle of the first pixel is at 0.5."""
    x, y, z = camera.pose[:, :3] @ point + camera.pose[:, 3]
    flat, lens = np.array([x / z, y / z]), camera.lens
    r = flat @ flat
    above = 1 + sum(lens.get(f"k{i}", 0.0) * r**i for i in (1, 2, 3))
    below = 1 + sum(lens.get(f"k{i + 3}", 0.0) * r**i for i in (1, 2, 3))
    return np.array([lens["fl_x"], lens["fl_y"]]) * flat * above / below + [lens["cx"], lens["cy"]]


def seen_points(camera, values):
    """Points 8 m before a camera, all over its picture and into its corners."""
    corners = np.array([[-0.5, -0.5], [767.5, 575.5], [767.5, -0.5], [-0.5, 575.5]])
    pixels = [*corners, *np.random.default_rng(0).uniform((0, 0), (768, 576), (30, 2))]
    for u, v in pixels:
        sensor = np.array([
            (u - values["cx"]) * values["dpx"] / values["sx"], (v - values["cy"]) * values["dpy"]
        ])  # fmt: skip
        flat = sensor * (1 + values["kappa1"] * sensor @ sensor) / values["focal"]
        ray = np.array([*flat, 1.0]) * 8000
        yield (u, v), camera.pose[:, :3].T @ (ray - camera.pose[:, 3])


# Without distortion, as barrels, as a pincushion, and so strong that a fraction is needed.
@pytest.mark.parametrize("kappa", [0.0, 1e-3, 5e-3, -5e-3, 4e-2])
def test_pixels_are_those_of_tsais_formulas(tmp_path, kappa):
    values = TSAI | {"kappa1": kappa}
    path = write(tmp_path / "c0.xml", kappa1=kappa)
    camera, off = read_tsai(path, "c0")
    assert off <= MOST_OFF and (camera.lens["w"], camera.lens["h"]) == (768, 576)
    worst = 0.0
    for pixel, point in seen_points(camera, values):
        theirs = tsai_pixel(point, values)
        assert theirs == pytest.approx(np.array(pixel), abs=1e-6)
        worst = max(worst, np.abs(our_pixel(point, camera) - 0.5 - theirs).max())
    # The bound that is told is one, and it is reached about the corners.
    assert worst <= off * 1.001 + 1e-6
    assert kappa == 0 or off > 0


def test_distortion_that_has_no_inverse_is_refused():
    found, off = opencv_distortion("a.xml", 0.0, 0.6, 900.0)
    assert off == 0 and not found.any()
    with pytest.raises(PrepareError, match="towards its corners distortion turns back"):
        opencv_distortion("a.xml", -1.0, 0.6, 900.0)
    with pytest.raises(PrepareError, match=r"within 0.05 pixels, got [\d.]+"):
        opencv_distortion("a.xml", 300.0, 0.6, 900.0)


def video(name, size):
    return Source(name, Path(name), (), np.arange(3) / 25, (size,))


def test_a_folder_of_a_file_for_each_camera_is_one_calibration(tmp_path, capsys):
    for k in range(4):
        write(tmp_path / f"terrace-tsai-c{k}.xml", tx=1000.0 * k)
    calibration = read_calibration(tmp_path)
    assert [one.name for one in calibration.cameras] == [f"terrace-tsai-c{k}" for k in range(4)]
    told = capsys.readouterr().out
    assert "R = Rz Ry Rx takes world to camera, kappa1 becomes OpenCV's coefficients (at m" in told
    assert "R and t are taken" not in told
    # The videos have half the size.
    known, _, _ = assign_cameras(
        calibration, [video(f"terrace1-c{k}", (384, 288)) for k in range(4)]
    )
    assert [one.pose[0, 3] for one in known.values()] == [0, 1000, 2000, 3000]
    whole = calibration.cameras[0].lens
    assert known["terrace1-c0"].lens["fl_x"] == pytest.approx(whole["fl_x"] / 2)


def test_one_file_alone_is_a_lens_and_names_the_folder(tmp_path):
    path = write(tmp_path / "c0.xml")
    with pytest.raises(
        PrepareError, match=re.escape(f"give their folder: poses.calibration={tmp_path}")
    ):
        read_calibration(path)
    (lens,) = read_lenses(path).values()
    assert lens["fl_x"] == pytest.approx(5.5 * 1.02 / (4.85e-3 * 795 / 752)) and lens["w"] == 768


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kappa1": None}, "must have a number for each parameter, got no kappa1. A camera has <G"),
        ({"rx": "wide"}, "got rx='wide'"),
        ({"focal": -5.5}, "focal must be above 0, got -5.5"),
        ({"kappa1": -1.0}, "distortion turns back. Is kappa1 in 1/mm.2"),
        ({"dpx": None, "dx": None}, "got no dpx"),
    ],
)
def test_a_wrong_number_is_named(tmp_path, changes, message):
    write(tmp_path / "c0.xml")
    write(tmp_path / "c1.xml", **changes)
    with pytest.raises(PrepareError, match=message):
        read_calibration(tmp_path)


def test_the_size_of_a_pixel_follows_from_the_sensor(tmp_path, capsys):
    camera, _ = read_tsai(write(tmp_path / "c0.xml"), "c0")
    without, _ = read_tsai(write(tmp_path / "c1.xml", dpx=None, dpy=None), "c1")
    assert without.lens == camera.lens and not capsys.readouterr().out
    read_tsai(write(tmp_path / "c2.xml", ncx=800), "c2")
    assert "is taken, and not the 0.00515957 that dx ncx nfx make." in capsys.readouterr().out
