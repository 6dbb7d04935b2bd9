"""Living room: a bulldozer of bricks swings its arm; or a dog runs across on its four legs.

Toy and dog are as long as a sofa, so that they are large in pictures taken from the walls.
"""

import math

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
from experiments.blender.shapes import (
    add,
    animate,
    ball,
    box,
    cylinder,
    hung,
    joined,
    lamp,
    lathe,
    pivot,
    ring,
    shell,
)
from experiments.paired_benchmark.stage import FRAMES, MARGIN, Rig, Stage


WIDE, HIGH = 7.2, 3.0  # the room is square
# The axis of a solid: z, x or y.
UP, ALONG, ACROSS = (0, 0, 0), (0, math.pi / 2, 0), (math.pi / 2, 0, 0)

FURNITURE = [  # size, middle, degrees about z, pattern
    ("sofa", (2.6, 0.85, 0.40), (-0.5, 3.14, 0.201), 0, mosaic_of(SEA, 0.21, 0.8)),
    ("sofa_back", (2.6, 0.24, 0.50), (-0.5, 3.45, 0.652), 0, stripes_of(SEA, 0.17)),
    ("arm_west", (0.22, 0.60, 0.24), (-1.69, 3.02, 0.522), 0, stripes_of(SEA, 0.12, (0, 1, 0))),
    ("arm_east", (0.22, 0.60, 0.24), (0.69, 3.02, 0.522), 0, stripes_of(SEA, 0.12, (0, 1, 0))),
    ("cushion_1", (0.5, 0.16, 0.44), (-1.2, 3.2, 0.63), 12, mosaic_of(CLAY + TOYS, 0.13, 0.0)),
    ("cushion_2", (0.5, 0.16, 0.44), (0.2, 3.2, 0.63), -15, stripes_of(PLUM, 0.09, (1, 0, 1))),
    ("bookcase", (0.04, 2.3, 2.10), (3.575, 0.6, 1.051), 0, stripes_of(WOOD, 0.23, (0, 1, 0))),
    ("sideboard", (0.42, 1.9, 0.55), (-3.38, -0.3, 0.277), 0, mosaic_of(WOOD + SAND, 0.26, 0.0)),
    ("screen_frame", (0.06, 1.5, 0.95), (-3.56, -0.3, 1.45), 0, stripes_of(WOOD, 0.2, (0, 0, 1))),
    ("screen", (0.06, 1.3, 0.75), (-3.53, -0.3, 1.45), 0, mosaic_of(TOYS + SEA, 0.19, 1.0)),
    ("bench", (1.5, 0.45, 0.42), (1.1, -3.32, 0.211), 0, mosaic_of(CLAY + SAND, 0.19, 0.0)),
    ("curtain_1", (0.4, 0.08, 2.3), (-2.2, -3.55, 1.55), 0, stripes_of(PLUM + CLAY, 0.07)),
    ("window", (1.2, 0.05, 1.4), (-1.4, -3.57, 1.75), 0, mosaic_of(SEA + MOSS, 0.33, 0.6)),
    ("curtain_2", (0.4, 0.08, 2.3), (-0.6, -3.55, 1.55), 0, stripes_of(PLUM + CLAY, 0.07)),
    ("picture_south", (1.2, 0.06, 0.9), (1.1, -3.56, 1.7), 0, mosaic_of(TOYS, 0.23, 1.0)),
    ("picture_north", (1.7, 0.06, 0.8), (-0.5, 3.56, 1.75), 0, mosaic_of(CLAY + MOSS, 0.2, 0.7)),
    ("block_1", (0.36, 0.36, 0.36), (1.5, -1.7, 0.182), 30, mosaic_of(TOYS, 0.23, 0.0)),
    ("block_2", (0.26, 0.26, 0.26), (1.5, -1.7, 0.494), -10, mosaic_of(PLUM + SAND, 0.2, 0.0)),
    ("block_3", (0.36, 0.36, 0.36), (-1.5, 1.7, 0.182), 50, stripes_of(TOYS, 0.11, (0, 1, 1))),
]

ROUNDS = [  # mesh, middle, pattern
    ("rug", cylinder(0.9, 0.03), (1.4, 1.5, 0.016), stripes_of(CLAY + MOSS, 0.14, (1, 1, 0))),
    ("pouf", cylinder(0.30, 0.28), (-1.5, -1.7, 0.141), wedges),
    ("pole", cylinder(0.04, 1.7), (3.2, 3.2, 0.851), stripes_of(WOOD, 0.1, (0, 0, 1))),
    ("shade", lathe([(0.36, 0), (0.2, 0.4)]), (3.2, 3.2, 1.5), mosaic_of(SAND + CLAY, 0.13, 1.0)),
    ("vase", cylinder(0.22, 0.7), (-3.2, 3.2, 0.351), mosaic_of(SEA + TOYS, 0.15, 1.0)),
    ("stump", cylinder(0.26, 0.8), (3.2, -3.2, 0.401), stripes_of(PLUM, 0.1, (0, 0, 1))),
]

YELLOW, RED = ["#f2bd33", "#e0a326", "#f6cd5b"], ["#d2463c", "#b3362f", "#dd6a4c"]
BLUE, GREY = ["#4b87c4", "#79addc", "#3a6aa3"], ["#8b8a86", "#6d6c6b", "#a9a7a0"]
GREEN, WHITE = ["#3f9a5c", "#67b577"], ["#e9e2d2", "#cfc5b0"]

# Bricks are measured in studs along x and y and in layers along z.
STUD, LAYER = 0.13, 0.156
BRICKS = [  # pivot that carries it, studs, layers, middle of its foot, palette
    ("ground", (11, 4), 2, (0, 0, 0.6), GREY),
    ("ground", (10, 8), 1, (0, 0, 2.6), YELLOW),
    ("cab", (9, 6), 1, (-0.5, 0, 0), GREY + YELLOW),
    ("cab", (3, 6), 2, (-3.5, 0, 1), RED),
    ("cab", (2, 2), 1, (-3.5, 2, 3), GREEN),
    ("cab", (2, 2), 1, (-3.5, -2, 3), WHITE),
    ("cab", (4, 4), 3, (0.1, 0, 1), BLUE),
    ("cab", (5, 5), 1, (0, 0, 4), YELLOW),
    ("cab", (1, 2), 1, (0, 0, 5), RED),
    ("boom", (9, 2), 1, (4.2, 0, -0.5), YELLOW),
    ("boom", (4, 2), 1, (4.0, 0, 0.5), RED),
    ("blade", (1, 8), 3, (0.6, 0, -1.6), RED + YELLOW),
    ("blade", (3, 8), 1, (1.6, 0, -2.6), GREY),
]
SWING = {  # pivot: what carries it, where, {frame: degrees about y, degrees about z}
    "cab": ("ground", (0, 0, 3.6), {-4: (0, -34), 28: (0, 36), 56: (0, -6)}),
    "boom": ("cab", (3.6, 0, 1.7), {-4: (-34, 0), 14: (0, 0), 35: (-42, 0), 56: (-12, 0)}),
    "blade": ("boom", (8.6, 0, 0), {-4: (30, 0), 18: (-12, 0), 36: (52, 0), 56: (8, 0)}),
}

TIMES = range(-MARGIN, FRAMES + MARGIN)  # frames at which the dog is keyed
STRIDE, PACE = 18.0, 0.031  # of the dog: frames, metres a frame
HIP, SWAY, FOLD = 0.77, 0.42, 1.0  # height in metres; swing and fold of a leg in radians
GROWN = 0.86  # scales the whole dog
LEGS = {  # x and y of the hip, share of a stride by which it comes later
    "fore_left": (0.42, 0.16, 0.0),
    "fore_right": (0.42, -0.16, 0.14),
    "hind_left": (-0.42, 0.16, 0.5),
    "hind_right": (-0.42, -0.16, 0.64),
}
FUR = mosaic_of(["#f1eadb", "#3f3d45", "#dd8f4a", "#cfc4b2"], 0.19, 1.0)
SOCKS = stripes_of(["#f1eadb", "#dd8f4a", "#3f3d45"], 0.09, (0, 0, 1))


def bulldozer():
    """Its cab turns on the tracks and carries an arm that lifts, sinks and tips its blade."""
    ground = pivot("ground", (-0.35, 0, 0))
    pivots = {"ground": ground}
    for name, (carrier, place, turns) in SWING.items():
        pivots[name] = pivot(name, studs(place), pivots[carrier])
        radians = {frame: (0, math.radians(y), math.radians(z)) for frame, (y, z) in turns.items()}
        animate(pivots[name], "rotation_euler", radians)
    tread = stripes_of(GREY + ["#4b4a4c"], 0.09)
    hubs = [("hub", cylinder(0.14, 1.17), (0.28 * k, 0, 0.2), ACROSS, wedges) for k in range(-2, 3)]
    tracks = [("track", box((1.75, 0.27, 0.38)), (0, y, 0.195), UP, tread) for y in (-0.43, 0.43)]
    fixed = [hung(ground, *row) for row in tracks + hubs]
    moving = [
        hung(pivots["cab"], "turntable", cylinder(0.3, 0.05), (0, 0, 0), UP, wedges),
        hung(pivots["cab"], "exhaust", cylinder(0.06, 0.7), (-0.55, 0, 0.75), UP, SOCKS),
    ]
    for k, (part, size, layers, foot, palette) in enumerate(BRICKS):
        x, y, z = studs(foot)
        place = (x, y, z + layers * LAYER / 2)
        painted = mosaic_of(palette, 0.23, 0.0)
        made = hung(pivots[part], f"brick_{k}", brick(size, layers), place, UP, painted)
        (fixed if part == "ground" else moving).append(made)
    return Stage(room() + fixed, moving, Rig((3.05, 3.05), (1.0, 2.2), (0, 0, 0.65), 65, 0.16, 3.0))


def animal():
    """A dog gallops straight through the middle of the room."""
    dog = pivot("dog", (0, 0, 0))
    dog.scale = (GROWN,) * 3
    heading = math.radians(18)
    way, nod = {}, {}
    for frame in TIMES:
        gone = PACE * (frame - (FRAMES - 1) / 2) - 0.22
        hop = 0.06 * math.sin(2 * math.pi * frame / STRIDE) ** 2
        way[frame] = (gone * math.cos(heading), gone * math.sin(heading), GROWN * (HIP + hop))
        nod[frame] = (0, 0.09 * math.sin(2 * math.pi * frame / STRIDE), heading)
    animate(dog, "location", way)
    animate(dog, "rotation_euler", nod)
    moving = trunk(dog)
    for name, place in LEGS.items():
        moving += leg(dog, name, *place)
    return Stage(room(), moving, Rig((3.05, 3.05), (1.0, 2.2), (0, 0, 0.6), 65, 0.16, 3.0))


def trunk(dog):
    """All of the dog but its legs."""
    torso = lathe([(0, -0.62), (0.16, -0.58), (0.22, -0.3), (0.21, 0.0), (0.27, 0.4), (0, 0.66)])
    skull = lathe([(0, -0.2), (0.17, -0.15), (0.2, 0.0), (0.12, 0.16), (0.09, 0.36), (0, 0.4)])
    tail = pivot("tail", (-0.58, 0, 0.15), dog)
    wag = {frame: (0, -0.9, 0.5 * math.sin(4 * math.pi * frame / STRIDE)) for frame in TIMES}
    animate(tail, "rotation_euler", wag)
    return [
        hung(dog, "torso", torso, (0, 0, 0.08), ALONG, FUR, smooth=True),
        hung(dog, "neck", cylinder(0.13, 0.5), (0.62, 0, 0.33), (0, 0.6, 0), FUR),
        hung(dog, "collar", ring(0.14, 0.04), (0.66, 0, 0.38), (0, 0.6, 0), wedges),
        hung(dog, "skull", skull, (0.80, 0, 0.60), (0, 1.8, 0), FUR, smooth=True),
        hung(dog, "nose", ball(0.06), (1.18, 0, 0.51), UP, mosaic_of(GREY, 0.1, 1.0)),
        hung(dog, "ear_left", box((0.12, 0.05, 0.26)), (0.74, 0.16, 0.74), (0.4, 0, 0), SOCKS),
        hung(dog, "ear_right", box((0.12, 0.05, 0.26)), (0.74, -0.16, 0.74), (-0.4, 0, 0), SOCKS),
        hung(tail, "brush", cylinder(0.06, 0.5), (-0.25, 0, 0), ALONG, SOCKS),
    ]


def leg(dog, name, x, y, late):
    """Thigh, shin and paw: the hip swings, and the knee folds while the paw comes forward."""
    hip = pivot(f"{name}_hip", (x, y, 0), dog)
    knee = pivot(f"{name}_knee", (0, 0, -0.36), hip)
    swing, fold = {}, {}
    for frame in TIMES:
        phase = 2 * math.pi * (frame / STRIDE - late)
        swing[frame] = (0, -SWAY * math.cos(phase), 0)
        fold[frame] = (0, FOLD * max(0, -math.sin(phase)), 0)
    animate(hip, "rotation_euler", swing)
    animate(knee, "rotation_euler", fold)
    thigh = lathe([(0, -0.4), (0.08, -0.38), (0.13, 0.0), (0.1, 0.12), (0, 0.14)])
    return [
        hung(hip, f"{name}_thigh", thigh, (0, 0, 0), UP, FUR, smooth=True),
        hung(knee, f"{name}_shin", cylinder(0.07, 0.36), (0, 0, -0.18), UP, SOCKS),
        hung(knee, f"{name}_paw", box((0.24, 0.15, 0.09)), (0.05, 0, -0.33), UP, SOCKS),
    ]


def room():
    """What stands in the room whatever moves, and its lamps, which cameras do not see."""
    lamp("warm", 122, (-1.5, -1.2, 2.85), UP, (1.0, 0.93, 0.85), side=3.6)
    lamp("cool", 122, (1.5, 1.2, 2.85), UP, (0.86, 0.93, 1.0), side=3.6)
    lamp("bounce", 36, (0, 0, 1.9), (math.pi, 0, 0), (1.0, 0.96, 0.9), side=3.0)
    paper = {
        "floor": bricks_of("#b98d5c", "#8a5f3c", "#5f4029", 1.1, 0.22, 0.01),
        "ceiling": blotches_of(["#b9a98c", "#cbbd9f", "#d8ccb2", "#a99a80"], 0.35),
        "north": stripes_of(MOSS + SAND, 0.19),
        "south": mosaic_of(CLAY + SAND, 0.36, 0.3),
        "east": mosaic_of(PLUM + SEA, 0.4, 1.0),
        "west": bricks_of("#b5694a", "#d9a277", "#e3d3b0", 0.55, 0.22, 0.035),
    }
    around = shell((WIDE, WIDE, HIGH), paper, shine=0.16, roughness=0.14)
    solids = [
        add(name, *box(size), middle, (0, 0, math.radians(yaw)), painted)
        for name, size, middle, yaw, painted in FURNITURE
    ]
    solids += [add(name, *mesh, place, UP, painted) for name, mesh, place, painted in ROUNDS]
    return around + solids + books()


def books():
    """Four shelves in the bookcase, and a row of books on each."""
    oak, made = stripes_of(WOOD, 0.13), []
    for k, colours in enumerate((TOYS + SEA, CLAY + PLUM, MOSS + TOYS, SEA + SAND)):
        level, row = 0.1 + 0.5 * k, box((0.24, 1.9 - 0.3 * k, 0.36))
        spines = stripes_of(colours, 0.09, (0, 1, 0))
        made += [
            add(f"shelf_{k}", *box((0.36, 2.3, 0.05)), (3.38, 0.6, level), UP, oak),
            add(f"books_{k}", *row, (3.42, 0.45 + 0.1 * k, level + 0.21), UP, spines),
        ]
    return made


def studs(place):
    return place[0] * STUD, place[1] * STUD, place[2] * LAYER


def brick(size, layers):
    """A brick with its studs, a hair smaller than its place."""
    wide, deep, high = size[0] * STUD - 0.004, size[1] * STUD - 0.004, layers * LAYER - 0.004
    knob = cylinder(0.3 * STUD, 0.04, 12)
    spots = [
        (STUD * (i - (size[0] - 1) / 2), STUD * (j - (size[1] - 1) / 2), high / 2 + 0.018)
        for i in range(size[0])
        for j in range(size[1])
    ]
    return joined([(box((wide, deep, high)), (0, 0, 0)), *((knob, spot) for spot in spots)])
