"""What lens and sensor do to light, one by one, on a picture of a trained scene.

python -m experiments.sensor.show SCENE OUT.png [--camera cam13] [--time 0.4] [--size 176]
"""

import argparse
import dataclasses
import time as clock
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera, with_chromatic
from gaussray.camera.film import Film
from gaussray.camera.lens import pinhole
from gaussray.camera.sensor.noise import picture_key
from gaussray.camera.sensor.sensor import SensorOptions, apply_exposure, develop, encode
from gaussray.dataset.images import contact_sheet, srgb_levels, write_image
from gaussray.render import Renderer, RenderOptions
from gaussray.render.rig.view_files import load_views
from gaussray.scene.store import load_scene


DIM = {"exposure": -4.0, "full_well": 5000.0, "read_noise": 3.0, "gain": 16.0, "white": 1.0}
# Exaggerated, to be seen at this size.
ROWS = {
    "light": {
        "as it falls": {},
        "chromatic 1.02, 1, 0.98": {"chromatic": (1.02, 1.0, 0.98)},
        "falloff 4": {"falloff": 4.0},
        "vignetting -0.8": {"vignetting": (-0.8, 0.0, 0.0)},
    },
    "counted": {
        "exposure +1.5": {"exposure": 1.5, "white": 1.0},
        "-4 EV, gain 16, 5000 e": DIM,
        "3 bits": {"white": 1.0, "bits": 3},
        "RGGB as counted": {"bayer": "RGGB", "demosaic": "none"},
    },
    "developed": {
        "RGGB, noise, bilinear": DIM | {"bayer": "RGGB"},
        "+1.5 EV, srgb": {"exposure": 1.5, "white": 8.0},
        "+1.5 EV, filmic": {"exposure": 1.5, "white": 8.0, "tone": "filmic"},
        "linear codes": {"tone": "linear"},
    },
}


def enlarged(camera: Camera, size: int) -> Camera:
    """A pinhole camera with so many pixels across."""
    factor = size / camera.film.width
    lens = pinhole(camera.lens.focal * factor, camera.lens.center * factor)
    return dataclasses.replace(camera, film=Film(size, size), lens=lens)


def main(scene: str, out: Path, camera: str, time: float, size: int) -> None:
    """Write the sheet, and print the noise of the dim picture beside what the law says."""
    views = [view for view in load_views(scene, None) if view.camera_name == camera]
    view = min(views, key=lambda view: abs(view.time - time))
    seen_by = enlarged(view.camera, size)
    render = Renderer(load_scene(scene), options=RenderOptions(samples=4))
    lights: dict[tuple[float, ...], np.ndarray] = {}
    sheet = []
    for label, row in ROWS.items():
        pictures = []
        for name, chosen in row.items():
            options = SensorOptions(**chosen)
            if options.chromatic not in lights:
                lights[options.chromatic] = render(with_chromatic(seen_by, options.chromatic)).color
            light = jnp.asarray(lights[options.chromatic])
            values = develop(light, seen_by, picture_key(0, name), options=options)
            stored = srgb_levels(np.asarray(encode(values, options=options)), lambda x: x)
            pictures.append(captioned(stored, name))
        sheet.append((label, pictures))
    write_image(out, contact_sheet(sheet))
    print(f"{out}: {view.camera_name} at {view.time:.3f}, {size} x {size} pixels")
    report(jnp.asarray(lights[SensorOptions().chromatic]), seen_by)


def report(light: jax.Array, camera: Camera) -> None:
    """Noise of the dim picture before it is cut at white, and what a developed frame costs."""
    options = SensorOptions(**(DIM | {"white": 0.0}))
    bright = options.gain * apply_exposure(light, options.exposure)
    step = options.gain / options.full_well
    law = step**2 * (bright / step + options.read_noise**2)
    run = jax.jit(partial(develop, options=options))
    error, seconds = [], []
    for i in range(8):
        began = clock.perf_counter()
        seen = run(light, camera, picture_key(0, str(i))).block_until_ready()
        seconds.append(clock.perf_counter() - began)
        error.append(np.mean((seen - bright) ** 2))
    noise = np.sqrt(np.mean(error))
    print(f"rms noise {noise:.6f}, by the law {np.sqrt(np.mean(law)):.6f}, of 8 pictures")
    print(f"{np.median(seconds[1:]):.3f} s to develop a picture with noise")


def captioned(picture: np.ndarray, name: str) -> np.ndarray:
    """The picture under its name."""
    return contact_sheet([("", [picture])], titles=[name])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("out", type=Path)
    parser.add_argument("--camera", default="cam13")
    parser.add_argument("--time", type=float, default=0.4)
    parser.add_argument("--size", type=int, default=176)
    given = parser.parse_args()
    main(given.scene, given.out, given.camera, given.time, given.size)
