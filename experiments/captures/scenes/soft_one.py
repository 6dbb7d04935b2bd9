"""A dance studio: a flag waves, a figure walks by, a blob flows on a pedestal."""

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
    planks,
    stripes_of,
    wedges,
)
from experiments.blender.shapes import add, ball, box, cylinder, lathe, shell
from experiments.captures.scenes.fabric import blob, flag
from experiments.captures.scenes.figure import Clothes, figure, walk
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


def scene():
    """Everything in the studio."""
    clothes = Clothes(
        shirt=stripes_of(["#c23b3b", "#e9e2cf", "#c23b3b", "#7d2430"], 0.045, (0, 0, 1)),
        trousers=mosaic_of(NAVY, 0.07, 1.0),
        skin=blotches_of(["#d9a583", "#cf9873", "#e0b08f"], 0.2),
        hair=stripes_of(["#3a2a20", "#4d382a", "#2a1f18"], 0.02),
        shoes=stripes_of(["#e9e2cf", "#d33f3a"], 0.06, (0, 0, 1)),
    )
    banner = mosaic_of([*TOYS[:4], "#23405e"], 0.19, 0.0)
    pole = (-1.25, 0.75)
    softs = [
        flag("flag", (*pole, 1.12), (1.35, 0.85), math.radians(20), banner),
        *figure("walker", walk((-1.05, -0.75), 0.08, 2.15, 1.55, bend=0.3), clothes),
        blob("blob", (1.25, 0.85, 1.05), 0.36, mosaic_of(SEA + CLAY[2:4] + PLUM[1:2], 0.13, 1.0)),
    ]
    props = [
        add(
            "pole",
            *cylinder(0.03, 2.1),
            (*pole, 1.05),
            UP,
            stripes_of(GREY + WHITE, 0.15, (0, 0, 1)),
        ),
        add("pole_foot", *cylinder(0.22, 0.06), (*pole, 0.031), UP, stripes_of(GREY, 0.1)),
        add("pole_top", *ball(0.05), (*pole, 2.12), UP, blotches_of(SAND, 0.1)),
        add(
            "pedestal",
            *box((0.5, 0.5, 0.5)),
            (1.25, 0.85, 0.251),
            (0, 0, 0.4),
            blotches_of(WHITE + SAND, 0.15),
        ),
    ]
    return MovingScene(studio() + props, softs, [], room_rig(3.0, (0.0, 0.0, 0.95)))


def studio():
    """A dance studio of 7 m: boards, brick, a mirror's frame, posters, benches."""
    lit(7.0, 7.0, 3.1, 120)
    walls = shell(
        (7.0, 7.0, 3.1),
        {
            "floor": planks,
            "ceiling": blotches_of(["#b9b2a4", "#c9c2b2", "#d5cfc2", "#ada695"], 0.45),
            "north": bricks_of("#b5694a", "#c98a66", "#d8c6a4", 0.5, 0.18, 0.02),
            "south": blotches_of(["#7d9a9a", "#8aa7a4", "#93b0ab", "#759092"], 0.6),
            "east": blotches_of(WHITE + ["#d2c8b4"], 0.5),
            "west": stripes_of(["#d9cfb8", "#cbb894", "#e3dcc9", "#b9a078"], 0.17, (0, 1, 0)),
        },
        shine=0.12,
        roughness=0.2,
    )
    table = [
        ("bench", (2.4, 0.42, 0.42), (-0.8, -3.2, 0.211), 0, stripes_of(WOOD, 0.16, (0, 1, 0))),
        ("bag", (0.5, 0.34, 0.34), (-1.4, -3.2, 0.59), 14, mosaic_of(NAVY + CLAY[:2], 0.14, 0.6)),
        ("box_low", (0.9, 0.6, 0.5), (3.05, 1.9, 0.251), 0, mosaic_of(SAND + WOOD, 0.22, 0.2)),
        ("box_high", (0.6, 0.5, 0.36), (3.05, 1.85, 0.68), 12, stripes_of(SEA, 0.1)),
        (
            "piano",
            (1.5, 0.6, 1.15),
            (1.7, -3.15, 0.576),
            0,
            stripes_of(["#4a332a", "#5c4033"], 0.3),
        ),
        ("keys", (1.3, 0.2, 0.06), (1.7, -2.8, 0.7), 0, stripes_of(WHITE + ["#2f2c28"], 0.03)),
        ("window", (0.06, 1.7, 1.4), (-3.46, 0.9, 1.75), 0, mosaic_of(SEA + WHITE, 0.42, 0.0)),
        (
            "heater",
            (0.12, 1.5, 0.6),
            (-3.4, 0.9, 0.4),
            0,
            stripes_of(WHITE + GREY[:1], 0.05, (0, 1, 0)),
        ),
        ("mats", (1.1, 0.7, 0.3), (-3.0, -2.0, 0.151), 80, stripes_of(TOYS[:4], 0.075, (0, 0, 1))),
        ("barre", (0.07, 3.4, 0.07), (3.3, -0.6, 1.05), 0, stripes_of(WOOD, 0.4, (0, 1, 0))),
    ]
    round_things = [
        (
            "pot",
            lathe([(0, 0), (0.2, 0), (0.27, 0.42), (0, 0.42)]),
            (3.1, 3.1, 0.001),
            stripes_of(CLAY, 0.08, (0, 0, 1)),
        ),
        ("bush", ball(0.42), (3.05, 3.05, 0.8), mosaic_of(MOSS, 0.09, 1.0)),
        ("drum", cylinder(0.3, 0.5), (-3.0, 3.0, 0.251), wedges),
        ("ball", ball(0.28), (-2.2, -2.9, 0.281), mosaic_of(PLUM + TOYS[:2], 0.2, 1.0)),
    ]
    pictures = (
        framed("poster_1", (0.9, 1.2), (-1.9, 3.45, 1.6), 0, mosaic_of(TOYS + WHITE, 0.24, 1.0))
        + framed("poster_2", (1.3, 0.9), (0.3, 3.45, 1.7), 0, blotches_of(SEA + CLAY, 0.3))
        + framed("poster_3", (0.8, 1.1), (2.0, 3.45, 1.6), 0, stripes_of(PLUM, 0.11, (1, 0, 1)))
        + framed("poster_4", (1.2, 0.8), (-1.4, -3.45, 1.8), 180, mosaic_of(MOSS + SAND, 0.17, 1.0))
        + framed("poster_5", (1.0, 1.0), (3.45, -1.2, 1.9), 90, wedges)
    )
    return worn(walls) + solids(table) + rounds(round_things) + pictures
