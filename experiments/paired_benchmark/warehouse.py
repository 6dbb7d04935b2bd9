"""Warehouse: three spheres, or four cubes, that bounce and collide between the racks.

The hall is 8.6 m square and its toys are as large as gym balls and freight boxes, so that they
fill some pixels.
"""

import math

from mathutils import Matrix, Vector

from experiments.blender.paint import (
    CLAY,
    MOSS,
    PLUM,
    SAND,
    SEA,
    TOYS,
    WOOD,
    blotches_of,
    bricks_of,
    mosaic_of,
    stripes_of,
    wedges,
)
from experiments.blender.physics import Thrown, bake
from experiments.blender.shapes import add, ball, box, cylinder, lamp, plane, shell
from experiments.paired_benchmark.stage import FPS, FRAMES, MARGIN, Rig, Stage


SIZE = (8.6, 8.6, 3.9)
POLISH = {"shine": 0.16, "roughness": 0.15}
RIG = Rig(
    reach=(3.5, 3.5),
    heights=(0.9, 2.4),
    look_at=(0.0, 0.0, 1.0),
    fov=65,
    aperture_radius=0.2,
    focus_distance=3.5,
)

CONCRETE = ["#9b958a", "#b3ab9c", "#868178", "#c4bba9"]
STEEL = ["#4f6d8f", "#3b5575", "#6f8cab"]
CARD = ["#c9a06a", "#a97f4f", "#dbb988", "#8f6a42"]
HAZARD = ["#f0c541", "#2f2c28"]

PATCHES = mosaic_of(["#3c9a5f", "#f2d9a0", "#5b3f8c", "#e8833a"], 0.28, 1.0)
RINGS = stripes_of(["#c2386b", "#23405e", "#e9dcc0"], 0.13, (0, 0, 1))

SPHERES = [  # name, radius, paint, position, velocity, spin
    ("wedge_ball", 0.46, wedges, (-1.04, 0.27, 1.60), (0.96, -0.31, 0.93), (-3.8, 1.8, -1.0)),
    ("patch_ball", 0.42, PATCHES, (1.00, -0.20, 1.86), (-1.13, 0.33, 0.41), (2.4, 0.3, 3.2)),
    ("ring_ball", 0.38, RINGS, (0.12, 0.94, 2.24), (-0.21, -0.69, 0.09), (4.4, 1.3, -2.7)),
]

TOY = mosaic_of(TOYS, 0.24, 0.0)
STRAPS = stripes_of([*CARD, "#d33f3a"], 0.1, (1, 0, 0.4))
WAVES = mosaic_of(SEA, 0.2, 1.0)
BANDS = stripes_of(PLUM, 0.11, (1, 1, 0.3))

CUBES = [  # name, side, paint, position, velocity, spin
    ("toy_cube", 0.64, TOY, (-0.92, -0.31, 1.27), (0.64, -0.08, 0.44), (1.7, 2.4, -2.9)),
    ("strap_cube", 0.58, STRAPS, (0.77, 0.17, 1.42), (-0.59, 0.11, 0.83), (2.5, 0.8, -2.4)),
    ("wave_cube", 0.54, WAVES, (-0.43, 0.87, 1.75), (-0.13, -0.41, 0.09), (0.3, 0.5, -0.9)),
    ("band_cube", 0.50, BANDS, (0.26, -0.91, 2.03), (-0.14, 0.55, -0.17), (1.6, -2.0, 2.5)),
]


def spheres():
    """Three balls, thrown towards each other, bounce and collide."""
    thrown = [
        Thrown(
            add(name, *ball(radius), start, (0, 0, 0), pattern, smooth=True),
            "SPHERE",
            (2 * radius) ** 3,
            velocity,
            spin,
        )
        for name, radius, pattern, start, velocity, spin in SPHERES
    ]
    return stage(thrown)


def cubes():
    """Four cubes, thrown towards each other, bounce, tumble and collide."""
    thrown = [
        Thrown(
            add(name, *box((side,) * 3), start, (0, 0, 0), pattern),
            "BOX",
            side**3,
            velocity,
            spin,
            restitution=0.68,
        )
        for name, side, pattern, start, velocity, spin in CUBES
    ]
    return stage(thrown)


def stage(thrown):
    """The hall in which the bodies are thrown."""
    lights()
    hall = shell(
        SIZE,
        {
            "floor": mosaic_of(CONCRETE, 0.34, 0.35),
            "ceiling": stripes_of(STEEL + SAND[2:], 0.3, (0, 1, 0)),
            "north": bricks_of("#a9aaa2", "#7f8a8c", "#d8d2c4", 0.6, 0.28, 0.03),
            "south": bricks_of("#b5694a", "#d9a277", "#e3d3b0", 0.5, 0.2, 0.035),
            "east": stripes_of(["#57808a", "#7ba3a6", "#a9c4b8", "#40616e"], 0.16),
            "west": bricks_of("#c9b98f", "#a8895c", "#e9e2cf", 0.6, 0.28, 0.03),
        },
        **POLISH,
    )
    bake(hall, thrown, FRAMES, fps=FPS, margin=MARGIN)
    fixed = hall + markings() + racks() + goods()
    return Stage(fixed, [body.thing for body in thrown], RIG)


def markings():
    """Lanes and a loading bay painted on the floor: sheets a few millimetres above it."""
    hazard = stripes_of(HAZARD, 0.13, (1, 1, 0))
    sheets = [
        ("bay", (2.6, 2.6), (0.0, 0.0, 0.002), mosaic_of(MOSS + SEA[:2], 0.3, 0.0)),
        ("bay_north", (2.9, 0.15), (0.0, 1.375, 0.003), hazard),
        ("bay_south", (2.9, 0.15), (0.0, -1.375, 0.003), hazard),
        ("bay_east", (0.15, 2.6), (1.375, 0.0, 0.003), hazard),
        ("bay_west", (0.15, 2.6), (-1.375, 0.0, 0.003), hazard),
        ("lane_north", (8.0, 0.12), (0.0, 2.7, 0.002), blotches_of(["#f0c541", "#d9a93a"], 0.3)),
        ("lane_south", (8.0, 0.12), (0.0, -2.7, 0.002), blotches_of(["#f0c541", "#d9a93a"], 0.3)),
    ]
    return [
        plane(name, size, position, (0, 0, 0), pattern, **POLISH)
        for name, size, position, pattern in sheets
    ]


def racks():
    """A rack with its cartons on the north and another on the west wall."""
    made = []
    for wall, foot, turn in [("north", (0.3, 4.0, 0), 0.0), ("west", (-4.0, -0.3, 0), math.pi / 2)]:
        frame = Matrix.Translation(foot) @ Matrix.Rotation(turn, 4, "Z")
        made += [
            add(f"{wall}_{name}", *box(size), frame @ Vector(place), (0, 0, turn), pattern)
            for name, size, place, pattern in shelving()
        ]
    return made


def shelving():
    """Posts, shelves and cartons of a rack 4.8 m long, about the middle of its foot."""
    steel = stripes_of(["#2f6db5", "#e8833a"], 0.2, (0, 0, 1))
    shelf = stripes_of(["#d9622e", "#e8833a"], 0.25)
    paints = [
        stripes_of(CARD, 0.11, (1, 0, 1)),
        mosaic_of(CARD + SAND, 0.2, 0.0),
        mosaic_of(TOYS, 0.22, 0.0),
        stripes_of(SEA, 0.12, (0, 0, 1)),
        mosaic_of(CLAY, 0.19, 1.0),
    ]
    parts = [(f"post_{k}", (0.1, 0.44, 2.9), (1.6 * k - 2.4, 0, 1.45), steel) for k in range(4)]
    for level, height in enumerate((0.2, 1.1, 2.0)):
        parts.append((f"shelf_{level}", (4.8, 0.42, 0.07), (0, 0, height), shelf))
        for k in range(6):
            kind, bay = 3 * level + 2 * k, k // 2 - 1
            wide, tall = 0.42 + 0.08 * (kind % 3), 0.34 + 0.09 * (kind % 4)
            where = (1.6 * bay + 0.74 * (k % 2 - 0.5), 0, height + 0.036 + tall / 2)
            parts.append((f"carton_{level}{k}", (wide, 0.36, tall), where, paints[kind % 5]))
    return parts


def goods():
    """What stands along the other walls, and the posts and beams of the hall."""
    slats = stripes_of(SAND + STEEL, 0.14, (0, 0, 1))
    warning = stripes_of(HAZARD, 0.2, (1, 1, 1))
    solids = [
        ("pallet", (1.4, 0.5, 0.14), (-1.6, -3.95, 0.071), 0, stripes_of(WOOD, 0.14)),
        ("crate", (0.7, 0.46, 0.6), (-1.9, -3.95, 0.441), 0, stripes_of(WOOD, 0.15, (1, 0, 1))),
        ("parcel", (0.5, 0.4, 0.4), (-1.25, -3.95, 0.341), 0.2, mosaic_of(CARD, 0.2, 0.0)),
        ("trunk", (1.3, 0.46, 0.56), (1.9, -3.95, 0.281), 0, mosaic_of(PLUM, 0.26, 0.0)),
        ("stack", (0.46, 1.5, 0.62), (3.95, 1.6, 0.311), 0, mosaic_of(CARD + CLAY, 0.26, 0.0)),
        ("bin", (0.46, 1.0, 0.5), (3.95, -1.2, 0.251), 0, stripes_of(MOSS, 0.14, (0, 1, 1))),
        ("door", (2.2, 0.06, 2.5), (0.2, -4.26, 1.26), 0, slats),
        ("sign_south", (1.2, 0.05, 0.9), (-2.5, -4.26, 2.1), 0, mosaic_of(TOYS, 0.24, 1.0)),
        ("plan_south", (1.1, 0.05, 1.2), (2.6, -4.26, 2.0), 0, mosaic_of(SEA + SAND, 0.2, 0.0)),
        ("sign_east", (0.05, 1.5, 1.0), (4.26, -1.6, 2.0), 0, mosaic_of(CLAY + SAND, 0.24, 0.0)),
        ("flag_east", (0.05, 1.0, 1.4), (4.26, 1.5, 2.1), 0, stripes_of(TOYS[:4], 0.16, (0, 1, 1))),
    ]
    solids += [
        (f"post_{x}{y}", (0.24, 0.24, 3.9), (4.1 * x, 4.1 * y, 1.95), 0, warning)
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    solids += [
        (f"beam_{k}", (8.6, 0.2, 0.26), (0, 2.2 * k, 3.76), 0, stripes_of(CLAY, 0.35))
        for k in (-1, 0, 1)
    ]
    drums = [
        ("drum_red", (3.9, 3.2), stripes_of(["#d33f3a", "#e9e2cf"], 0.2, (0, 0, 1))),
        ("drum_blue", (3.9, -2.7), stripes_of(["#2f6db5", "#f0c541"], 0.2, (0, 0, 1))),
        ("drum_green", (3.3, -3.9), stripes_of(["#3c9a5f", "#2f2c28"], 0.2, (0, 0, 1))),
    ]
    return [
        add(name, *box(size), position, (0, 0, yaw), pattern)
        for name, size, position, yaw, pattern in solids
    ] + [
        add(name, *cylinder(0.26, 0.75), (*spot, 0.376), (0, 0, 0), pattern)
        for name, spot, pattern in drums
    ]


def lights():
    """Two wide lamps under the ceiling and one that lights it; cameras do not see them."""
    lamp("warm", 165, (-1.9, 1.3, 3.6), (0, 0, 0), (1.0, 0.93, 0.85), side=3.8)
    lamp("cool", 165, (1.9, -1.3, 3.6), (0, 0, 0), (0.86, 0.93, 1.0), side=3.8)
    lamp("bounce", 55, (0, 0, 2.9), (math.pi, 0, 0), (1.0, 0.96, 0.90), side=2.6)
