"""A gallery: a figure dances, washing blows on a line, drops merge and part, a car comes out of its
garage."""

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
    bricks_of,
    mosaic_of,
    stripes_of,
    wedges,
)
from experiments.blender.shapes import add, animate, ball, box, cylinder, hung, pivot, shell
from experiments.captures.scenes.fabric import SECONDS, blob, curtain
from experiments.captures.scenes.figure import Clothes, Pose, figure
from experiments.captures.scenes.furnish import (
    GREY,
    NAVY,
    UP,
    WHITE,
    framed,
    lit,
    rounds,
    solids,
    worn,
)
from experiments.captures.scenes.stage import MovingScene, room_rig
from experiments.paired_benchmark.stage import FRAMES


def scene():
    """Everything in the gallery."""
    clothes = Clothes(
        shirt=stripes_of([*PLUM[:3], "#f0c541"], 0.06, (0, 0, 1)),
        trousers=mosaic_of(["#3c6e71", "#284b4d", "#4f8a8b"], 0.08, 0.6),
        skin=blotches_of(["#c99a7c", "#be8c6d", "#d3a78a"], 0.2),
        hair=stripes_of(["#a5562a", "#8b4522", "#b8683a"], 0.02),
        shoes=stripes_of(["#2f2c28", "#e9e2cf"], 0.05, (0, 0, 1)),
    )
    car, garage = car_in_garage((1.35, -0.95), math.radians(155))
    softs = [
        *figure("dancer", dance, clothes),
        *washing((-1.75, 0.9), math.radians(-12)),
        *drops((1.0, 1.1, 1.15)),
    ]
    return MovingScene(
        [*gallery(), *garage, *line_posts(), *bowl()], softs, car, room_rig(3.1, (0.0, 0.1, 0.95))
    )


def dance(time):
    """Jumps from a squat with both arms up, turning on the way."""
    t = SECONDS * time
    beat = 2 * math.pi * 1.15 * t
    squat = max(0.0, math.sin(beat)) ** 1.2
    rise = max(0.0, -math.sin(beat))
    kick = math.sin(beat / 2)
    return Pose(
        place=(-0.25 + 0.35 * math.sin(1.6 * t), -0.55 + 0.2 * math.cos(2.1 * t)),
        heading=0.6 + 1.9 * time + 0.3 * math.sin(beat),
        hip=(
            0.15 + 0.75 * squat + 0.5 * rise * max(kick, 0),
            0.15 + 0.75 * squat + 0.5 * rise * max(-kick, 0),
        ),
        knee=(0.2 + 1.35 * squat + 0.4 * rise, 0.2 + 1.35 * squat + 0.4 * rise),
        shoulder=(0.5 * squat - 0.2 * rise, 0.4 * squat + 0.5 * rise),
        lift=(0.35 + 1.9 * rise, 0.35 + 1.9 * rise + 0.3 * kick),
        elbow=(0.7 * squat + 0.2, 0.7 * squat + 0.2),
        wave=(0.4 * math.sin(2 * beat), 0.4 * math.sin(2 * beat + 1)),
        twist=0.25 * math.sin(beat),
        lean=0.05 + 0.35 * squat,
        hop=0.26 * rise,
    )


def washing(corner, heading):
    """Two sheets and a towel on a line."""
    along = np.array([math.cos(heading), math.sin(heading)])
    cloths = [
        ("sheet", 0.0, 0.95, 1.15, mosaic_of([*SEA[:3], "#e9e2cf"], 0.14, 0.0)),
        ("towel", 1.05, 0.5, 0.8, stripes_of([*CLAY[:3], "#e9e2cf"], 0.09, (0, 0, 1))),
    ]
    return [
        curtain(
            name,
            (*(np.array(corner) + start * along), 1.95 - high),
            (wide, high),
            heading,
            pattern,
            gust=0.45,
            folds=2,
            beat=1.1 + 0.3 * start,
        )
        for name, start, wide, high, pattern in cloths
    ]


def line_posts():
    """The line and its two posts."""
    heading, length = math.radians(-12), 1.75
    paint = stripes_of(GREY + WHITE[:1], 0.14, (0, 0, 1))
    ends = [(-1.75 + k * math.cos(heading), 0.9 + k * math.sin(heading)) for k in (-0.08, length)]
    posts = [
        add(f"post_{k}", *cylinder(0.03, 2.0), (*end, 1.0), UP, paint) for k, end in enumerate(ends)
    ]
    feet = [
        add(f"foot_{k}", *cylinder(0.2, 0.04), (*end, 0.021), UP, wedges)
        for k, end in enumerate(ends)
    ]
    middle = [(a + b) / 2 for a, b in zip(*ends, strict=True)]
    size = (length + 0.1, 0.02, 0.02)
    return [
        *posts,
        *feet,
        add("line", *box(size), (*middle, 1.96), (0, 0, heading), stripes_of(SAND, 0.3)),
    ]


def drops(middle):
    """Drops of one paint that rise and sink through one another, and stretch meanwhile."""
    paint = mosaic_of([CLAY[0], "#e8833a", "#f0c541", CLAY[3]], 0.09, 1.0)
    made = []
    for k, (radius, beat, phase) in enumerate(
        [(0.21, 0.55, 0.0), (0.17, 0.7, 2.2), (0.13, 0.9, 4.0)]
    ):

        def way(time, k=k, beat=beat, phase=phase):
            angle = 2 * math.pi * beat * SECONDS * time + phase
            side = 0.08 * math.sin(1.3 * angle + k)
            return np.array([side, 0.6 * side, 0.42 * math.sin(angle)]), 1 + 0.25 * math.cos(
                2 * angle
            )

        made.append(
            blob(f"drop_{k}", middle, radius, paint, 20 + k, strength=0.16, beat=0.8, drift=way)
        )
    return made


def bowl():
    """What the drops hang above."""
    stand = add(
        "plinth", *box((0.5, 0.5, 0.42)), (1.0, 1.1, 0.211), (0, 0, 0.3), blotches_of(WHITE, 0.2)
    )
    dish = add("dish", *cylinder(0.3, 0.07), (1.0, 1.1, 0.46), UP, stripes_of(SEA, 0.06))
    return [stand, dish]


def car_in_garage(place, heading):
    """A toy car that drives out of a box towards `heading`, and the box, open in front."""
    side, deep, high, wall = 0.62, 0.95, 0.5, 0.03
    way = pivot("way", (*place, 0.0))
    way.rotation_euler = (0, 0, heading)
    carrier = pivot("car", (0, 0, 0), way)
    path = {}
    for k in range(FRAMES):
        t = k / (FRAMES - 1)
        path[k] = (1.55 * max(0.0, t - 0.12) ** 1.4 / 0.88**1.4, 0.12 * math.sin(4 * t) * t, 0.0)
    animate(carrier, "location", path)
    paint = stripes_of(["#d33f3a", "#b3362f", "#f0c541"], 0.12, (0, 0, 1))
    moving = [
        hung(carrier, "body", box((0.62, 0.34, 0.15)), (0, 0, 0.18), UP, paint),
        hung(
            carrier,
            "cabin",
            box((0.32, 0.3, 0.13)),
            (-0.05, 0, 0.32),
            UP,
            mosaic_of(SEA, 0.08, 0.0),
        ),
    ]
    for k, (x, y) in enumerate([(0.2, 0.18), (0.2, -0.18), (-0.2, 0.18), (-0.2, -0.18)]):
        axle = pivot(f"axle_{k}", (x, y, 0.09), carrier)
        animate(axle, "rotation_euler", {f: (0, p[0] / 0.09, 0) for f, p in path.items()})
        moving.append(
            hung(axle, f"wheel_{k}", cylinder(0.09, 0.06), (0, 0, 0), (math.pi / 2, 0, 0), wedges)
        )
    board = mosaic_of(SAND + WOOD[:1], 0.15, 0.0)
    walls = [
        ("left", (deep, wall, high), (0, side / 2, high / 2)),
        ("right", (deep, wall, high), (0, -side / 2, high / 2)),
        ("back", (wall, side, high), (-deep / 2, 0, high / 2)),
        ("roof", (deep, side + wall, wall), (0, 0, high + wall / 2)),
    ]
    return moving, [hung(way, f"garage_{n}", box(s), p, UP, board) for n, s, p in walls]


def gallery():
    """All that rests in the room."""
    lit(7.2, 7.2, 3.1, 122)
    walls = shell(
        (7.2, 7.2, 3.1),
        {
            "floor": bricks_of("#a9754a", "#8f5f3a", "#6d452a", 0.5, 0.16, 0.008),
            "ceiling": blotches_of(WHITE + ["#d6cfc0"], 0.6),
            "north": blotches_of(["#d9d2c2", "#cfc7b4", "#e3ddd0"], 0.5),
            "south": blotches_of(["#7a8f7c", "#6f8571", "#869a87"], 0.5),
            "east": stripes_of(["#e2d7c0", "#d6c8aa"], 0.3, (0, 1, 0)),
            "west": bricks_of("#c8c2b4", "#b5ae9e", "#e9e4d8", 0.45, 0.2, 0.02),
        },
        shine=0.14,
        roughness=0.2,
    )
    table = [
        ("bench", (1.8, 0.45, 0.42), (0.4, -3.2, 0.211), 0, stripes_of(WOOD, 0.12, (0, 1, 0))),
        (
            "crate_1",
            (0.7, 0.7, 0.7),
            (-2.9, -2.9, 0.351),
            15,
            stripes_of(SAND + WOOD, 0.12, (0, 0, 1)),
        ),
        ("crate_2", (0.5, 0.5, 0.4), (-2.9, -2.85, 0.9), 40, mosaic_of(SAND, 0.16, 0.0)),
        (
            "desk",
            (0.6, 1.4, 0.9),
            (3.2, 1.4, 0.451),
            0,
            stripes_of(NAVY + GREY[:1], 0.2, (0, 1, 0)),
        ),
        (
            "leaflets",
            (0.3, 0.5, 0.06),
            (3.15, 1.5, 0.93),
            10,
            stripes_of(TOYS[:4], 0.05, (0, 1, 0)),
        ),
        (
            "door",
            (1.1, 0.06, 2.2),
            (-1.4, -3.56, 1.101),
            0,
            stripes_of(["#54392b", "#6b4c3a"], 0.2),
        ),
        ("plinth_2", (0.5, 0.5, 0.9), (-3.0, 2.9, 0.451), 20, blotches_of(WHITE, 0.2)),
    ]
    round_things = [
        ("bust", ball(0.26), (-3.0, 2.9, 1.16), mosaic_of(GREY + SEA[2:3], 0.1, 1.0)),
        (
            "column",
            cylinder(0.16, 2.2),
            (3.1, 3.1, 1.101),
            stripes_of(SAND + WHITE, 0.12, (0, 0, 1)),
        ),
        ("pot", cylinder(0.22, 0.4), (3.1, -3.0, 0.201), stripes_of(CLAY, 0.08, (0, 0, 1))),
        ("bush", ball(0.42), (3.1, -3.0, 0.78), mosaic_of(MOSS, 0.08, 1.0)),
    ]
    pictures = framed("large", (1.6, 1.1), (-0.6, 3.55, 1.65), 0, mosaic_of(TOYS + SEA, 0.2, 1.0))
    pictures += framed("small", (0.8, 0.9), (1.7, 3.55, 1.6), 0, blotches_of(PLUM + CLAY, 0.2))
    pictures += framed(
        "tall", (0.8, 1.4), (1.6, -3.55, 1.7), 180, stripes_of(SEA + SAND, 0.1, (1, 0, 1))
    )
    pictures += framed(
        "west_1", (1.2, 0.9), (-3.55, 0.9, 1.7), 90, mosaic_of(MOSS + CLAY, 0.14, 0.6)
    )
    pictures += framed("west_2", (0.9, 0.9), (-3.55, -1.2, 1.7), 90, wedges)
    pictures += framed("east_1", (1.3, 0.8), (3.55, -0.9, 1.7), -90, blotches_of(TOYS, 0.22))
    return worn(walls) + solids(table) + rounds(round_things) + pictures
