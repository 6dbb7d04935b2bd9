"""Writes a sample of a generated dataset as EuRoC does: pictures, IMU and the true states."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gaussray.camera.distortion import COEFFICIENTS
from gaussray.camera.imu import ImuOptions, ImuSamples, imu_samples
from gaussray.dataset.camera_paths import path_of_frames
from gaussray.dataset.sample_files import SampleFiles
from gaussray.io.atomic import atomic_path


# Nanoseconds in a second.
_NANO = 10**9
# Distortion models of EuRoC, with the keys of their coefficients in a manifest.
_DISTORTIONS = {
    "PINHOLE": ("radial-tangential", ("k1", "k2", "p1", "p2")),
    "OPENCV": ("radial-tangential", ("k1", "k2", "p1", "p2")),
    "OPENCV_FISHEYE": ("equidistant", ("k1", "k2", "k3", "k4")),
}
# Coefficients of OpenCV that these models do not have.
_MORE = COEFFICIENTS[4:]
_IMU = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],\
a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
_STATE = "#timestamp,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],\
q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],\
v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],\
b_w_RS_S_x [rad s^-1],b_w_RS_S_y [rad s^-1],b_w_RS_S_z [rad s^-1],\
b_a_RS_S_x [m s^-2],b_a_RS_S_y [m s^-2],b_a_RS_S_z [m s^-2]"


def euroc_writer(options: ImuOptions) -> Callable[[SampleFiles, Path, int], int]:
    """A writer of samples as EuRoC (Burri et al. 2016), with an IMU of these options.

    OUT/SAMPLE/mav0 gets cam0 (pictures named by their time in nanoseconds, data.csv, sensor.yaml),
    imu0 and state_groundtruth_estimate0. The body is the IMU, whose axes are the camera's.
    """

    def write(source: SampleFiles, out: Path, _: int) -> int:
        root, begin = out / source.name / "mav0", _origin(source.frames, options)
        nanos = [_nanoseconds(frame["time"], options) + begin for frame in source.frames]
        lines = ["#timestamp [ns],filename"]
        for nano, frame in zip(nanos, source.frames, strict=True):
            source.copy(source.file(frame), root / f"cam0/data/{nano}.png")
            lines.append(f"{nano},{nano}.png")
        _write(root / "cam0/data.csv", lines)
        _write_yaml(root / "cam0/sensor.yaml", _camera(source, nanos, begin))
        _write_yaml(root / "body.yaml", {"comment": "rendered by gaussray"})
        times, samples = _samples(source, options)
        stamps = [nano + begin for nano in times]
        _write(root / "imu0/data.csv", [_IMU, *_rows(stamps, samples[:2])])
        _write_yaml(root / "imu0/sensor.yaml", _sensor(options))
        state = [_STATE, *_rows(stamps, samples[2:])]
        _write(root / "state_groundtruth_estimate0/data.csv", state)
        return len(source.frames)

    return write


def _nanoseconds(time: float, options: ImuOptions) -> int:
    return round(time * options.seconds_per_unit * _NANO)


def _rows_of(frame: dict[str, Any]) -> list[float]:
    return frame.get("row_times") or [frame["time"]]


def _origin(frames: Sequence[dict[str, Any]], options: ImuOptions) -> int:
    """Whole seconds, in nanoseconds, that make all times positive."""
    first = min(min(_rows_of(frame)) for frame in frames) * options.seconds_per_unit
    return max(-math.floor(first), 0) * _NANO


def _samples(source: SampleFiles, options: ImuOptions) -> tuple[list[int], ImuSamples]:
    """The IMU from the first row of the first picture to the last row of the last one, within the
    times of the path, and its times in nanoseconds."""
    path = path_of_frames(source.frames)
    rows = [time for frame in source.frames for time in (*_rows_of(frame), frame["time"])]
    first, last = min(rows), max(rows)
    if path.time.shape[0] > 1:
        first, last = max(first, float(path.time[0])), min(last, float(path.time[-1]))
    begin, end = (_nanoseconds(time, options) for time in (first, last))
    count = int((end - begin) * options.rate / _NANO) + 1
    nanos = [begin + round(k * _NANO / options.rate) for k in range(count)]
    sample_options = replace(options, seed=options.seed + int(source.name))
    return nanos, imu_samples(path, np.array(nanos) / _NANO, options=sample_options)


def _rows(stamps: Sequence[int], columns: Sequence[np.ndarray]) -> list[str]:
    table = np.concatenate(columns, axis=1)
    return [
        ",".join([str(stamp), *(f"{x:.12g}" for x in row)])
        for stamp, row in zip(stamps, table, strict=True)
    ]


def check_euroc_lens(keys: Mapping[str, Any], where: str) -> None:
    """Check that EuRoC can describe a lens.

    Args:
        keys: the lens's keys in a manifest.
        where: the key of the layout, with the sample that it is of, for the message.

    Raises:
        ValueError: It cannot; the message names the lens.
    """
    model = keys.get("camera_model") or keys.get("lens", {}).get("model")
    more = " ".join(k for k in _MORE if model != "OPENCV_FISHEYE" and keys.get(k))
    if model not in _DISTORTIONS or more:
        raise ValueError(
            f"{where}=euroc must have a pinhole lens with k1 k2 p1 p2 or a Kannala-Brandt fisheye, "
            f"got {model}{f' with {more}' if more else ''}. Render with lens=pinhole, or choose "
            "the layout tum."
        )


def _camera(source: SampleFiles, nanos: Sequence[int], begin: int) -> dict[str, Any]:
    frame = source.frames[0]
    check_euroc_lens(frame, f"{source.data}: sample {source.name}: layout")
    name, keys = _DISTORTIONS[frame["camera_model"]]
    rate = _NANO * (len(nanos) - 1) / (nanos[-1] - nanos[0]) if len(nanos) > 1 else 0.0
    return {
        "sensor_type": "camera",
        "comment": f"timestamps are the capture's times plus {begin // _NANO} s",
        "T_BS": _identity(),
        "rate_hz": rate,
        "resolution": [frame["w"], frame["h"]],
        "camera_model": "pinhole",
        # EuRoC counts from the centre of the first pixel, manifests from its corner.
        "intrinsics": [frame["fl_x"], frame["fl_y"], frame["cx"] - 0.5, frame["cy"] - 0.5],
        "distortion_model": name,
        "distortion_coefficients": [float(frame.get(key, 0.0)) for key in keys],
    }


def _sensor(options: ImuOptions) -> dict[str, Any]:
    return {
        "sensor_type": "imu",
        "comment": "the camera's axes: right, down, forward",
        "T_BS": _identity(),
        "rate_hz": options.rate,
        "gyroscope_noise_density": options.gyroscope_noise,
        "gyroscope_random_walk": options.gyroscope_walk,
        "accelerometer_noise_density": options.accelerometer_noise,
        "accelerometer_random_walk": options.accelerometer_walk,
    }


def _identity() -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": np.eye(4).reshape(-1).tolist()}


def _write(path: Path, lines: Sequence[str]) -> None:
    with atomic_path(path) as partial:
        partial.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _write_yaml(path: Path, content: dict[str, Any]) -> None:
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    _write(path, ["# written by gaussray", *text.splitlines()])
