"""A kitchen: a table cloth flaps, an inflatable man sways, a figure bends and reaches, a pudding
wobbles, a cupboard opens, a sign changes."""

import math

import numpy as np

from experiments.blender.paint import (
    CLAY,
    MOSS,
    PLUM,
    SAND,
    SEA,
    TOYS,
    WOOD,
    blotches_of,
    mosaic_of,
    stripes_of,
    wedges,
)
from experiments.blender.shapes import add, animate, ball, box, cylinder, hung, lathe, pivot, shell
from experiments.blender.soft import soft
from experiments.captures.scenes.changing import screen
from experiments.captures.scenes.fabric import SECONDS, spread
from experiments.captures.scenes.figure import Clothes, Pose, figure
from experiments.captures.scenes.furnish import GREY, UP, WHITE, framed, lit, rounds, solids, worn
from experiments.captures.scenes.inflatable import inflatable
from experiments.captures.scenes.stage import MovingScene, room_rig


TABLE, TABLE_HIGH = (1.0, 0.75), 0.74
SWAYING = (-1.15, 0.95)


def scene():
    """Everything in the kitchen."""
    clothes = Clothes(
        shirt=mosaic_of(["#e9e2cf", "#c9714b", "#e8c9a0"], 0.09, 0.3),
        trousers=stripes_of(["#3f5636", "#56713f", "#34482c"], 0.06, (0, 0, 1)),
        skin=blotches_of(["#e3b798", "#d9a986", "#ecc5a8"], 0.2),
        hair=blotches_of(["#d8b06a", "#c49a54", "#e4c384"], 0.05),
        shoes=stripes_of(["#1d2a3d", "#34507a"], 0.05, (0, 0, 1)),
    )
    check = mosaic_of(["#c23b3b", "#e9e2cf", "#d98e5f", "#e9e2cf"], 0.13, 0.0)
    door, cupboard = opening_cupboard()
    softs = [
        spread("cloth", TABLE, (1.35, 1.35), TABLE_HIGH + 0.04, 0.3, check),
        *inflatable(SWAYING),
        *figure("cook", bend_and_reach, clothes),
        pudding((*TABLE, TABLE_HIGH + 0.05)),
        screen(
            "sign",
            (1.0, 0.7),
            (0.3, -3.42, 1.75),
            (math.pi / 2, 0, math.pi),
            mosaic_of(TOYS + WHITE[:1], 0.22, 0.6),
            shown=0.4,
            pan=0.3,
        ),
    ]
    props = [
        add(
            "table_top",
            *box((0.95, 0.95, 0.05)),
            (*TABLE, TABLE_HIGH),
            (0, 0, 0.3),
            stripes_of(WOOD, 0.15),
        ),
        add(
            "table_leg",
            *box((0.2, 0.2, TABLE_HIGH)),
            (*TABLE, TABLE_HIGH / 2),
            (0, 0, 0.3),
            stripes_of(WOOD, 0.1),
        ),
        add(
            "blower",
            *cylinder(0.22, 0.26),
            (*SWAYING, 0.131),
            UP,
            stripes_of(["#2f6db5", "#f0c541"], 0.1, (0, 0, 1)),
        ),
    ]
    return MovingScene(
        [*kitchen(), *props, *cupboard], softs, door, room_rig(3.0, (0.0, 0.1, 0.95))
    )


def bend_and_reach(time):
    """Down to the floor and up to the ceiling, stepping aside."""
    t = SECONDS * time
    low = 0.5 - 0.5 * math.cos(2 * math.pi * 0.75 * t)
    step = math.sin(2 * math.pi * 1.5 * t)
    return Pose(
        place=(-0.1 + 0.55 * time, -0.85 + 0.08 * step),
        heading=0.9 + 0.8 * math.sin(2.4 * t),
        hip=(0.25 + 0.95 * low + 0.15 * step, 0.25 + 0.95 * low - 0.15 * step),
        knee=(0.3 + 1.3 * low, 0.3 + 1.3 * low),
        shoulder=(0.9 * low + 2.7 * (1 - low), 1.1 * low - 0.2 * (1 - low)),
        lift=(0.15, 0.2 + 1.5 * (1 - low)),
        elbow=(0.2 + 0.3 * low, 0.3),
        wave=(0.0, 0.5 * math.sin(2 * math.pi * 1.7 * t)),
        twist=0.3 * math.sin(2 * math.pi * 0.8 * t),
        lean=0.1 + 0.75 * low,
    )


def pudding(foot):
    """A pudding that wobbles on the table."""
    corners, faces = lathe(
        [(0, 0), (0.26, 0), (0.25, 0.08), (0.22, 0.18), (0.16, 0.27), (0.09, 0.31), (0, 0.32)], 40
    )
    rest = np.array(corners)

    def shape(time):
        t = SECONDS * time
        high = rest[:, 2:] / 0.32
        stretch = 1 + 0.22 * math.sin(2 * math.pi * 1.9 * t)
        lean = np.array([math.sin(2 * math.pi * 1.3 * t), math.cos(2 * math.pi * 1.6 * t)])
        flat = rest[:, :2] / math.sqrt(stretch) + 0.16 * lean * high**1.6
        return np.concatenate([flat, stretch * rest[:, 2:]], axis=1) + foot

    return soft(
        "pudding", corners, faces, shape, mosaic_of([PLUM[0], PLUM[1], "#e9c7d3"], 0.08, 1.0)
    )


def opening_cupboard():
    """A cupboard on the floor whose two doors open on jars: doors, and all that rests."""
    x, y, wide, deep, high = 1.55, -1.3, 0.9, 0.4, 0.8
    way = pivot("cupboard", (x, y, 0.0))
    way.rotation_euler = (0, 0, math.radians(-35))
    paint = stripes_of([SEA[1], SEA[2], SEA[0]], 0.15)
    sides = [
        ("back", (wide, 0.03, high), (0, -deep / 2, high / 2 + 0.002)),
        ("left", (0.03, deep, high), (-wide / 2, 0, high / 2 + 0.002)),
        ("right", (0.03, deep, high), (wide / 2, 0, high / 2 + 0.002)),
        ("top", (wide + 0.06, deep + 0.06, 0.04), (0, 0, high + 0.02)),
        ("shelf", (wide, deep - 0.04, 0.03), (0, 0, high / 2)),
    ]
    fixed = [hung(way, f"cupboard_{n}", box(s), p, UP, paint) for n, s, p in sides]
    jars = [
        (-0.28, 0.0, CLAY),
        (0.0, 0.42, TOYS),
        (0.26, 0.0, MOSS),
        (-0.2, 0.42, PLUM),
        (0.22, 0.42, SAND),
    ]
    fixed += [
        hung(
            way, f"jar_{k}", cylinder(0.09, 0.26), (a, -0.02, b + 0.15), UP, mosaic_of(p, 0.07, 1.0)
        )
        for k, (a, b, p) in enumerate(jars)
    ]
    doors = []
    for sign in (-1, 1):
        hinge = pivot(f"hinge_{sign}", (sign * wide / 2, deep / 2 + 0.015, 0), way)
        turns = {
            0: (0, 0, 0),
            8: (0, 0, -sign * 0.1),
            26: (0, 0, -sign * 2.1),
            40: (0, 0, -sign * 1.7),
            49: (0, 0, -sign * 0.9),
        }
        animate(hinge, "rotation_euler", turns)
        place = (-sign * wide / 4, 0, high / 2 + 0.01)
        doors.append(
            hung(
                hinge,
                f"door_{sign}",
                box((wide / 2 - 0.01, 0.025, high - 0.02)),
                place,
                UP,
                mosaic_of(WOOD + SAND[:1], 0.11, 0.0),
            )
        )
    return doors, fixed


def kitchen():
    """All that rests in the room."""
    lit(7.0, 7.0, 2.9, 116)
    walls = shell(
        (7.0, 7.0, 2.9),
        {
            "floor": mosaic_of(["#cfc6b4", "#8d8577", "#c3b9a6", "#a39a8a"], 0.45, 0.0),
            "ceiling": blotches_of(WHITE + ["#d8d2c4"], 0.6),
            "north": mosaic_of(["#a9c4b8", "#bfd8c8", "#98b5a8", "#d4e2d8"], 0.2, 0.0),
            "south": blotches_of(["#dcc9a0", "#d2bd91", "#e5d5b2"], 0.5),
            "east": blotches_of(["#a3b0a0", "#96a493", "#b1bdae"], 0.5),
            "west": stripes_of(["#d9a277", "#cf9468", "#e2b48d"], 0.26, (0, 1, 0)),
        },
        shine=0.16,
        roughness=0.18,
    )
    table = [
        ("counter", (3.6, 0.6, 0.06), (-0.8, 3.2, 0.9), 0, blotches_of(GREY, 0.14)),
        ("units", (3.6, 0.55, 0.86), (-0.8, 3.2, 0.431), 0, stripes_of([*SEA[:2], SEA[4]], 0.45)),
        (
            "hob",
            (0.6, 0.5, 0.03),
            (-1.4, 3.18, 0.95),
            0,
            mosaic_of(["#2f2c28", "#4b4a4c"], 0.16, 0.0),
        ),
        ("upper", (2.2, 0.35, 0.6), (-1.2, 3.3, 1.9), 0, stripes_of([*SEA[:2], SEA[4]], 0.55)),
        (
            "fridge",
            (0.7, 0.7, 1.8),
            (1.6, 3.1, 0.901),
            0,
            stripes_of(WHITE + GREY[:1], 0.45, (0, 0, 1)),
        ),
        ("bench", (0.45, 2.0, 0.42), (-3.2, -0.4, 0.211), 0, stripes_of(WOOD, 0.14)),
        ("cushion", (0.4, 0.6, 0.1), (-3.2, 0.1, 0.47), 5, mosaic_of(CLAY, 0.1, 1.0)),
        (
            "sign_frame",
            (1.15, 0.06, 0.85),
            (0.3, -3.46, 1.75),
            0,
            stripes_of(["#2f2c28", "#3a3632"], 0.2),
        ),
        ("sideboard", (1.6, 0.45, 0.85), (0.4, -3.2, 0.426), 0, mosaic_of(WOOD, 0.24, 0.0)),
        ("window", (0.06, 1.6, 1.2), (3.46, -0.6, 1.7), 0, mosaic_of(SEA[1:3] + WHITE, 0.4, 0.0)),
        ("bin", (0.4, 0.4, 0.6), (3.2, 1.9, 0.301), 10, stripes_of(CLAY, 0.1, (0, 0, 1))),
        ("crate", (0.6, 0.4, 0.3), (-2.9, -2.9, 0.151), 35, stripes_of(WOOD, 0.08, (0, 0, 1))),
    ]
    round_things = [
        ("pan", cylinder(0.15, 0.12), (-1.5, 3.15, 1.02), stripes_of(GREY, 0.04, (0, 0, 1))),
        ("bowl", lathe([(0, 0), (0.1, 0), (0.2, 0.14), (0, 0.1)]), (0.3, 3.15, 0.935), wedges),
        ("melon", ball(0.16), (-0.3, 3.15, 1.09), stripes_of(MOSS, 0.05)),
        ("plant", ball(0.36), (3.0, 3.0, 0.85), mosaic_of(MOSS, 0.07, 1.0)),
        ("pot", cylinder(0.2, 0.5), (3.0, 3.0, 0.251), mosaic_of(CLAY, 0.11, 0.4)),
        (
            "urn",
            lathe([(0, 0), (0.18, 0), (0.26, 0.3), (0.1, 0.6), (0, 0.6)]),
            (2.9, -2.9, 0.001),
            mosaic_of(SEA, 0.12, 1.0),
        ),
    ]
    pictures = framed("print", (0.9, 0.7), (-3.45, -0.4, 1.7), 90, mosaic_of(TOYS, 0.13, 1.0))
    pictures += framed(
        "calendar", (0.6, 0.8), (3.45, 1.6, 1.6), -90, stripes_of(WHITE + CLAY[:1], 0.06, (0, 0, 1))
    )
    pictures += framed("photo", (0.9, 0.6), (-1.6, -3.45, 1.7), 180, blotches_of(SEA + SAND, 0.16))
    return worn(walls) + solids(table) + rounds(round_things) + pictures
