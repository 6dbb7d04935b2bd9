"""Bathroom: a plant turns in its pot by 180 degrees; or a box opens its lid on a hinge.

Plant and box are as large as a bathtub, so that they are large in pictures taken from the walls.
"""

import math

from mathutils import Euler, Vector

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
    wedges_of,
)
from experiments.blender.shapes import (
    add,
    animate,
    ball,
    box as cuboid,
    cylinder,
    hung,
    joined,
    lamp,
    lathe,
    pivot,
    shell,
)
from experiments.paired_benchmark.stage import FRAMES, MARGIN, Rig, Stage


WIDE, HIGH = 6.4, 2.9  # the room is square
UP, ALONG = (0, 0, 0), (0, math.pi / 2, 0)  # the axis of a solid: z, or x

ENAMEL = bricks_of("#e4e0d4", "#c3d3d2", "#7fa3a8", 0.24, 0.13, 0.012)
TOWELS = [stripes_of(some, 0.09, (0, 0, 1)) for some in (CLAY, SEA, TOYS, PLUM)]

FURNITURE = [  # size, middle, degrees about z, pattern
    ("tub_front", (2.5, 0.10, 0.58), (-0.5, 2.42, 0.291), 0, mosaic_of(SEA + SAND[:1], 0.19, 0.0)),
    ("tub_back", (2.5, 0.10, 0.58), (-0.5, 3.14, 0.291), 0, ENAMEL),
    ("tub_west", (0.10, 0.62, 0.58), (-1.7, 2.78, 0.291), 0, ENAMEL),
    ("tub_east", (0.10, 0.62, 0.58), (0.7, 2.78, 0.291), 0, ENAMEL),
    ("cabinet", (0.46, 1.7, 0.76), (2.96, 0.5, 0.381), 0, mosaic_of(WOOD + SAND, 0.23, 0.0)),
    ("slab", (0.52, 1.8, 0.05), (2.93, 0.5, 0.787), 0, mosaic_of(PLUM, 0.15, 1.0)),
    ("cistern", (0.24, 0.6, 0.42), (-3.07, 0.7, 0.7), 0, ENAMEL),
    ("bench", (1.5, 0.42, 0.42), (-0.9, -2.98, 0.211), 0, stripes_of(WOOD, 0.13)),
    ("stack_1", (0.5, 0.34, 0.30), (-1.2, -2.98, 0.572), 8, TOWELS[0]),
    ("stack_2", (0.46, 0.34, 0.24), (-0.5, -2.98, 0.542), -6, TOWELS[1]),
    ("rail", (1.1, 0.06, 1.0), (1.3, -3.16, 1.3), 0, TOWELS[2]),
    ("radiator", (0.10, 1.2, 0.8), (-3.14, -1.2, 0.55), 0, stripes_of(SAND, 0.08, (0, 1, 0))),
    ("robe", (0.08, 0.6, 1.2), (3.15, -1.7, 1.5), 0, stripes_of(PLUM + CLAY, 0.12, (0, 1, 1))),
    ("picture_west", (0.05, 1.1, 0.9), (-3.17, -1.0, 1.75), 0, mosaic_of(TOYS, 0.21, 1.0)),
    ("picture_north", (0.9, 0.05, 0.7), (1.7, 3.17, 1.6), 0, mosaic_of(CLAY + SEA, 0.18, 0.0)),
    ("window", (1.0, 0.05, 0.9), (-1.2, -3.17, 1.8), 0, mosaic_of(MOSS + SEA, 0.24, 0.6)),
    ("mat", (1.3, 0.75, 0.03), (-0.4, 1.75, 0.016), 6, stripes_of(CLAY + SAND, 0.11)),
    ("scale", (0.42, 0.42, 0.08), (1.7, -1.5, 0.041), 25, mosaic_of(TOYS, 0.15, 0.0)),
]

ROUNDS = [  # mesh, middle, pattern
    ("bowl", lathe([(0.16, 0), (0.13, 0.2), (0.27, 0.4), (0.21, 0.4)]), (-2.7, 0.7, 0), ENAMEL),
    ("basin", lathe([(0.1, 0), (0.28, 0.13), (0.25, 0.13), (0, 0.05)]), (2.93, 0.5, 0.81), ENAMEL),
    ("basket", lathe([(0, 0), (0.24, 0), (0.32, 0.75), (0.28, 0.75)]), (2.75, 2.75, 0.001), wedges),
    ("stool", cylinder(0.24, 0.42), (-1.7, -1.6, 0.211), wedges_of(WOOD + SAND)),
    ("duck", ball(0.19), (1.5, 1.6, 0.19), stripes_of(["#f0c541", "#e8833a"], 0.1, (0, 0, 1))),
    ("duck_head", ball(0.11), (1.45, 1.55, 0.45), mosaic_of(["#f0c541", "#f6e27a"], 0.1, 1)),
    ("urn", lathe([(0.2, 0), (0.3, 0.5), (0.14, 0.9), (0.2, 1)]), (-2.8, -2.8, 0), TOWELS[0]),
    ("tower", cylinder(0.2, 1.1), (2.8, -2.8, 0.551), TOWELS[3]),
    ("jar", cylinder(0.2, 0.8), (-2.85, 2.85, 0.401), TOWELS[2]),
    ("soap", cylinder(0.07, 0.24), (2.95, 1.15, 0.935), TOWELS[2]),
    ("lotion", cylinder(0.06, 0.32), (2.95, -0.2, 0.975), TOWELS[1]),
    ("shampoo", cylinder(0.08, 0.22), (3.05, -0.05, 0.925), TOWELS[0]),
]

CONTENTS = [  # mesh, middle, rotation, pattern; within the box
    ("roll_1", cylinder(0.13, 0.8), (-0.25, -0.25, 0.40), ALONG, stripes_of(CLAY, 0.07, (0, 0, 1))),
    ("roll_2", cylinder(0.13, 0.8), (-0.25, 0.05, 0.42), ALONG, stripes_of(SEA, 0.07, (0, 0, 1))),
    ("roll_3", cylinder(0.12, 0.8), (-0.25, 0.32, 0.40), ALONG, stripes_of(PLUM, 0.07, (0, 0, 1))),
    ("pad", cuboid((1.3, 0.86, 0.2)), (0, 0, 0.18), UP, mosaic_of(MOSS + SAND, 0.15, 0.7)),
    ("ball_1", ball(0.17), (0.40, -0.22, 0.42), UP, wedges),
    ("ball_2", ball(0.15), (0.45, 0.20, 0.41), UP, mosaic_of(TOYS, 0.12, 1.0)),
]

LEAVES = 22
ROUND, PLANT = 180.0, (0.0, 0.0, 0.36)  # degrees in the clip; foot of the pot, on its stand

BOX, BOARD = (1.5, 1.05, 0.62), 0.07  # outer size, thickness of its boards
OPEN = {-4: 0, 4: 2, 46: 108, 54: 112}  # frame: degrees of the lid


def plant():
    """A pot plant turns at a steady pace: half a turn in the clip."""
    turning = pivot("plant", PLANT)
    rate = math.radians(ROUND) / (FRAMES - 1)
    ends = (-MARGIN, FRAMES - 1 + MARGIN)
    animate(turning, "rotation_euler", {k: (0, 0, rate * k) for k in ends}, "LINEAR")
    pot = lathe([(0, 0), (0.28, 0), (0.42, 0.5), (0.47, 0.5), (0.47, 0.6), (0.4, 0.6), (0.4, 0.53)])
    trunk = lathe([(0.10, 0.5), (0.06, 0.9), (0.05, 1.15), (0, 1.2)], 12)
    inlay = mosaic_of(WOOD + SAND, 0.14, 0.4)
    stand = add("stand", *cylinder(0.5, 0.355), (0, 0, 0.178), UP, inlay)
    moving = [
        hung(turning, "pot", pot, (0, 0, 0), UP, mosaic_of(TOYS, 0.17, 0.5)),
        hung(turning, "soil", cylinder(0.4, 0.02), (0, 0, 0.52), UP, mosaic_of(WOOD, 0.1, 1.0)),
        hung(turning, "trunk", trunk, (0, 0, 0), UP, stripes_of(WOOD, 0.07, (0, 0, 1))),
    ]
    for half, greens in enumerate((MOSS, ["#3c9a5f", "#8fc96b", "#2f6f4a", "#c9d67a"])):
        some = joined((leaf(k), (0, 0, 0.62 + 0.025 * k)) for k in range(half, LEAVES, 2))
        painted = mosaic_of(greens, 0.13, 1.0)
        moving.append(hung(turning, f"leaves_{half}", some, (0, 0, 0), UP, painted, smooth=True))
    for k, colour in enumerate((TOYS[:2], CLAY[:3], PLUM[:3], TOYS[4:])):
        turn = 1.7 * k + 0.4
        place = (0.36 * math.cos(turn), 0.36 * math.sin(turn), 0.8 + 0.16 * k)
        striped = wedges_of(colour * 2)
        moving.append(hung(turning, f"fruit_{k}", ball(0.11), place, UP, striped, smooth=True))
    rig = Rig((2.72, 2.72), (0.95, 2.1), (0.0, 0.0, 0.85), 65, 0.15, 2.75)
    return Stage([*room(), stand], moving, rig)


def box():
    """A chest of towels and balls opens its lid."""
    wide, deep, high = BOX
    ground = pivot("ground", (0, 0, 0.01))
    ground.rotation_euler = (0, 0, math.radians(20))
    sides, lining = mosaic_of(TOYS + SAND, 0.21, 0.0), stripes_of(SEA, 0.09)
    front, middle = (deep - BOARD) / 2, high / 2
    boards = [
        ("bottom", cuboid((wide - 0.02, deep - 0.02, BOARD)), (0, 0, BOARD / 2), UP, lining),
        ("front", cuboid((wide, BOARD, high)), (0, -front, middle), UP, sides),
        ("back", cuboid((wide, BOARD, high)), (0, front, middle), UP, sides),
    ]
    for end, x in (("left", (BOARD - wide) / 2), ("right", (wide - BOARD) / 2)):
        inside = cuboid((BOARD, deep - 2 * BOARD, high))
        boards.append((end, inside, (x, 0, middle), UP, stripes_of(CLAY, 0.12, (0, 1, 1))))
    hinge = pivot("hinge", (0, deep / 2, high + 0.012), ground)
    turns = {frame: (-math.radians(angle), 0, 0) for frame, angle in OPEN.items()}
    animate(hinge, "rotation_euler", turns)
    checks = mosaic_of(PLUM + TOYS[1:3], 0.19, 0.0)
    knob = stripes_of(WOOD, 0.06)
    over = -deep / 2 - 0.02
    lid = [
        ("lid", cuboid((wide + 0.06, deep + 0.04, 0.08)), (0, over, 0.045), UP, checks),
        ("lining", cuboid((wide - 0.2, deep - 0.2, 0.03)), (0, -deep / 2, -0.01), UP, lining),
        ("handle", cuboid((0.5, 0.09, 0.10)), (0, 0.1 - deep, 0.13), UP, knob),
        ("band_left", cuboid((0.12, deep + 0.06, 0.1)), (-0.5, over, 0.045), UP, TOWELS[2]),
        ("band_right", cuboid((0.12, deep + 0.06, 0.1)), (0.5, over, 0.045), UP, TOWELS[2]),
    ]
    fixed = [hung(ground, *row) for row in boards + CONTENTS]
    moving = [hung(hinge, *row) for row in lid]
    rig = Rig((2.72, 2.72), (0.95, 2.1), (0.0, 0.1, 0.65), 65, 0.15, 2.75)
    return Stage(room() + fixed, moving, rig)


def leaf(k):
    """A blade that bends down, wide in its middle; the k-th stands a golden angle from the last."""
    long, steps = 0.62 + 0.13 * math.sin(2.3 * k), 8
    corners, faces = [], []
    for step in range(steps + 1):
        way = step / steps
        rise = 0.75 * way - 0.9 * way**2
        wide = 0.13 * math.sin(math.pi * way**0.8) + 0.012
        for side in (-1, 0, 1):
            corners.append((0.05 + long * way, side * wide, long * rise + 0.04 * abs(side)))
    for step in range(steps):
        for side in (0, 1):
            a = 3 * step + side
            faces.append((a, a + 3, a + 4, a + 1))
    tilt = Euler((0, -0.55 * k / LEAVES, 2.4 * k)).to_matrix()
    return [tuple(tilt @ Vector(corner)) for corner in corners], faces


def room():
    """What stands in the room whatever moves, and its lamps, which cameras do not see."""
    lamp("warm", 82, (-1.3, -1.1, 2.75), UP, (1.0, 0.94, 0.87), side=3.4)
    lamp("cool", 82, (1.3, 1.1, 2.75), UP, (0.87, 0.94, 1.0), side=3.4)
    lamp("bounce", 22, (0, 0, 1.9), (math.pi, 0, 0), (1.0, 0.97, 0.92), side=2.8)
    tiles = {
        "floor": mosaic_of(["#b7c2bd", "#7f9f9f", "#d8cbb0", "#577a82", "#b08f6e"], 0.33, 0.0),
        "ceiling": blotches_of(["#c4bba9", "#d0c8b6", "#b3ab9c"], 0.35),
        "north": bricks_of("#57a6a1", "#bfd8c8", "#e9e2cf", 0.42, 0.21, 0.02),
        "south": mosaic_of(SEA + SAND, 0.30, 0.0),
        "east": bricks_of("#d98e5f", "#e8c9a0", "#f0e9d8", 0.30, 0.30, 0.025),
        "west": stripes_of(PLUM + SAND[:2], 0.2, (0.5, 1, 0)),
    }
    around = shell((WIDE, WIDE, HIGH), tiles, shine=0.18, roughness=0.13)
    solids = [
        add(name, *cuboid(size), middle, (0, 0, math.radians(yaw)), painted)
        for name, size, middle, yaw, painted in FURNITURE
    ]
    solids += [add(name, *mesh, place, UP, painted) for name, mesh, place, painted in ROUNDS]
    silver, glass = blotches_of(["#cfd8d8", "#bcc8c9"], 0.3), cuboid((0.04, 1.3, 0.9))
    tilt = (0, -0.17, 0)  # the mirror leans forward, else it shows a lamp
    ripples, water = mosaic_of(SEA, 0.2, 1.0), cuboid((2.3, 0.62, 0.02))
    solids += [
        add("mirror", *glass, (3.09, 0.5, 1.55), tilt, silver, shine=0.6, roughness=0.05),
        add("water", *water, (-0.5, 2.78, 0.45), UP, ripples, shine=0.3, roughness=0.1),
    ]
    return around + solids
