"""What Blender is asked to photograph: every lens, aperture and shutter, as plain data."""

import dataclasses
import math
from typing import Any, NamedTuple

from experiments.paired_benchmark.plan import EFFECTS, PRESETS, plan
from experiments.paired_benchmark.stage import FRAMES, Rig


CLIP = FRAMES - 1  # frames in one unit of the captures' time
SPEED = 0.5  # metres that the box moves in a frame

# Millimetres and Blender's sign: theta = -(k0 + k1 r + .. + k4 r^4).
WIDE = (0.0, -0.0745, -1.5e-4, -2.5e-5, 2e-7)
BEYOND = (0.0, -0.14, 0.0, 0.0, 0.0)
STRONG = (-0.01, -0.05, -8e-4, 3e-5, -1.2e-6)
MIRRORED = (0.0, 0.05, 0.0, 1e-5, 0.0)

# Held-out cameras of the benchmark, in a box of this instrument's size.
RIG = Rig(
    reach=(1.5, 1.0),
    heights=(0.8, -0.3),
    look_at=(0.1, 0.2, 0.0),
    fov=65.0,
    aperture_radius=0.2,
    focus_distance=3.4,
)

# Cases in which Blender's opening is not ours, and why.
DIFFERS = {
    "fisheye 5 blades ratio 1.6": (
        "under a fisheye Blender turns the opening with the pixel's azimuth, its x axis towards "
        "the optical axis; ours keeps its orientation"
    )
}


class Case(NamedTuple):
    """One picture: Blender's settings, or a document of the paired benchmark.

    `settings` are Blender's own property names under `camera`, `render` and `cycles`; `document`
    lists one frame, and the benchmark's own code tells it to Blender. Cycles' first sample of a
    pixel passes through its centre; `through_filter` takes the second.
    """

    name: str
    resolution: tuple[int, int]
    settings: dict[str, Any] = {}
    frame: float = 7.0
    through_filter: bool = False
    moving: bool = False
    document: dict[str, Any] | None = None


def cases(size):
    """All cases; `size` is the shorter side of most pictures, in pixels: even and at least 16.

    (In the middle pixel of an odd size Blender's opening has no orientation under a fisheye.)
    """
    if size < 16 or size % 2:
        raise ValueError(f"size must be even and at least 16, got {size}.")
    square, wide, tall = (size, size), (size * 3 // 2, size), (size, size * 3 // 2)
    return [
        *pinholes(square, wide, tall),
        *fisheyes(square, wide, tall),
        *apertures(square, wide, tall),
        *shutters(square, wide, tall),
        *films(square),
        *together(square, wide),
        *benchmark(size),
    ]


def pinholes(square, wide, tall):
    """Each fit of the sensor, odd sizes, a shifted centre."""
    odd = (square[0] + 1, square[1] - 3)
    return [
        Case("pinhole square", square),
        Case("pinhole landscape", wide, lens(28)),
        Case("pinhole portrait", tall, lens(35)),
        Case("pinhole odd size", odd, lens(20)),
        Case("pinhole landscape VERTICAL", wide, lens(40, "VERTICAL")),
        Case("pinhole portrait HORIZONTAL", tall, lens(18, "HORIZONTAL")),
        Case("pinhole shifted", square, lens(30) | shift(0.31, -0.17)),
        Case("pinhole shifted landscape", wide, lens(30) | shift(-0.12, 0.4)),
        Case("pinhole shifted portrait VERTICAL", tall, lens(30, "VERTICAL") | shift(0.2, 0.1)),
    ]


def fisheyes(square, wide, tall):
    """Half angles of 20 to 145 degrees, each fit of the sensor; the rim is in most pictures."""
    tele = (0.0, -0.01999, 0.0, 0.0, 0.0)
    return [
        Case("fisheye narrow", square, polynomial(tele, math.pi)),
        Case("fisheye 166 degrees", square, polynomial(WIDE, 2.9)),
        Case("fisheye 166 degrees landscape", wide, polynomial(WIDE, 2.9)),
        Case("fisheye 166 degrees portrait", tall, polynomial(WIDE, 2.9)),
        Case("fisheye landscape VERTICAL", wide, polynomial(WIDE, 2.9, "VERTICAL")),
        Case("fisheye portrait HORIZONTAL", tall, polynomial(WIDE, 2.9, "HORIZONTAL")),
        Case("fisheye shifted", wide, polynomial(WIDE, 2.9) | shift(0.11, -0.07)),
        Case("fisheye strong k", square, polynomial(STRONG, 3.0)),
        Case("fisheye mirrored", square, polynomial(MIRRORED, 2.0)),
        Case("fisheye 252 degrees", square, polynomial(BEYOND, math.radians(252))),
        Case("fisheye 290 degrees", square, polynomial(BEYOND, math.radians(290))),
        Case("fisheye equidistant 180 degrees", square, equidistant(math.pi)),
        Case("fisheye equidistant 220 degrees", square, equidistant(math.radians(220))),
    ]


def apertures(square, wide, tall):
    """Round and polygonal openings, squeezed ones, near and far focus, plane and sphere."""
    squeezed = opening(1.5, blades=5, rotation=0.4, ratio=1.6)
    fish = polynomial(WIDE, 2.9)
    return [
        Case("disc near focus", square, lens(35) | opening(0.7)),
        Case("disc far focus", square, lens(50) | opening(60.0, fstop=1.4)),
        Case("disc shifted portrait", tall, lens(24) | shift(0.2, -0.1) | opening(1.5)),
        Case("3 blades", square, lens(35) | opening(1.5, blades=3, rotation=0.3)),
        Case("5 blades", wide, lens(35) | opening(1.5, blades=5, rotation=-0.7)),
        Case("6 blades", square, lens(35) | opening(4.5, blades=6, rotation=0.2)),
        Case("ratio 2", square, lens(35) | opening(1.5, ratio=2.0)),
        Case("ratio 0.5", square, lens(35) | opening(1.5, ratio=0.5)),
        Case("5 blades ratio 1.6", square, lens(35) | squeezed),
        Case("fisheye disc", square, fish | opening(1.5)),
        Case("fisheye 252 degrees disc", square, polynomial(BEYOND, 4.4) | opening(0.8)),
        Case("fisheye 5 blades ratio 1.6", square, fish | squeezed),
    ]


def shutters(square, wide, tall):
    """Readouts, positions, heights and sub-frames; with exposure, and nothing but exposure."""
    return [
        Case("rolling 0.5 START", square, rolling(0.5, "START")),
        Case("rolling 0.5 CENTER", wide, rolling(0.5, "CENTER")),
        Case("rolling 1 END", tall, rolling(1.0, "END")),
        Case("rolling 1 odd rows sub-frame", (32, square[1] + 37), rolling(1.0), frame=7.3),
        Case("rolling 2 START sub-frame", square, rolling(2.0, "START"), frame=6.71),
        Case("rolling 4 CENTER", square, rolling(4.0)),
        Case("rolling 4 END", wide, rolling(4.0, "END")),
        Case("rolling exposure 0.1", square, rolling(1.0, duration=0.1)),
        Case("rolling exposure 0.5 START", square, rolling(2.0, "START", duration=0.5)),
        Case("rolling exposure 0.9 END", square, rolling(1.0, "END", duration=0.9)),
        Case("motion blur START", square, exposed(0.5, "START")),
        Case("motion blur CENTER", square, exposed(1.0)),
        Case("motion blur END sub-frame", wide, exposed(2.0, "END"), frame=7.5),
    ]


def films(square):
    """Blender's pixel filters at their default widths."""
    widths = {"BLACKMAN_HARRIS": 1.5, "GAUSSIAN": 1.5, "BOX": 1.5}
    return [
        Case(f"filter {kind}", square, lens(35) | pixel_filter(kind, width), through_filter=True)
        for kind, width in widths.items()
    ]


def together(square, wide):
    """Effects on top of one another, up to all of them before a moving camera."""
    fish = polynomial(WIDE, 2.9)
    default = pixel_filter("BLACKMAN_HARRIS", 1.5)
    everything = fish | opening(1.5) | rolling(2.0, "START") | default
    return [
        Case("fisheye rolling", square, fish | rolling(2.0)),
        Case("disc rolling", wide, lens(35) | opening(1.5) | rolling(1.0)),
        Case("6 blades rolling exposure", square, blurred_hexagon()),
        Case("rolling through the filter", square, rolling(1.0) | default, through_filter=True),
        Case("moving camera rolling", square, rolling(2.0), moving=True),
        Case("moving camera motion blur", square, exposed(1.0), moving=True),
        Case("all at once", wide, everything, frame=7.4, through_filter=True, moving=True),
    ]


def blurred_hexagon():
    return lens(35) | opening(1.5, blades=6, rotation=0.2) | rolling(1.0, duration=0.3)


def benchmark(size):
    """A picture of each effect as the benchmark plans it, and all its effects at once."""
    preset = dataclasses.replace(PRESETS["tiny"], size=size)
    _, files = plan(preset, RIG, EFFECTS, {}, seed=0)
    planned = {
        document.get("effect", "pinhole").replace("_", " "): one_frame(document)
        for document in files.values()
    }
    everything = {key: value for document in planned.values() for key, value in document.items()}
    # Under a fisheye what is in focus is a sphere.
    everything["aperture"] = everything["aperture"] | {"focus": "sphere"}
    return [
        Case(f"benchmark {name}", (size, size), frame=time_of(document) * CLIP, document=document)
        for name, document in (planned | {"everything": everything}).items()
    ]


def one_frame(document):
    """A document with the middle one of its held-out frames."""
    held = [frame for frame in document["frames"] if frame["split"] == "test"]
    return document | {"frames": [held[len(held) // 2]]}


def time_of(document):
    return document["frames"][0]["time"]


def lens(millimetres, fit="AUTO"):
    return {"camera.lens": millimetres, "camera.sensor_fit": fit, "camera.sensor_height": 27.0}


def shift(x, y):
    return {"camera.shift_x": x, "camera.shift_y": y}


def polynomial(k, fov, fit="AUTO"):
    return {
        "camera.type": "PANO",
        "camera.panorama_type": "FISHEYE_LENS_POLYNOMIAL",
        "camera.sensor_fit": fit,
        "camera.sensor_height": 27.0,
        "camera.fisheye_fov": fov,
        **{f"camera.fisheye_polynomial_k{n}": value for n, value in enumerate(k)},
    }


def equidistant(fov):
    return {
        "camera.type": "PANO",
        "camera.panorama_type": "FISHEYE_EQUIDISTANT",
        "camera.fisheye_fov": fov,
    }


def opening(focus, fstop=0.2, blades=0, rotation=0.0, ratio=1.0):
    """Thin lens of radius lens / (2 fstop)."""
    return {
        "camera.dof.use_dof": True,
        "camera.dof.focus_distance": focus,
        "camera.dof.aperture_fstop": fstop,
        "camera.dof.aperture_blades": blades,
        "camera.dof.aperture_rotation": rotation,
        "camera.dof.aperture_ratio": ratio,
    }


def exposed(frames, position="CENTER"):
    return {
        "render.use_motion_blur": True,
        "render.motion_blur_shutter": frames,
        "render.motion_blur_position": position,
    }


def rolling(frames, position="CENTER", duration=0.0):
    """`duration` is the share of `frames` for which each row is exposed."""
    return exposed(frames, position) | {
        "cycles.rolling_shutter_type": "TOP",
        "cycles.rolling_shutter_duration": duration,
    }


def pixel_filter(kind, width):
    return {"cycles.pixel_filter_type": kind, "cycles.filter_width": width}
