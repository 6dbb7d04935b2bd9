"""A workshop: boxes and balls are thrown together, fall, bounce and tumble."""

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
from experiments.blender.physics import Thrown, bake
from experiments.blender.shapes import add, ball, box, cylinder, ring, shell
from experiments.captures.scenes.furnish import (
    GREY,
    UP,
    WHITE,
    framed,
    lit,
    rounds,
    solids,
    worn,
)
from experiments.captures.scenes.stage import MovingScene, room_rig
from experiments.paired_benchmark.stage import FPS, FRAMES, MARGIN


BOXES = [  # name, size, pattern, position, velocity, spin
    (
        "crate",
        (0.5, 0.5, 0.5),
        stripes_of(WOOD, 0.1, (0, 0, 1)),
        (-0.9, -0.3, 1.5),
        (0.9, 0.1, 0.6),
        (1.8, 2.2, -2.6),
    ),
    (
        "parcel",
        (0.62, 0.42, 0.3),
        mosaic_of(SAND + ["#d33f3a"], 0.17, 0.0),
        (0.8, 0.25, 1.9),
        (-0.8, -0.1, 0.3),
        (2.6, -0.9, 2.2),
    ),
    (
        "carton",
        (0.36, 0.36, 0.66),
        mosaic_of(SEA, 0.13, 1.0),
        (0.1, -0.95, 2.2),
        (0.0, 0.7, 0.2),
        (-1.2, 2.0, 1.5),
    ),
]
BALLS = [  # name, radius, pattern, position, velocity, spin
    ("gore_ball", 0.27, wedges_of(TOYS), (-0.5, 0.9, 1.8), (0.4, -0.8, 0.5), (2.5, 1.0, 3.0)),
    (
        "patch_ball",
        0.22,
        mosaic_of(PLUM + WHITE, 0.15, 1.0),
        (0.6, 1.0, 1.2),
        (-0.7, -0.9, 1.6),
        (-2.0, 1.7, 0.5),
    ),
    (
        "stripe_ball",
        0.18,
        stripes_of(["#e8833a", "#23405e", "#e9e2cf"], 0.07),
        (1.2, -0.7, 1.6),
        (-1.3, 0.6, 0.9),
        (0.6, -3.0, 1.2),
    ),
]


def scene():
    """Everything in the workshop."""
    hall, things = workshop()
    thrown = []
    for name, size, pattern, start, velocity, spin in BOXES:
        made = add(name, *box(size), start, UP, pattern)
        mass = 2 * size[0] * size[1] * size[2]
        thrown.append(Thrown(made, "BOX", mass, velocity, spin, restitution=0.6))
    for name, radius, pattern, start, velocity, spin in BALLS:
        made = add(name, *ball(radius), start, UP, pattern, smooth=True)
        thrown.append(Thrown(made, "SPHERE", 4 * radius**3, velocity, spin))
    bake(hall, thrown, FRAMES, fps=FPS, margin=MARGIN)
    keyed = [body.thing for body in thrown]
    return MovingScene(hall + things, [], keyed, room_rig(3.1, (0.0, 0.0, 0.8)))


def workshop():
    """The shell, which bodies meet, and what stands along the walls."""
    lit(7.2, 7.2, 3.2, 125)
    walls = shell(
        (7.2, 7.2, 3.2),
        {
            "floor": blotches_of(["#9b958a", "#a8a195", "#918b80", "#b0a99b"], 0.5),
            "ceiling": stripes_of(["#a89e8e", "#b7ad9c", "#98907f"], 0.35, (0, 1, 0)),
            "north": bricks_of("#a9aaa2", "#8d9698", "#d8d2c4", 0.55, 0.25, 0.025),
            "south": blotches_of(["#c9b98f", "#d3c49c", "#bfae82"], 0.6),
            "east": stripes_of(["#57808a", "#64909a", "#4d7480"], 0.3, (0, 1, 0)),
            "west": blotches_of(WHITE + ["#d2c8b4"], 0.5),
        },
        shine=0.1,
        roughness=0.25,
    )
    table = [
        ("counter", (3.0, 0.6, 0.1), (-0.6, 3.25, 0.9), 0, stripes_of(WOOD, 0.2, (0, 1, 0))),
        ("leg_1", (0.12, 0.5, 0.85), (-1.9, 3.25, 0.425), 0, stripes_of(WOOD, 0.1)),
        ("leg_2", (0.12, 0.5, 0.85), (0.7, 3.25, 0.425), 0, stripes_of(WOOD, 0.1)),
        ("tools", (0.5, 0.3, 0.25), (-1.4, 3.25, 1.08), 10, mosaic_of(TOYS[:2] + GREY, 0.1, 0.0)),
        ("vice", (0.3, 0.3, 0.3), (0.2, 3.25, 1.1), 30, mosaic_of(GREY + SEA[3:4], 0.1, 1.0)),
        (
            "locker_1",
            (0.5, 0.6, 1.9),
            (3.3, 2.4, 0.951),
            0,
            stripes_of(SEA[:2] + GREY, 0.2, (0, 0, 1)),
        ),
        (
            "locker_2",
            (0.5, 0.6, 1.9),
            (3.3, 1.75, 0.951),
            0,
            stripes_of(CLAY[:2] + GREY, 0.2, (0, 0, 1)),
        ),
        ("planks", (0.4, 2.4, 0.24), (-3.3, -1.4, 0.121), 0, stripes_of(WOOD, 0.06, (0, 0, 1))),
        ("pallet", (1.2, 0.9, 0.16), (2.7, -2.9, 0.081), 8, stripes_of(WOOD, 0.13)),
        ("sacks", (0.9, 0.6, 0.4), (2.7, -2.95, 0.37), 15, blotches_of(SAND, 0.16)),
        (
            "door",
            (1.0, 0.06, 2.1),
            (-1.5, -3.56, 1.051),
            0,
            stripes_of(["#6b4c3a", "#7d5a45"], 0.25),
        ),
        ("notice", (1.3, 0.05, 0.9), (0.6, -3.56, 1.7), 0, mosaic_of(WHITE + TOYS, 0.15, 0.3)),
        ("pegboard", (2.6, 0.05, 0.9), (-0.6, 3.56, 1.7), 0, mosaic_of(SAND + CLAY[:1], 0.1, 0.0)),
        ("window", (0.05, 1.8, 1.1), (-3.57, 1.2, 1.9), 0, mosaic_of(SEA + WHITE, 0.38, 0.0)),
        (
            "pipe",
            (0.09, 7.0, 0.09),
            (3.4, 0.0, 2.9),
            0,
            stripes_of(["#d9622e", "#b5533c"], 0.5, (0, 1, 0)),
        ),
    ]
    round_things = [
        (
            "barrel",
            cylinder(0.3, 0.85),
            (-3.1, 3.1, 0.426),
            stripes_of([*SEA[:2], "#f0c541"], 0.14, (0, 0, 1)),
        ),
        (
            "tyre_low",
            ring(0.3, 0.11),
            (-3.0, -3.0, 0.111),
            stripes_of(["#2f2c28", "#4b4a4c", "#3a3836"], 0.06),
        ),
        (
            "tyre_high",
            ring(0.3, 0.11),
            (-2.95, -2.95, 0.33),
            stripes_of(["#4b4a4c", "#2f2c28"], 0.07, (0, 1, 0)),
        ),
        ("bucket", cylinder(0.17, 0.34), (1.6, 3.2, 0.171), wedges),
        ("reel", cylinder(0.35, 0.5), (3.0, 0.4, 0.251), mosaic_of(MOSS + SAND, 0.14, 0.6)),
    ]
    signs = framed("plan", (0.9, 0.7), (3.56, -1.0, 1.7), 90, mosaic_of(SEA + WHITE, 0.09, 1.0))
    signs += framed("sign", (0.7, 0.7), (-3.56, -1.2, 1.8), -90, wedges)
    return worn(walls), solids(table) + rounds(round_things) + signs
