"""A room filmed through every choice of `lens`, as one contact sheet.

python experiments/lenses/sheet.py [OUT.png]
"""

import os
import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np


# Pixels of a picture's side (the whole sphere is twice as wide), pictures in a row.
SIDE, ACROSS = 160, 5
# Half sides of the room in metres, Gaussians along each wall, its tiles, and its colours by axis
# and side: left and right, behind and ahead, floor and ceiling.
ROOM, DENSE, TILES = np.array([2.0, 2.0, 1.4]), 56, 8
COLORS = [(0.8, 0.25, 0.2), (0.25, 0.7, 0.3), (0.85, 0.75, 0.2), (0.25, 0.4, 0.85),
          (0.45, 0.4, 0.35), (0.75, 0.75, 0.8)]  # fmt: skip
# Balls: place, radius, colour.
BALLS = [
    ((0.0, 1.1, -0.3), 0.3, (0.9, 0.5, 0.1)),
    ((-0.9, 0.8, -0.9), 0.4, (0.5, 0.2, 0.6)),
    ((1.2, 0.0, -0.7), 0.35, (0.1, 0.6, 0.6)),
    ((-1.1, -0.6, 0.4), 0.3, (0.9, 0.9, 0.9)),
    ((0.3, -1.2, -0.4), 0.4, (0.7, 0.1, 0.2)),
]


def room():
    """Tiled walls and balls all around, as Gaussians that lie flat on them."""
    from gaussray.scene.gaussians import Gaussians
    from gaussray.scene.harmonics import constant_harmonics

    place, normal, spread, color = [], [], [], []
    step = (np.arange(DENSE) + 0.5) / DENSE * 2 - 1
    a, b = (x.ravel() for x in np.meshgrid(step, step))
    dark = (np.floor((a + 1) / 2 * TILES) + np.floor((b + 1) / 2 * TILES)) % 2
    for wall, paint in enumerate(COLORS):
        axis, side = wall // 2, 2 * (wall % 2) - 1
        flat = np.zeros((len(a), 3))
        flat[:, axis], flat[:, axis - 2], flat[:, axis - 1] = side, a, b
        place.append(flat * ROOM)
        normal.append(np.tile(np.eye(3)[axis], (len(a), 1)))
        spread.append(np.full(len(a), 0.6 * 2 * ROOM.max() / DENSE))
        color.append((1 - 0.55 * dark)[:, None] * paint)
    turn = np.arange(500) + 0.5
    height, angle = 1 - 2 * turn / 500, turn * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    sphere = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], -1)
    for middle, radius, paint in BALLS:
        place.append(np.array(middle) + radius * sphere)
        normal.append(sphere)
        spread.append(np.full(500, 0.08 * radius))
        # Lit from above.
        color.append((0.65 + 0.35 * sphere[:, 2:]) * paint)
    place, normal, spread, color = (np.concatenate(x) for x in (place, normal, spread, color))
    # The turn that takes +z to the normal; straight down, half a turn about x.
    quat = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], 0 * spread], -1)
    quat[normal[:, 2] < -0.999] = (0, 1, 0, 0)
    scale = np.stack([spread, spread, 0.05 * spread], -1)
    arrays = place, quat, scale, np.full(len(place), 0.97)
    arrays = (jnp.asarray(x, jnp.float32) for x in arrays)
    return Gaussians(*arrays, constant_harmonics(jnp.asarray(color, jnp.float32), 0))


def views():
    """A camera in the middle of the room that looks ahead (+y), turned a little."""
    from gaussray.camera.aperture import no_aperture
    from gaussray.camera.camera import Camera
    from gaussray.camera.film import Film
    from gaussray.camera.lens import pinhole
    from gaussray.camera.shutter import global_shutter
    from gaussray.camera.trajectory import Trajectory
    from gaussray.capture.capture import View
    from gaussray.geometry import quaternion

    yaw = 0.15
    right = np.array([np.cos(yaw), np.sin(yaw), 0])
    ahead = np.array([-np.sin(yaw), np.cos(yaw), 0])
    turn = quaternion(jnp.asarray(np.stack([right, [0, 0, -1.0], ahead], 1), jnp.float32))
    here = jnp.asarray([[0.1, -0.3, 0.05]], jnp.float32)
    path = Trajectory(jnp.zeros(1, jnp.float32), turn[None], here)
    for width in (SIDE, 2 * SIDE):
        lens = pinhole(jnp.full(2, 1.0 * SIDE), jnp.array([width / 2, SIDE / 2]))
        parts = lens, no_aperture(), global_shutter(), path, jnp.zeros(())
        camera = Camera(Film(width, SIDE, "box", 1.0), *parts)
        none = Path("none")
        yield View(camera, none, None, None, "camera", "test", 0.0, "pinhole", None, "srgb")


def twisted(path):
    """A table of an imaginary lens: 170 degrees, turned by a radian from the axis to the rim."""
    step = (np.arange(65) + 0.5) / 65 * 2 - 1
    x, y = np.meshgrid(step, step)
    r = np.hypot(x, y)
    theta, azimuth = np.deg2rad(85) * r, np.arctan2(y, x) + r**2
    rays = [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)]
    np.savez(path, rays=np.where((r < 1.1)[..., None], np.stack(rays, -1), 0))
    return path


def main(out):
    jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

    from gaussray.config.compose import compose_config
    from gaussray.config.options import build_options
    from gaussray.config.schema import conf_folder
    from gaussray.dataset.images import contact_sheet, write_image
    from gaussray.render import Renderer, RenderOptions
    from gaussray.render.rig.rig import LensOptions, RigOptions, frame_records
    from gaussray.scene.scene import Scene

    every = room()
    none = jax.tree.map(lambda x: x[:0], every)
    scene = Scene(every, none, None, jnp.asarray([0, 1], jnp.float32))
    render = Renderer(scene, options=RenderOptions(samples=4))
    square, wide = views()
    blocks, row, rows = [], 0, []
    with tempfile.TemporaryDirectory() as folder:
        table = twisted(Path(folder) / "rays.npz")
        for name in sorted(path.stem for path in (conf_folder() / "lens").glob("*.yaml")):
            if name == "keep":
                continue
            file = f"lens.file={table}" if name == "table" else "lens.file=''"
            chosen = compose_config("render", ["scene=x", "out=x", f"lens={name}", file]).lens
            view = wide if name == "equirectangular" else square
            lens = build_options(LensOptions, chosen)
            (record,) = frame_records([view], options=RigOptions(lens=lens), samples=4)
            frame = render(record.camera)
            title = name if name == "table" else f"{name} {lens.fov:g}"
            block = contact_sheet([("", [frame.color])], titles=[title], font=12)
            print(f"{name}: {frame.hits} hits, {np.mean(frame.alpha > 0.5):.0%} of the picture")
            span = 1 + (name == "equirectangular")
            if row + span > ACROSS:
                rows, blocks, row = [*rows, blocks], [], 0
            blocks, row = [*blocks, block], row + span
    lines = [np.concatenate(blocks, axis=1) for blocks in [*rows, blocks]]
    width = max(line.shape[1] for line in lines)
    padded = [
        np.pad(x, ((0, 0), (0, width - x.shape[1]), (0, 0)), constant_values=255) for x in lines
    ]
    write_image(out, np.concatenate(padded))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else str(Path(__file__).parent / "lenses.png"))
