"""What tells of cameras: captures, camera paths, tables of rays, manifests."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from experiments.hostile.clouds import ply
from experiments.hostile.pictures import film, picture
from experiments.hostile.reader import Files, Reader, saved, text, written


TURN = [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]
FRAME = {
    "file_path": "a/0.png",
    "transform_matrix": TURN,
    "time": 0.5,
    "camera": "a",
    "split": "train",
}
LENS = {"w": 4, "h": 3, "fl_x": 4.0, "fl_y": 4.0, "cx": 2.0, "cy": 1.5}


def _paired() -> list[Files]:
    moves = {"time": 1.0, "transform_matrix": TURN}
    opening = {"radius": 0.1, "rim": {"radius": 1, "distance": 0.5}}
    pull = {"time": [0, 1], "distance": [1, "infinity"]}
    shake = {"turn": 0.1, "move": 0.1, "correlation_time": 1, "seed": 3}
    blocks = [
        {"aperture": {**opening, "focus_distance": 2, "blades": 5}},
        {"aperture": {**opening, "focus_distance": pull}},
        {"shutter": {"row_step": 0.1, "exposure": 0.1, "direction": "left_to_right"}},
        {"shutter": {"row_times": [0.0, 0.1, 0.2], "trigger": 0.1}},
        {"trajectory": [{**moves, "time": 0.0}, moves]},
        {"trajectory": {"poses": [moves], "shake": shake}},
        {"lens": {"model": "equidistant", "fov": 2.0}},
        {"lens": {"model": "f_theta", "polynomial": "radius_of_angle", "k": [0, 4.0], "fov": 1.0}},
        {"lens": {"model": "double_sphere", "k": [0.1, 0.5], "fov": 2.0}},
        {"lens": {"model": "blender_fisheye_polynomial", "k": [0, -0.1, 0, 0, 0], "fov": 3.0,
                  "sensor_width_mm": 36, "sensor_height_mm": 27}},
        {"camera_model": "OPENCV_FISHEYE", "k1": 0.1},
        {"camera_model": "OPENCV", "k1": 0.1, "film": {"filter": "gaussian", "filter_width": 2}},
        {"mask_path": "a/m.png", "ply_file_path": "p.ply", "time_unit": "s", "samples": 3},
    ]  # fmt: skip
    other = ply()[0]["p.ply"]
    return [
        {"transforms.json": text({**LENS, **block, "frames": [FRAME]}), "p.ply": other}
        for block in blocks
    ]


def _read_capture(folder: Path) -> object:
    from gaussray.capture.open import open_capture

    return open_capture(folder)


def _splits() -> list[Files]:
    frames = [{**FRAME, "file_path": "./a/0"}, {**FRAME, "time": 0.7}]
    listed = {"train": frames, "test": frames[:1]}
    files = {
        f"transforms_{name}.json": text({"camera_angle_x": 0.9, "frames": some})
        for name, some in listed.items()
    }
    return [{**files, "a/0.png": picture(".png")}]


def _neural3d() -> list[Files]:
    row = [0, 1, 0, 0, 16, -1, 0, 0, 0, 16, 0, 0, 1, 2, 20.0, 1, 9]
    return [{"poses_bounds.npy": saved(np.array([row])), "cam00.mp4": film(".mp4", "libx264")}]


def _pinf() -> list[Files]:
    video = {"file_name": "a.mp4", "frame_num": 1, "camera_angle_x": 0.9, "transform_matrix": TURN}
    info = {"train_videos": [video], "test_videos": [{**video, "camera_hw": [3, 4]}]}
    return [{"info.json": text(info), "a.mp4": film(".mp4", "libx264")}]


def _immersive() -> list[Files]:
    camera = {"name": "camera_0001", "width": 4, "height": 3, "focal_length": 3.0}
    camera |= {"principal_point": [2.0, 1.5], "radial_distortion": [0.01, 0.0, 0.0]}
    camera |= {"orientation": [0.1, 0, 0], "position": [0, 0, 1], "projection_type": "fisheye"}
    second = {**camera, "name": "camera_0002", "position": [1, 0, 1]}
    pictures = {f"camera_000{k}/0.png": picture(".png") for k in (1, 2)}
    return [{"models.json": text([camera, second]), **pictures}]


def _technicolor() -> list[Files]:
    rows = [f"3.0 2.0 1.5 1 0 1 0 0 0 {k} 0 1" for k in range(2)]
    table = "\n".join(["focal cx cy aspect skew qw qx qy qz tx ty tz", *rows]).encode()
    pictures = {f"a_0_{k}.png": picture(".png") for k in range(2)}
    return [{"cameras_parameters.txt": table, **pictures}]


def _actorshq() -> list[Files]:
    rows = [f"Cam00{k}, 4, 3, 0, 0.1, 0, {k}, 0, 1, 1.1, 1.4, 0.5, 0.5" for k in (1, 2)]
    table = "\n".join(["name, w, h, rx, ry, rz, tx, ty, tz, fx, fy, px, py", *rows]).encode()
    pictures = {f"rgbs/Cam00{k}/Cam00{k}_rgb000000.png": picture(".png") for k in (1, 2)}
    return [{"calibration.csv": table, **pictures}]


def _metashape() -> list[Files]:
    lens = b"<f>4</f><cx>0.1</cx><k1>-0.1</k1><k4>0.01</k4><p1>0.001</p1>"
    size = b'<resolution width="4" height="3"/>'
    numbers = " ".join(str(float(x)) for x in np.ravel(TURN)).encode()
    head = b'<document><chunk><sensors><sensor id="0" type="frame">' + size
    cameras = b'<camera sensor_id="0" label="0"><transform>' + numbers + b"</transform></camera>"
    middle = b"<calibration>" + lens + b"</calibration></sensor></sensors><cameras>"
    xml = head + middle + cameras + b"</cameras></chunk></document>"
    return [{"cameras.xml": xml, "0.png": picture(".png")}]


def _colmap(binary: bool) -> list[Files]:
    if not binary:
        return [{
            "cameras.txt": b"# cameras\n1 PINHOLE 4 3 4 4 2 1.5\n2 OPENCV 4 3 4 4 2 1.5 0 0 0 0\n",
            "images.txt": b"1 1 0 0 0 0 0 0 1 a.png\n\n2 0.9 0.1 0 0 1 0 0 2 b.png\n1 1 -1\n",
            "points3D.txt": b"1 0 0 0 9 9 9 0.1 1 1\n2 1 0 0 9 9 9 0.1\n",
        }]  # fmt: skip
    cameras = struct.pack("<QIiQQ4d", 1, 1, 1, 4, 3, 4, 4, 2, 1.5)
    image = (
        struct.pack("<I7dI", 1, 1, 0, 0, 0, 0, 0, 0, 1)
        + b"a.png\0"
        + struct.pack("<Q2dq", 1, 0, 0, -1)
    )
    points = struct.pack("<QQ3d3BdQ2I", 1, 1, 0, 0, 0, 9, 9, 9, 0.1, 1, 1, 1)
    return [
        {"cameras.bin": cameras, "images.bin": struct.pack("<Q", 1) + image, "points3D.bin": points}
    ]


def _rays() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(-0.3, 0.3, 4))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)


def _table() -> list[Files]:
    return [{"rays.npz": written("rays.npz", lambda path: np.savez(path, rays=_rays()))}]


def _paths() -> list[Files]:
    poses = [{"time": float(i), "transform_matrix": TURN} for i in range(2)]
    matrix = [{"camera_to_world": [x for row in TURN for x in row]}] * 2
    tops = (
        {"frames": poses},
        {"trajectory": {"poses": poses}},
        {"camera_path": matrix, "seconds": 2},
    )
    return [{"path.json": text(top)} for top in tops]


def _read_path(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from gaussray.capture.paths import read_path

        return read_path(folder / name)

    return read


def _samples() -> list[Files]:
    frame = {"file_path": "images/0.png", "labels": {"layers": "labels/0.exr"}}
    lines = [
        text({"version": 1, "index": i, "folder": f"takes/00000{i}", "frames": [frame]})
        for i in range(2)
    ]
    files = {
        f"takes/00000{i}/{name}": b"x"
        for i in range(2)
        for name in ("images/0.png", "labels/0.exr")
    }
    return [{"manifest.jsonl": b"\n".join([*lines, b""]), **files}]


def _pack(folder: Path) -> object:
    from gaussray.dataset.pack import pack

    return pack(folder, folder / "tars")


def _read_rays(folder: Path) -> object:
    from gaussray.io.ray_map import read_ray_map

    return read_ray_map(next(folder.glob("rays.*")))


READERS = {
    "paired": Reader(_paired, _read_capture, {"transforms.json": "json"}),
    "splits": Reader(
        _splits, _read_capture, {"transforms_train.json": "json", "transforms_test.json": "json"}
    ),
    "neural3d": Reader(_neural3d, _read_capture, {"poses_bounds.npy": "bytes"}),
    "pinf": Reader(_pinf, _read_capture, {"info.json": "json"}),
    "immersive": Reader(_immersive, _read_capture, {"models.json": "json"}),
    "technicolor": Reader(_technicolor, _read_capture, {"cameras_parameters.txt": "text"}),
    "actorshq": Reader(_actorshq, _read_capture, {"calibration.csv": "text"}),
    "metashape": Reader(_metashape, _read_capture, {"cameras.xml": "text"}),
    "colmap-binary": Reader(
        lambda: _colmap(True),
        _read_capture,
        {"cameras.bin": "bytes", "images.bin": "bytes", "points3D.bin": "bytes"},
    ),
    "colmap-text": Reader(
        lambda: _colmap(False),
        _read_capture,
        {"cameras.txt": "text", "images.txt": "text", "points3D.txt": "text"},
    ),
    "rays-npz": Reader(_table, _read_rays, {"rays.npz": "npz"}),
    "rays-exr": Reader(
        lambda: [{"rays.exr": picture(".exr", 3, "float32")}], _read_rays, {"rays.exr": "bytes"}
    ),
    "path-json": Reader(_paths, _read_path("path.json"), {"path.json": "json"}),
    "path-tum": Reader(
        lambda: [{"path.txt": b"# a\n0 0 0 0 0 0 0 1\n1 1 2 3 0 0.6 0 0.8\n"}],
        _read_path("path.txt"),
        {"path.txt": "text"},
    ),
    "manifest": Reader(_samples, _pack, {"manifest.jsonl": "json"}),
}
