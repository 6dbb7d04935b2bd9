"""Every reader of files, with small files that it reads."""

import io
import json
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np


Files = dict[str, bytes]
TURN = [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]
FRAME = {
    "file_path": "a/0.png",
    "transform_matrix": TURN,
    "time": 0.5,
    "camera": "a",
    "split": "train",
}
LENS = {"w": 4, "h": 3, "fl_x": 4.0, "fl_y": 4.0, "cx": 2.0, "cy": 1.5}


class Reader(NamedTuple):
    """Whole files; what reads them in a folder; which of them are damaged, by their kind; words by
    which a refusal says what is wrong where no file is."""

    samples: Callable[[], list[Files]]
    read: Callable[[Path], object]
    kinds: dict[str, str]
    said: tuple[str, ...] = ()


def _text(content) -> bytes:
    return json.dumps(content).encode()


def _saved(array) -> bytes:
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def _written(name: str, write: Callable[[Path], object]) -> bytes:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


def _picture(suffix: str, channels: int = 3, kind: str = "uint8") -> bytes:
    import OpenImageIO as oiio

    def write(path):
        spec = oiio.ImageSpec(4, 3, channels, kind)
        file = oiio.ImageOutput.create(str(path))
        file.open(str(path), spec)
        file.write_image(np.arange(12 * channels).reshape(3, 4, channels).astype(kind))
        file.close()

    return _written(f"a{suffix}", write)


def _film(suffix: str, codec: str) -> bytes:
    import av

    def write(path):
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=10)
            stream.width, stream.height = 16, 16
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            for i in range(3):
                pixels = np.full((16, 16, 3), 60 * i, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, "rgb24")))
            container.mux(stream.encode())

    return _written(f"a{suffix}", write)


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
    other = _ply()[0]["p.ply"]
    return [
        {"transforms.json": _text({**LENS, **block, "frames": [FRAME]}), "p.ply": other}
        for block in blocks
    ]


def _read_capture(folder: Path) -> object:
    from gaussray.capture.formats import open_capture

    return open_capture(folder)


def _splits() -> list[Files]:
    frames = [{**FRAME, "file_path": "./a/0"}, {**FRAME, "time": 0.7}]
    top = {"camera_angle_x": 0.9, "frames": frames}
    files = {f"transforms_{name}.json": _text(top) for name in ("train", "test")}
    return [{**files, "a/0.png": _picture(".png")}]


def _neural3d() -> list[Files]:
    row = [0, 1, 0, 0, 16, -1, 0, 0, 0, 16, 0, 0, 1, 2, 20.0, 1, 9]
    return [{"poses_bounds.npy": _saved(np.array([row])), "cam00.mp4": _film(".mp4", "libx264")}]


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


def _ply(names: tuple[str, ...] = ()) -> list[Files]:
    columns = names or ("x", "y", "z", "red", "green", "blue")
    kinds = ["uchar" if x in ("red", "green", "blue") else "float" for x in columns]
    head = [f"property {kind} {name}" for kind, name in zip(kinds, columns, strict=True)]
    other = ["element face 1", "property list char int i", "property float q"]
    files = []
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        lines = ["ply", f"format {form} 1.0", *other, "element vertex 2", *head, "end_header", ""]
        order = ">" if "big" in form else "<"
        row = [200 if kind == "uchar" else 0.5 for kind in kinds]
        packed = "".join("B" if kind == "uchar" else "f" for kind in kinds)
        body = struct.pack(order + "b2if", 2, 1, 2, 0.5) + 2 * struct.pack(order + packed, *row)
        if form == "ascii":
            body = ("2 1 2 0.5\n" + 2 * (" ".join(map(str, row)) + "\n")).encode()
        files.append({"p.ply": "\n".join(lines).encode() + body})
    return files


def _gaussian_ply() -> list[Files]:
    return _ply((*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity",
                 *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))))  # fmt: skip


def _rays() -> np.ndarray:
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(-0.3, 0.3, 4))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)


def _table() -> list[Files]:
    return [{"rays.npz": _written("rays.npz", lambda path: np.savez(path, rays=_rays()))}]


def _scenes() -> list[Files]:
    import jax

    from gaussray.scene.bodies import resting
    from gaussray.scene.clip import Clip
    from gaussray.scene.deformation import initial_deformation
    from gaussray.scene.gaussians import Gaussians
    from gaussray.scene.planes import initial_planes
    from gaussray.scene.scene import Scene
    from gaussray.scene.store import save_scene

    def some(count):
        shapes = (3,), (4,), (3,), (), (4, 3)
        return Gaussians(*(jax.numpy.full((count, *shape), 0.5) for shape in shapes))

    def save(path, scene, precision):
        save_scene(path, scene, precision=precision, info={"a": 1})

    key, zero = jax.random.key(0), jax.numpy.zeros(3)
    planes = initial_planes(key, zero - 1, zero + 1, (0.0, 1.0), sides=(2,), instants=2, channels=2)
    bodies = resting(zero[None], jax.numpy.ones(1), jax.numpy.asarray([0.0, 1.0]))
    field = initial_deformation(key, planes, bodies, width=2)
    times = jax.numpy.asarray
    still = Scene(some(2), some(0), None, times([0.0, 1.0]))
    moves = Scene(some(1), some(2), field, times([1.0, 2.0]))
    cases = [(still, "full"), (moves, "full"), (moves, "compact"), (Clip((still, moves)), "full")]
    return [{"scene.npz": _written("scene.npz", lambda p, c=c: save(p, *c))} for c in cases]


def _read_scene(folder: Path) -> object:
    from gaussray.scene.store import load_scene, scene_info

    scene_info(folder)
    return load_scene(folder)


def _checkpoint() -> list[Files]:
    import sys

    sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
    from experiments.hostile.checkpoint import sample

    return [{"checkpoint.npz": _written("checkpoint.npz", sample)}]


def _read_checkpoint(folder: Path) -> object:
    from gaussray.fit.journal import Journal

    return Journal(folder, resume=True, interval=1.0).resumed()


def _model() -> list[Files]:
    import sys

    sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
    import foreign

    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        tensors = foreign.state(side=2, rows=2, width=2, channels=1, scales=(1,))
        root = foreign.write_model(Path(folder), tensors, foreign.cloud(2))
        paths = [path for path in root.rglob("*") if path.is_file()]
        return [{str(path.relative_to(root)): path.read_bytes() for path in paths}]


def _read_tensors(folder: Path) -> object:
    from gaussray.scene.pth import read_tensors

    return read_tensors(folder / "point_cloud/iteration_20/deformation.pth")


def _read_model(folder: Path) -> object:
    from gaussray.scene.gaussian_folder import read_model

    return read_model(folder)


def _paths() -> list[Files]:
    poses = [{"time": float(i), "transform_matrix": TURN} for i in range(2)]
    matrix = [{"camera_to_world": [x for row in TURN for x in row]}] * 2
    tops = (
        {"frames": poses},
        {"trajectory": {"poses": poses}},
        {"camera_path": matrix, "seconds": 2},
    )
    return [{"path.json": _text(top)} for top in tops]


def _read_path(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from gaussray.capture.paths import read_path

        return read_path(folder / name)

    return read


def _takes() -> list[Files]:
    frame = {"file_path": "images/0.png", "labels": {"layers": "labels/0.exr"}}
    lines = [
        _text({"version": 1, "index": i, "folder": f"takes/00000{i}", "frames": [frame]})
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


def _read_stored(name: str, size: tuple[int, int] = (4, 3)) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from gaussray.capture.frames import read_stored

        return read_stored(folder / name, *size)

    return read


def _read_video(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from gaussray.capture.videos import read_frames, read_video

        count = read_video(folder / name).frames
        return sum(1 for _ in read_frames(folder / name, range(min(count, 20))))

    return read


def _read_rays(folder: Path) -> object:
    from gaussray.capture.ray_map import read_ray_map

    return read_ray_map(next(folder.glob("rays.*")))


def _words(folder: Path) -> object:
    from gaussray.configuration import configuration

    words = (folder / "words").read_bytes().decode("latin-1").replace("\0", "").split("\n")
    return configuration("render", ["scene=x", "out=x", *(word for word in words if word)])


def _yaml(folder: Path) -> object:
    from gaussray.configuration import configuration
    from gaussray.production import _drawn

    words = ["scene=x", "out=x", "sample=mine", f"hydra.searchpath=[file://{folder}]"]
    return _drawn(configuration("render", words))


def _pictures(name: str, *made: tuple) -> Reader:
    kind = "png" if name == ".png" else "bytes"
    return Reader(
        lambda: [{f"a{name}": _picture(name, *how)} for how in made or ((),)],
        _read_stored(f"a{name}"),
        {f"a{name}": kind},
    )


def _videos(name: str, codec: str) -> Reader:
    file = f"a{name}"
    return Reader(lambda: [{file: _film(name, codec)}], _read_video(file), {file: "bytes"})


SAMPLE = b"""# @package _global_
sample:
  lens:
    fov:
      uniform: [90, 180]
  aperture:
    radius: {log_uniform: [0.01, 0.1]}
  fps: &a {choice: [8, 9], weights: [1, 2]}
"""
WORDS = b"lens=fisheye\nlens.fov=90\ncamera.names=[a,'b c']\nfps=${render.samples}"
CONFIG = ("configuration:", "must be", "sample.", "is no key")
READERS = {
    "paired": Reader(_paired, _read_capture, {"transforms.json": "json"}),
    "splits": Reader(
        _splits, _read_capture, {"transforms_train.json": "json", "transforms_test.json": "json"}
    ),
    "neural3d": Reader(_neural3d, _read_capture, {"poses_bounds.npy": "bytes"}),
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
    "points-ply": Reader(_ply, lambda folder: _points(folder), {"p.ply": "bytes"}),
    "gaussian-ply": Reader(_gaussian_ply, lambda folder: _gaussians(folder), {"p.ply": "bytes"}),
    "rays-npz": Reader(_table, _read_rays, {"rays.npz": "npz"}),
    "rays-exr": Reader(
        lambda: [{"rays.exr": _picture(".exr", 3, "float32")}], _read_rays, {"rays.exr": "bytes"}
    ),
    "scene": Reader(_scenes, _read_scene, {"scene.npz": "npz"}),
    "checkpoint": Reader(_checkpoint, _read_checkpoint, {"checkpoint.npz": "npz"}),
    "pth": Reader(_model, _read_tensors, {"point_cloud/iteration_20/deformation.pth": "npz"}),
    "model": Reader(_model, _read_model, {"cfg_args": "text"}),
    "path-json": Reader(_paths, _read_path("path.json"), {"path.json": "json"}),
    "path-tum": Reader(
        lambda: [{"path.txt": b"# a\n0 0 0 0 0 0 0 1\n1 1 2 3 0 0.6 0 0.8\n"}],
        _read_path("path.txt"),
        {"path.txt": "text"},
    ),
    "manifest": Reader(_takes, _pack, {"manifest.jsonl": "json"}),
    "png": _pictures(".png", (), (4,), (1,), (3, "uint16")),
    "jpeg": _pictures(".jpg", (), (1,)),
    "tiff": _pictures(".tif", (), (4, "float32"), (3, "uint16")),
    "exr": _pictures(".exr", (3, "float32"), (4, "float32"), (5, "float32")),
    "bmp": _pictures(".bmp"),
    "webp": _pictures(".webp", (), (4,)),
    "mp4-h264": _videos(".mp4", "libx264"),
    "mkv-vp9": _videos(".mkv", "libvpx-vp9"),
    "avi-mjpeg": _videos(".avi", "mjpeg"),
    "words": Reader(lambda: [{"words": WORDS}], _words, {"words": "text"}, CONFIG),
    "yaml": Reader(
        lambda: [{"sample/mine.yaml": SAMPLE}], _yaml, {"sample/mine.yaml": "text"}, CONFIG
    ),
}


def _points(folder: Path) -> object:
    from gaussray.capture.points import read_points

    return read_points(folder / "p.ply")


def _gaussians(folder: Path) -> object:
    from gaussray.scene.gaussian_ply import read_gaussians

    return read_gaussians(folder / "p.ply")
