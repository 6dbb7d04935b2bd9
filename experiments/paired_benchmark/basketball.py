"""Basketball court: a ball that the wind rolls, and three balls that fall, bounce and collide.

The court is a hall of 8.4 m by 7.8 m; its balls are about four times as large as real ones, so
that they fill some pixels.
"""

import math

import bpy

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
    wedges_of,
)
from experiments.blender.physics import HOLD, RATE, Thrown, bake
from experiments.blender.shapes import (
    add,
    ball,
    box,
    cylinder,
    lamp,
    lathe,
    plane,
    ring,
    shell,
)
from experiments.paired_benchmark.stage import FPS, FRAMES, MARGIN, Rig, Stage


SIZE = (8.4, 7.8, 3.8)
POLISH = {"shine": 0.14, "roughness": 0.18}
RIG = Rig(
    reach=(3.55, 3.25),
    heights=(0.9, 2.3),
    look_at=(0.0, 0.0, 0.9),
    fov=65,
    aperture_radius=0.2,
    focus_distance=3.4,
)

LEATHER = wedges_of((["#3a2018"] + ["#d9752f"] * 4 + ["#3a2018"] + ["#f0c98f"] * 4) * 3)
VOLLEY = stripes_of(["#2f6db5", "#f0c541", "#e9e2cf"], 0.15, (0.2, 0.1, 1))
PATCHES = mosaic_of(["#3c9a5f", "#f2d9a0", "#5b3f8c", "#d33f3a"], 0.26, 1.0)

RADIUS, MASS = 0.5, 1.0  # of the rolling ball
ROLLING_FRICTION = 0.55  # share of the speed lost in a second: Bullet's contacts let a ball roll on
GUST = {-3: 0.0, 6: 0.0, 12: 5.2, 26: 5.2, 32: 0.0}  # frame -> newtons

FALLING = [  # name, radius, paint, position, velocity, spin
    ("basketball", 0.44, LEATHER, (-1.14, -0.33, 1.93), (0.56, 0.41, -0.24), (2.6, 0.1, 4.3)),
    ("volleyball", 0.40, VOLLEY, (0.87, -0.20, 1.37), (-0.88, 0.17, 1.03), (0.6, -2.4, -2.6)),
    ("patch_ball", 0.36, PATCHES, (0.17, 0.92, 2.09), (-0.16, -0.76, 0.03), (3.1, 0.6, -2.1)),
]


def roll():
    """A ball rolls across the court: a side wind drives it for a second, friction slows it."""
    hall, props = court()
    start, velocity = (-1.2, 0.95, RADIUS), (0.25, -1.15, 0.0)
    rolling = add("ball", *ball(RADIUS), start, (0, 0, 0), LEATHER, smooth=True)
    spin = (-velocity[1] / RADIUS, velocity[0] / RADIUS, 0.0)
    gust = wind((-3.6, 0.4, RADIUS), GUST)
    thrown = Thrown(rolling, "SPHERE", MASS, velocity, spin, restitution=0.5, drag=ROLLING_FRICTION)
    bake(hall, [thrown], FRAMES, fps=FPS, margin=MARGIN)
    bpy.data.objects.remove(gust)
    return Stage(hall + props, [rolling], RIG._replace(look_at=(0.0, 0.1, 0.65)))


def fall():
    """Three balls, thrown towards each other, fall, bounce and collide."""
    hall, props = court()
    thrown = [
        Thrown(
            add(name, *ball(radius), start, (0, 0, 0), pattern, smooth=True),
            "SPHERE",
            (2 * radius) ** 3,
            velocity,
            spin,
        )
        for name, radius, pattern, start, velocity, spin in FALLING
    ]
    bake(hall, thrown, FRAMES, fps=FPS, margin=MARGIN)
    return Stage(hall + props, [body.thing for body in thrown], RIG)


def wind(position, newtons):
    """A wind towards +x that pushes a body with `newtons`, keyed by frame of the clip."""
    bpy.ops.object.effector_add(type="WIND", location=position, rotation=(0, math.pi / 2, 0))
    made = bpy.context.object
    made.field.flow = 0.0  # else the field brakes what moves, wind or no wind
    for frame, force in newtons.items():
        made.field.strength = RATE * force  # Blender pushes with the strength of a step
        step = HOLD + 1 + (frame + MARGIN) * RATE // FPS
        made.field.keyframe_insert("strength", frame=step)
    return made


def court():
    """The shell, which balls can meet, and all else that rests."""
    lights()
    hall = shell(
        SIZE,
        {
            "floor": bricks_of("#d3ad78", "#a97c4c", "#7a5636", 0.9, 0.17, 0.008),
            "ceiling": blotches_of(["#b9a98c", "#cbbd9f", "#a89e8e"], 0.35),
            "north": bricks_of("#b5694a", "#d9a277", "#e3d3b0", 0.52, 0.2, 0.035),
            "south": mosaic_of(SEA + SAND, 0.36, 0.0),
            "east": stripes_of(SAND + SEA[2:], 0.22, (1, 0.5, 0)),
            "west": bricks_of("#57808a", "#a9c4b8", "#e9e2cf", 0.46, 0.24, 0.03),
        },
        **POLISH,
    )
    return hall, markings() + furniture() + hoop("west", -1) + hoop("east", 1) + fan()


def markings():
    """Painted lines and fields: sheets a few millimetres above the floor."""
    white = blotches_of(["#e9e2cf", "#dcd2bb"], 0.5)
    sheets = [
        ("key_west", (1.7, 2.3), (-3.2, 0.0, 0.002), mosaic_of(SEA[:2] + SEA[3:4], 0.30, 1.0)),
        ("key_east", (1.7, 2.3), (3.2, 0.0, 0.002), mosaic_of(CLAY[:2] + CLAY[4:], 0.30, 1.0)),
        ("half_line", (0.09, 6.5), (0.0, 0.0, 0.004), white),
        ("side_north", (8.2, 0.09), (0.0, 3.3, 0.004), white),
        ("side_south", (8.2, 0.09), (0.0, -3.3, 0.004), white),
        ("key_line_west", (0.09, 2.3), (-2.35, 0.0, 0.004), white),
        ("key_line_east", (0.09, 2.3), (2.35, 0.0, 0.004), white),
    ]
    flat = [
        plane(name, size, position, (0, 0, 0), pattern, **POLISH)
        for name, size, position, pattern in sheets
    ]
    disc = lathe([(0.0, 0.0), (1.15, 0.0)])
    circle = lathe([(1.15, 0.0), (1.26, 0.0)])
    middle = (0.0, 0.0, 0.003)
    return flat + [
        add("centre", *disc, middle, (0, 0, 0), wedges_of(SEA[:2] * 5), **POLISH),
        add("centre_line", *circle, middle, (0, 0, 0), white, **POLISH),
    ]


def furniture():
    """Boxes along the walls, behind or below the cameras."""
    seats = mosaic_of(["#2f6db5", "#57a6a1", "#e9e2cf", "#2d4a63"], 0.32, 0.0)
    solids = [
        ("bleacher_low", (5.4, 0.45, 0.30), (-0.6, 3.66, 0.151), seats),
        ("bleacher_high", (5.2, 0.20, 0.62), (-0.6, 3.79, 0.311), seats),
        ("bench", (2.2, 0.36, 0.42), (-1.3, -3.66, 0.211), stripes_of(WOOD, 0.14)),
        ("table", (1.5, 0.40, 0.66), (1.6, -3.66, 0.331), mosaic_of(PLUM, 0.24, 0.0)),
        ("rack", (0.42, 1.4, 0.40), (3.95, -2.3, 0.201), stripes_of(MOSS, 0.12, (0, 1, 1))),
        ("pads_north", (1.7, 0.08, 1.3), (2.9, 3.85, 0.66), stripes_of(TOYS[:4], 0.2)),
        ("pads_east", (0.08, 2.4, 1.4), (4.15, 0, 0.71), stripes_of(CLAY, 0.2, (0, 1, 0))),
        ("pads_west", (0.08, 2.4, 1.4), (-4.15, -1.5, 0.71), stripes_of(SEA, 0.2, (0, 1, 0))),
        ("scores", (1.8, 0.06, 0.9), (0.2, -3.86, 2.2), mosaic_of(TOYS, 0.26, 0.0)),
        ("banner_a", (0.8, 0.05, 1.5), (-2.6, -3.87, 2.2), stripes_of(PLUM, 0.15, (1, 0, 1))),
        ("banner_b", (0.8, 0.05, 1.5), (2.8, -3.87, 2.1), mosaic_of(CLAY + SAND, 0.22, 1.0)),
        ("banner_c", (1.1, 0.05, 1.3), (-2.3, 3.87, 2.2), mosaic_of(MOSS + SAND, 0.24, 1.0)),
        ("banner_d", (1.1, 0.05, 1.3), (0.6, 3.87, 2.3), stripes_of(TOYS[2:], 0.14, (1, 0, -1))),
        ("banner_e", (0.05, 1.0, 1.4), (4.17, -2.4, 2.0), mosaic_of(PLUM + SEA, 0.23, 0.0)),
    ]
    solids += [
        (f"beam_{k}", (0.22, 7.8, 0.24), (2.1 * k, 0, 3.67), stripes_of(WOOD, 0.4, (0, 1, 0)))
        for k in (-1, 0, 1)
    ]
    spare = [
        add(f"spare_{k}", *ball(0.2), (3.95, y, 0.6), (k, 1.0, 0), pattern, smooth=True)
        for k, (y, pattern) in enumerate([(-2.78, LEATHER), (-2.3, VOLLEY), (-1.84, LEATHER)])
    ]
    return spare + [
        add(name, *box(size), position, (0, 0, 0), pattern)
        for name, size, position, pattern in solids
    ]


def hoop(end, side):
    """Backboard and rim at an end of the court: `side` is -1 or 1."""
    return [
        add(
            f"board_{end}",
            *box((0.06, 1.5, 0.95)),
            (side * 4.1, 0, 2.75),
            (0, 0, 0),
            mosaic_of(["#e9e2cf", "#d8ccb2", "#d33f3a", "#c4d3d8"], 0.30, 0.0),
        ),
        add(
            f"rim_{end}",
            *ring(0.26, 0.03),
            (side * 3.78, 0, 2.62),
            (0, 0, 0),
            stripes_of(["#d9622e", "#b5533c"], 0.1),
            smooth=True,
        ),
    ]


def fan():
    """The drum that blows the wind, on the west wall."""
    hub, back = (-3.98, 0.4, 0.62), math.pi / 2
    parts = [
        ("fan_drum", ring(0.5, 0.07), stripes_of(["#e8833a", "#33302c"], 0.12, (1, 1, 0))),
        ("fan_blades", cylinder(0.46, 0.1), wedges_of(["#c9cdd0", "#5d6a75", "#8f9aa3"] * 3)),
    ]
    return [
        add(name, *mesh, hub, (0, back, 0), pattern, smooth=name == "fan_drum")
        for name, mesh, pattern in parts
    ]


def lights():
    """Two wide lamps under the ceiling and one that lights it; cameras do not see them."""
    lamp("warm", 150, (-1.8, -1.2, 3.5), (0, 0, 0), (1.0, 0.93, 0.85), side=3.8)
    lamp("cool", 150, (1.8, 1.4, 3.5), (0, 0, 0), (0.86, 0.93, 1.0), side=3.8)
    lamp("bounce", 50, (0, 0, 2.7), (math.pi, 0, 0), (1.0, 0.96, 0.90), side=2.6)
