"""An office: a fan turns, a pendulum swings, both fast."""

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
    mosaic_of,
    planks,
    stripes_of,
    wedges,
    wedges_of,
)
from experiments.blender.shapes import (
    add,
    animate,
    ball,
    box,
    cylinder,
    hung,
    lathe,
    pivot,
    ring,
    shell,
)
from experiments.captures.scenes.furnish import (
    GREY,
    NAVY,
    UP,
    WHITE,
    books,
    framed,
    lit,
    rounds,
    solids,
    worn,
)
from experiments.captures.scenes.stage import MovingScene, room_rig
from experiments.paired_benchmark.stage import FPS, FRAMES


TIMES = range(FRAMES)
TURNS = 0.75  # of the fan in a second
SWING, PERIOD, LENGTH = 0.62, 2.2, 1.35  # of the pendulum: radians, seconds, metres
BLADES = [
    stripes_of(CLAY, 0.09),
    mosaic_of(SEA, 0.11, 1.0),
    stripes_of(TOYS[1:3], 0.08, (1, 1, 0)),
    mosaic_of(PLUM, 0.1, 0.0),
]


def scene():
    """Everything in the office."""
    fan, fan_stand = standing_fan((-0.75, 0.1), 1.25, math.radians(-25))
    swinging, gallows = pendulum((0.85, -0.2), 1.85, math.radians(50))
    rig = room_rig(3.0, (0.05, 0.0, 1.05))
    return MovingScene(office() + fan_stand + gallows, [], fan + swinging, rig)


def standing_fan(foot, height, heading):
    """A fan whose four blades turn about a level axis, and its stand."""
    carrier = pivot("fan", (*foot, height))
    carrier.rotation_euler = (math.pi / 2, 0, heading)
    holder = pivot("hub", (0, 0, 0), carrier)
    spin = {k: (0, 0, 2 * math.pi * TURNS * k / FPS) for k in TIMES}
    animate(holder, "rotation_euler", spin, "LINEAR")
    moving = [hung(holder, "hub_cap", cylinder(0.11, 0.12), (0, 0, 0), UP, wedges)]
    for k, pattern in enumerate(BLADES):
        turn = math.pi / 2 * k
        place = (0.4 * math.cos(turn), 0.4 * math.sin(turn), 0)
        moving.append(
            hung(holder, f"blade_{k}", box((0.6, 0.26, 0.025)), place, (0.35, 0, turn), pattern)
        )
    behind = (foot[0] - 0.16 * math.sin(heading), foot[1] + 0.16 * math.cos(heading))
    stand = [
        add(
            "fan_pole",
            *cylinder(0.035, height),
            (*behind, height / 2),
            UP,
            stripes_of(GREY, 0.2, (0, 0, 1)),
        ),
        add("fan_foot", *cylinder(0.26, 0.05), (*behind, 0.026), UP, wedges_of(GREY * 3)),
        add(
            "motor",
            *cylinder(0.1, 0.18),
            (*behind, height),
            (math.pi / 2, 0, heading),
            stripes_of(NAVY, 0.05),
        ),
    ]
    return moving, stand


def pendulum(place, height, heading):
    """A bob on a rod that swings below a beam, and the frame that holds it."""
    carrier = pivot("pendulum", (*place, height))
    holder = pivot("swing", (0, 0, 0), carrier)
    carrier.rotation_euler = (0, 0, heading)
    angles = {k: (0, SWING * math.cos(2 * math.pi * k / FPS / PERIOD), 0) for k in TIMES}
    animate(holder, "rotation_euler", angles)
    bob = mosaic_of(TOYS, 0.15, 1.0)
    moving = [
        hung(
            holder,
            "rod",
            cylinder(0.025, LENGTH),
            (0, 0, -LENGTH / 2),
            UP,
            stripes_of(["#f0c541", "#2f2c28"], 0.12, (0, 0, 1)),
        ),
        hung(holder, "bob", ball(0.24), (0, 0, -LENGTH), UP, bob, smooth=True),
        hung(holder, "belt", ring(0.25, 0.035), (0, 0, -LENGTH), UP, wedges, smooth=True),
    ]
    across = (-math.sin(heading), math.cos(heading))
    paint, frame = stripes_of(WOOD, 0.12, (0, 0, 1)), []
    for side in (-1, 1):
        x, y = place[0] + 0.5 * side * across[0], place[1] + 0.5 * side * across[1]
        leg = add(
            f"post_{side}", *box((0.07, 0.07, height)), (x, y, height / 2), (0, 0, heading), paint
        )
        foot = add(f"skid_{side}", *box((0.8, 0.09, 0.06)), (x, y, 0.031), (0, 0, heading), paint)
        frame += [leg, foot]
    beam = add(
        "beam",
        *box((0.08, 1.1, 0.08)),
        (*place, height + 0.04),
        (0, 0, heading),
        stripes_of(WOOD, 0.2, (0, 1, 0)),
    )
    return moving, [*frame, beam]


def office():
    """All that rests in the room."""
    lit(7.0, 7.0, 3.0, 118)
    walls = shell(
        (7.0, 7.0, 3.0),
        {
            "floor": mosaic_of(["#6f7f8d", "#7f8f9b", "#64737f", "#8b98a2"], 0.5, 0.0),
            "ceiling": mosaic_of(WHITE + ["#cfc8b8"], 0.6, 0.0),
            "north": blotches_of(["#cfd6cf", "#c2ccc4", "#dae0d9"], 0.6),
            "south": stripes_of(["#e3dcc9", "#d8ceb4", "#cdbf9c"], 0.24),
            "east": planks,
            "west": blotches_of(["#b9786a", "#c48576", "#ad6c5f"], 0.5),
        },
        shine=0.08,
        roughness=0.3,
    )
    table = [
        ("desk", (1.7, 0.7, 0.06), (-0.6, 3.1, 0.74), 0, stripes_of(WOOD, 0.3, (0, 1, 0))),
        ("drawers", (0.5, 0.6, 0.7), (-1.1, 3.12, 0.351), 0, stripes_of(SAND, 0.18, (0, 0, 1))),
        ("leg", (0.06, 0.6, 0.7), (0.2, 3.12, 0.351), 0, stripes_of(GREY, 0.1)),
        ("monitor", (0.8, 0.05, 0.5), (-0.5, 3.25, 1.1), 8, mosaic_of(NAVY + SEA, 0.11, 0.2)),
        (
            "papers",
            (0.3, 0.4, 0.05),
            (0.0, 3.0, 0.8),
            20,
            stripes_of(WHITE + CLAY[:1], 0.04, (0, 1, 0)),
        ),
        ("chair", (0.5, 0.5, 0.1), (-0.5, 2.5, 0.48), 15, mosaic_of(MOSS, 0.12, 1.0)),
        ("chair_leg", (0.1, 0.1, 0.43), (-0.5, 2.5, 0.216), 15, stripes_of(GREY, 0.1)),
        ("chair_back", (0.48, 0.08, 0.5), (-0.44, 2.24, 0.8), 15, mosaic_of(MOSS, 0.12, 1.0)),
        (
            "cabinet",
            (0.5, 1.3, 1.2),
            (-3.2, -1.4, 0.601),
            0,
            stripes_of(GREY + SEA[1:2], 0.3, (0, 0, 1)),
        ),
        ("carton_1", (0.4, 0.5, 0.36), (-3.2, -1.6, 1.38), 10, mosaic_of(SAND, 0.15, 0.0)),
        ("sofa", (1.9, 0.75, 0.42), (0.9, -3.05, 0.211), 0, mosaic_of(PLUM, 0.2, 0.7)),
        ("sofa_back", (1.9, 0.2, 0.45), (0.9, -3.36, 0.64), 0, stripes_of(PLUM, 0.15)),
        ("pillow", (0.45, 0.14, 0.4), (0.3, -3.1, 0.6), -12, mosaic_of(TOYS, 0.1, 0.0)),
        (
            "printer",
            (0.5, 0.5, 0.35),
            (3.1, 2.6, 0.88),
            12,
            stripes_of(WHITE + GREY, 0.09, (0, 0, 1)),
        ),
        ("stand", (0.6, 0.6, 0.7), (3.1, 2.6, 0.351), 0, stripes_of(WOOD, 0.12)),
        (
            "blind",
            (0.06, 1.8, 1.3),
            (-3.46, 1.2, 1.7),
            0,
            stripes_of(SEA[1:3] + WHITE, 0.08, (0, 0, 1)),
        ),
    ]
    round_things = [
        (
            "bin",
            lathe([(0, 0), (0.16, 0), (0.2, 0.4), (0, 0.4)]),
            (0.9, 3.2, 0.001),
            stripes_of(SEA, 0.06),
        ),
        ("pot", cylinder(0.24, 0.4), (-3.0, 3.0, 0.201), mosaic_of(CLAY, 0.13, 0.4)),
        ("bush", ball(0.45), (-3.0, 3.0, 0.85), mosaic_of(MOSS, 0.08, 1.0)),
        ("globe", ball(0.22), (-3.2, -1.0, 1.43), mosaic_of(SEA + MOSS[:2], 0.12, 1.0)),
    ]
    case = books("case", (3.25, -2.6), 2.4, 5, 90, [CLAY + PLUM, MOSS + SEA, TOYS, NAVY + SAND])
    pictures = framed("chart", (1.2, 0.8), (1.6, 3.45, 1.7), 0, mosaic_of(TOYS + WHITE, 0.13, 0.0))
    pictures += framed("photo", (0.9, 0.9), (-1.7, -3.45, 1.7), 180, blotches_of(SEA + SAND, 0.2))
    pictures += framed("clock", (0.6, 0.6), (0.9, -3.45, 1.9), 180, wedges)
    return worn(walls) + solids(table) + rounds(round_things) + case + pictures
