"""A living room: a curtain blows, a figure turns and waves, smoke rises from a burner, a jack comes
out of its box, a screen shows other pictures."""

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
    planks,
    stripes_of,
    wedges,
)
from experiments.blender.shapes import add, animate, ball, box, cylinder, hung, lathe, pivot, shell
from experiments.blender.soft import soft, tube, tube_faces
from experiments.captures.scenes.changing import puffs, screen
from experiments.captures.scenes.fabric import SECONDS, curtain
from experiments.captures.scenes.figure import Clothes, Pose, figure
from experiments.captures.scenes.furnish import (
    GREY,
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


BOX_AT, BOX_SIDE = (1.0, -0.85), 0.46


def scene():
    """Everything in the room."""
    clothes = Clothes(
        shirt=mosaic_of([SEA[0], "#f0c541", SEA[1], "#e9e2cf"], 0.1, 0.4),
        trousers=stripes_of(["#6b4c3a", "#7d5a45", "#54392b"], 0.05),
        skin=blotches_of(["#8a5a3f", "#7b4e36", "#96664a"], 0.2),
        hair=mosaic_of(["#1f1a18", "#2c2420"], 0.03, 1.0),
        shoes=stripes_of(["#2f2c28", "#e8833a"], 0.05, (0, 0, 1)),
    )
    cloth = stripes_of([*CLAY[:3], "#e9e2cf"], 0.12)
    smoke = blotches_of(["#d8d4cc", "#b9b4aa", "#e6e2da", "#a29c92"], 0.12)
    jack, lid, crate = jack_in_the_box()
    softs = [
        curtain("curtain", (-1.9, 1.35, 0.5), (1.5, 2.0), math.radians(4), cloth),
        *figure("waver", turn_and_wave, clothes),
        *puffs("smoke", (1.25, 0.95, 1.0), 5, smoke, rise=1.0, radius=0.16),
        *jack,
        screen(
            "screen",
            (1.5, 0.85),
            (3.4, 0.0, 1.55),
            (math.pi / 2, 0, -math.pi / 2),
            mosaic_of(TOYS + SEA + WHITE[:1], 0.3, 1.0),
        ),
    ]
    burner = [
        add("table", *cylinder(0.36, 0.05), (1.25, 0.95, 0.72), UP, stripes_of(WOOD, 0.1)),
        add("table_leg", *cylinder(0.06, 0.7), (1.25, 0.95, 0.35), UP, stripes_of(WOOD, 0.1)),
        add("burner", *cylinder(0.13, 0.2), (1.25, 0.95, 0.85), UP, mosaic_of(CLAY, 0.06, 1.0)),
    ]
    rail = [
        add(
            f"rail_{k}",
            *cylinder(0.025, 2.55),
            (x, 1.35 + 0.07 * (x + 1.9), 1.27),
            UP,
            stripes_of(GREY, 0.2, (0, 0, 1)),
        )
        for k, x in enumerate((-1.95, -0.35))
    ]
    bar = add(
        "rod", *box((1.7, 0.04, 0.04)), (-1.15, 1.4, 2.52), (0, 0, 0.07), stripes_of(WOOD, 0.2)
    )
    fixed = [*room(), *burner, *rail, bar, *crate]
    return MovingScene(fixed, softs, [lid], room_rig(3.0, (0.0, 0.1, 1.0)))


def turn_and_wave(time):
    """Half a turn on the spot, one arm waving over the head, the other swinging."""
    t = SECONDS * time
    step = math.sin(2 * math.pi * 1.4 * t)
    return Pose(
        place=(-0.35 + 0.1 * math.sin(2 * t), -0.35),
        heading=-2.2 + 3.0 * time + 0.15 * step,
        hip=(0.12 + 0.22 * step, 0.12 - 0.22 * step),
        knee=(0.2 + 0.35 * max(0.0, step), 0.2 + 0.35 * max(0.0, -step)),
        shoulder=(0.2, 0.5 * math.sin(2 * math.pi * 0.9 * t)),
        lift=(2.2 + 0.25 * math.sin(2 * math.pi * 1.1 * t), 0.3),
        elbow=(0.1, 0.5 + 0.4 * math.sin(2 * math.pi * 0.9 * t)),
        wave=(0.35 + 0.75 * math.sin(2 * math.pi * 1.6 * t), 0.0),
        twist=0.25 * math.sin(2 * math.pi * 0.8 * t),
        lean=0.05 + 0.05 * step,
    )


def jack_in_the_box():
    """A head on a spring that comes out of a box once its lid is open: soft things, lid, box."""
    x, y = BOX_AT
    side, wall = BOX_SIDE, 0.02
    paint = mosaic_of(TOYS[:3] + WHITE[:1], 0.115, 0.0)
    crate = [
        add(f"box_{k}", *box(size), (x + dx, y + dy, side / 2 + 0.002), UP, paint)
        for k, (size, dx, dy) in enumerate(
            [
                ((side, wall, side), 0, side / 2),
                ((side, wall, side), 0, -side / 2),
                ((wall, side, side), side / 2, 0),
                ((wall, side, side), -side / 2, 0),
            ]
        )
    ]
    hinge = pivot("hinge", (x + side / 2, y, side + 0.012))
    animate(
        hinge, "rotation_euler", {0: (0, 0, 0), 7: (0, 0.15, 0), 15: (0, 2.0, 0), 20: (0, 1.8, 0)}
    )
    lid = hung(hinge, "lid", box((side, side, wall)), (-side / 2, 0, 0), UP, wedges)
    rings, share = 36, np.linspace(0, 1, 36)
    radii = np.repeat((0.085 + 0.02 * np.sin(2 * np.pi * 8 * share))[:, None], 2, axis=1)

    def way(time):
        """Centres of the spring and the place of the head."""
        t = SECONDS * time
        out = max(0.0, t - 0.38)
        high = 0.14 + 0.85 * (1 - math.exp(-5.5 * out) * math.cos(9.0 * out))
        bend = 0.28 * math.sin(6.5 * out) * (1 - math.exp(-3 * out))
        centres = np.stack(
            [x + bend * share**2, y + 0.5 * bend * share**1.5, 0.03 + high * share], axis=1
        )
        return centres

    def spring(time):
        return tube(way(time), np.array([0.0, 1.0, 0.0]), radii, 16)

    straight = np.stack([0 * share, 0 * share, 0.6 * share], axis=1)
    rest = tube(straight, np.array([0.0, 1.0, 0.0]), radii, 16)
    globe, faces = ball(0.15, rings=20, sectors=32)

    def head(time):
        return np.array(globe) + way(time)[-1] + (0, 0, 0.08)

    coil = stripes_of(["#f0c541", "#c23b3b"], 0.05, (0, 0, 1))
    made = [
        soft("spring", rest.tolist(), tube_faces(rings, 16), spring, coil),
        soft("head", globe, faces, head, mosaic_of(PLUM + WHITE[:1], 0.09, 1.0)),
    ]
    return made, lid, crate


def room():
    """All that rests in the room."""
    lit(7.0, 7.0, 3.0, 120)
    walls = shell(
        (7.0, 7.0, 3.0),
        {
            "floor": planks,
            "ceiling": blotches_of(WHITE + ["#d2cbbb"], 0.6),
            "north": stripes_of(["#c7d0c0", "#b9c4b0", "#d4dccd", "#a9b69f"], 0.2),
            "south": blotches_of(["#d8b48c", "#cfa87d", "#e0c09b"], 0.5),
            "east": blotches_of(["#8792a8", "#7c879e", "#929db2"], 0.6),
            "west": mosaic_of(["#ddd2bd", "#d2c5ac", "#e6dcc9", "#c8b998"], 0.45, 0.0),
        },
        shine=0.1,
        roughness=0.22,
    )
    table = [
        ("sofa", (2.2, 0.8, 0.42), (0.6, 3.1, 0.211), 0, mosaic_of(MOSS, 0.22, 0.8)),
        ("sofa_back", (2.2, 0.22, 0.5), (0.6, 3.38, 0.66), 0, stripes_of(MOSS, 0.16)),
        ("pillow_1", (0.48, 0.15, 0.42), (0.0, 3.12, 0.62), 12, stripes_of(CLAY, 0.08, (1, 0, 1))),
        ("pillow_2", (0.48, 0.15, 0.42), (1.2, 3.12, 0.62), -15, mosaic_of(PLUM, 0.12, 0.0)),
        ("frame", (0.05, 1.7, 1.05), (3.45, 0.0, 1.55), 0, stripes_of(["#2f2c28", "#3a3632"], 0.2)),
        ("console", (0.45, 2.0, 0.5), (3.2, 0.0, 0.251), 0, stripes_of(WOOD, 0.22, (0, 1, 0))),
        ("amplifier", (0.3, 0.5, 0.16), (3.2, 0.5, 0.58), 0, stripes_of(GREY, 0.06, (0, 1, 0))),
        ("chest", (1.4, 0.5, 0.75), (-1.6, -3.2, 0.376), 0, mosaic_of(WOOD + SAND, 0.25, 0.0)),
        ("lamp_foot", (0.18, 0.18, 0.3), (-2.0, -3.2, 0.9), 25, stripes_of(SEA, 0.06, (0, 0, 1))),
        ("door", (1.0, 0.06, 2.1), (1.4, -3.46, 1.051), 0, stripes_of(WHITE + GREY[1:2], 0.25)),
        ("armchair", (0.8, 0.8, 0.42), (-2.9, 2.7, 0.211), 40, mosaic_of(CLAY, 0.18, 1.0)),
        ("arm_back", (0.2, 0.8, 0.5), (-3.15, 2.9, 0.66), 40, stripes_of(CLAY, 0.1, (0, 1, 0))),
    ]
    round_things = [
        ("shade", lathe([(0.24, 0), (0.14, 0.3)]), (-2.0, -3.2, 1.08), stripes_of(SAND, 0.05)),
        (
            "vase",
            lathe([(0, 0), (0.14, 0), (0.2, 0.3), (0.08, 0.5), (0, 0.5)]),
            (-1.1, -3.2, 0.752),
            mosaic_of(SEA + WHITE, 0.1, 1.0),
        ),
        ("rug", cylinder(1.0, 0.02), (-0.4, -0.4, 0.012), wedges),
        ("pot", cylinder(0.22, 0.36), (3.1, 2.9, 0.181), stripes_of(CLAY, 0.07, (0, 0, 1))),
        ("bush", ball(0.46), (3.05, 2.9, 0.8), mosaic_of(MOSS, 0.08, 1.0)),
        ("stool", cylinder(0.2, 0.45), (2.6, -2.9, 0.226), stripes_of(PLUM, 0.09, (1, 1, 0))),
    ]
    case = books("case", (-3.28, -2.0), 2.6, 4, 90, [TOYS, SEA + SAND, PLUM + CLAY, MOSS])
    pictures = framed("view", (1.3, 0.9), (0.5, 3.45, 1.8), 0, blotches_of(SEA + MOSS + SAND, 0.2))
    pictures += framed("print", (0.8, 1.0), (2.4, 3.45, 1.7), 0, mosaic_of(TOYS, 0.15, 1.0))
    pictures += framed("chart", (1.0, 0.7), (-1.3, -3.45, 1.9), 180, stripes_of(SEA + CLAY, 0.09))
    return worn(walls) + solids(table) + rounds(round_things) + case + pictures
