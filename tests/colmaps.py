"""COLMAP's files, written by its description of them."""

import struct

import films
from scipy.spatial.transform import Rotation

from gaussray.capture.formats.colmap_files import COLMAP_MODELS
from gaussray.dataset.images import write_image


W, H = 48, 32
PINHOLE = {1: ("PINHOLE", W, H, (60.0, 62.0, 23.0, 17.0))}
NUMBERS = {name: number for number, (name, _) in COLMAP_MODELS.items()}


def lay(folder, cameras, images, points, form="bin", numbers=None):
    """A model: cameras {number: (model, width, height, parameters)}, images (name, quat,
    translation, camera), points (place, color, length of track)."""
    folder.mkdir(parents=True, exist_ok=True)
    if form == "txt":
        _text(folder, cameras, images, points)
    else:
        _binary(folder, cameras, images, points, {**NUMBERS, **(numbers or {})})
    return folder


def pose(k):
    """A camera at 4 from the origin that nearly looks at it: quaternion (wxyz) and translation."""
    turn = Rotation.from_euler("yx", [0.3 * k, 0.1 * k])
    return tuple(turn.as_quat()[[3, 0, 1, 2]]), (0.1 * k, -0.05, 4.0)


def registered(*names, camera=1, moves=True):
    return [(name, *pose(k if moves else 0), camera) for k, name in enumerate(names)]


def model(folder, images, cameras=None, form="bin"):
    lay(folder / "sparse/0", cameras or PINHOLE, images, [((0, 0, 0), (9, 9, 9), 2)], form)
    return folder


def pictures(folder, *names, first=0):
    """Frames that can be told from each other, by these names."""
    shades = films.shades(first + len(names), W, H)[first:]
    for name, shade in zip(names, shades, strict=True):
        write_image(folder / name, shade)


def _binary(folder, cameras, images, points, numbers):
    data = struct.pack("<Q", len(cameras))
    for number, (model, width, height, values) in cameras.items():
        data += struct.pack("<IiQQ", number, numbers[model], width, height)
        data += struct.pack(f"<{len(values)}d", *values)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for k, (name, quat, translation, camera) in enumerate(images):
        data += struct.pack("<I7dI", k + 1, *quat, *translation, camera)
        # A keypoint in every picture but the last.
        seen = [(1.5, 2.5, -1)] if k < len(images) - 1 else []
        data += name.encode() + b"\0" + struct.pack("<Q", len(seen))
        for keypoint in seen:
            data += struct.pack("<ddq", *keypoint)
    (folder / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for k, (place, color, track) in enumerate(points):
        data += struct.pack("<Q3d3BdQ", k + 1, *place, *color, 0.5, track)
        data += struct.pack(f"<{2 * track}I", *range(2 * track))
    (folder / "points3D.bin").write_bytes(data)


def _text(folder, cameras, images, points):
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    for number, (model, width, height, values) in cameras.items():
        lines.append(" ".join(map(str, (number, model, width, height, *values))))
    (folder / "cameras.txt").write_text("\n".join([*lines, ""]))
    lines = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[]"]
    for k, (name, quat, translation, camera) in enumerate(images):
        lines.append(" ".join(map(str, (k + 1, *quat, *translation, camera, name))))
        lines.append("1.5 2.5 -1" if k < len(images) - 1 else "")
    (folder / "images.txt").write_text("\n".join([*lines, ""]))
    lines = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]"]
    for k, (place, color, track) in enumerate(points):
        lines.append(" ".join(map(str, (k + 1, *place, *color, 0.5, *range(2 * track)))))
    (folder / "points3D.txt").write_text("\n".join([*lines, ""]))
