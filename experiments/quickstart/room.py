"""The scene: a furnished room with painted surfaces, area lights, five bodies to be thrown."""

import math
from typing import NamedTuple

import bpy

from experiments.blender.paint import (
    CLAY,
    MOSS,
    PLUM,
    SAND,
    SEA,
    TOYS,
    WOOD,
    masonry,
    mosaic_of,
    planks,
    plaster,
    stripes_of,
    wedges,
)
from experiments.blender.physics import Thrown
from experiments.blender.shapes import add, ball, box, lamp, plane


HALF = 3.0  # half the width of the square room
HEIGHT = 3.0


class Body(NamedTuple):
    """A moving object and how it is thrown: metres, metres per second, radians per second."""

    name: str
    shape: str
    size: float  # radius of a ball, side of a cube
    position: tuple
    velocity: tuple
    spin: tuple


BODIES = [
    Body("beach_ball", "ball", 0.37, (-1.45, -0.70, 1.30), (2.9, 0.5, 1.6), (2.0, 6.0, 1.0)),
    Body("patch_ball", "ball", 0.33, (1.55, 0.25, 1.80), (-2.4, 0.6, 0.2), (-5.0, -5.0, 2.0)),
    Body("ring_ball", "ball", 0.28, (0.80, 1.35, 0.70), (-0.7, -1.6, 3.6), (7.0, 1.0, 0.0)),
    Body("big_cube", "cube", 0.54, (0.10, -1.45, 1.75), (-0.7, 2.5, 0.6), (-4.0, 2.5, 3.0)),
    Body("small_cube", "cube", 0.42, (-0.95, 1.20, 2.05), (1.7, -2.0, -1.4), (3.0, 5.0, -4.0)),
]


def build():
    """Fill an empty file with the room; return its fixed and its moving objects."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = None
    fixed = shell() + furniture()
    lights()
    return fixed, [moving(body) for body in BODIES]


def shell():
    """Floor, ceiling and four walls: planes whose normals point into the room."""
    wide, high, up = 2 * HALF, HEIGHT, HEIGHT / 2
    right = math.pi / 2
    return [
        plane("floor", (wide, wide), (0, 0, 0), (0, 0, 0), planks),
        plane("ceiling", (wide, wide), (0, 0, HEIGHT), (math.pi, 0, 0), plaster),
        plane("north", (wide, high), (0, HALF, up), (right, 0, 0), mosaic_of(SEA, 0.55, 0.6)),
        plane("south", (wide, high), (0, -HALF, up), (right, 0, math.pi), stripes_of(CLAY, 0.34)),
        plane("east", (wide, high), (HALF, 0, up), (right, 0, -right), masonry),
        plane("west", (wide, high), (-HALF, 0, up), (right, 0, right), mosaic_of(PLUM, 0.75, 1.0)),
    ]


def furniture():
    """Boxes that stay: none hides the middle of the room from a camera."""
    solids = [
        ("rug", (3.6, 3.0, 0.03), (0, 0, 0.016), 0.25, stripes_of(MOSS + SAND, 0.30, (1, 0.6, 0))),
        ("chest", (1.5, 0.5, 0.55), (1.2, 2.72, 0.276), 0, mosaic_of(CLAY, 0.30, 0.0)),
        ("bench", (0.5, 1.7, 0.45), (-2.72, 0.9, 0.226), 0, stripes_of(WOOD, 0.16, (0, 1, 0))),
        ("cabinet", (0.8, 0.5, 0.60), (-1.3, -2.72, 0.301), 0, mosaic_of(SEA, 0.26, 0.0)),
        ("crate", (0.6, 0.6, 0.60), (2.3, -1.9, 0.301), 0.5, mosaic_of(SAND + WOOD, 0.24, 0.0)),
        ("carton", (0.45, 0.45, 0.40), (-2.1, -1.7, 0.201), -0.4, stripes_of(MOSS, 0.13)),
        ("picture_north", (1.4, 0.06, 0.9), (-1.3, 2.96, 1.75), 0, mosaic_of(TOYS, 0.30, 1.0)),
        ("picture_south", (1.1, 0.06, 1.1), (1.1, -2.96, 1.75), 0, mosaic_of(PLUM, 0.32, 0.0)),
        ("picture_east", (0.06, 1.3, 0.9), (2.96, 0.7, 1.80), 0, stripes_of(SEA, 0.2, (0, 1, 1))),
        ("picture_west", (0.06, 1.0, 1.2), (-2.96, -1, 1.65), 0, mosaic_of(SAND + CLAY, 0.28, 1)),
    ]
    timber = stripes_of(WOOD, 0.40, (0, 1, 0))
    beams = [
        (f"beam_{k}", (0.24, 2 * HALF, 0.2), (1.8 * k, 0, 2.899), 0, timber) for k in (-1, 0, 1)
    ]
    return [
        add(name, *box(size), position, (0, 0, yaw), pattern)
        for name, size, position, yaw, pattern in solids + beams
    ]


def lights():
    """Two large lamps under the ceiling and a weak one that lights it; cameras do not see them."""
    lamp("warm", 76, (-1.3, -0.9, 2.75), (0, 0, 0), (1.0, 0.93, 0.85))
    lamp("cool", 72, (1.3, 1.2, 2.75), (0, 0, 0), (0.84, 0.92, 1.0))
    lamp("bounce", 24, (0, 0, 2.2), (math.pi, 0, 0), (1.0, 0.96, 0.90))


def moving(body):
    patterns = {
        "beach_ball": wedges,
        "patch_ball": mosaic_of(["#3c9a5f", "#f0c541", "#5b3f8c", "#e9e2cf"], 0.34, 1.0),
        "ring_ball": stripes_of(["#e8833a", "#23405e", "#e9dcc0"], 0.15, (0, 0, 1)),
        "big_cube": mosaic_of(TOYS, 0.33, 0.0),
        "small_cube": mosaic_of(["#c2386b", "#58b7c9", "#f2d9a0", "#2a2f4f"], 0.25, 0.0),
    }
    mesh = ball(body.size) if body.shape == "ball" else box((body.size,) * 3)
    made = add(body.name, *mesh, body.position, (0, 0, 0), patterns[body.name])
    made.data.polygons.foreach_set("use_smooth", [body.shape == "ball"] * len(made.data.polygons))
    return made


def thrown(thing, body):
    """The object and how it is thrown."""
    shape = "SPHERE" if body.shape == "ball" else "BOX"
    return Thrown(thing, shape, body.size**3, body.velocity, body.spin)
