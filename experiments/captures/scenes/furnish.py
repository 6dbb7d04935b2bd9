"""Furniture, lamps and palettes of rooms about the origin."""

import math

from experiments.blender.paint import WOOD, grain, stripes_of
from experiments.blender.shapes import add, box, lamp


UP = (0, 0, 0)
WHITE = ["#e9e4d8", "#ddd6c6", "#f0ece2"]
GREY = ["#8d9296", "#a3a8ab", "#767b80"]
NAVY = ["#26374f", "#34507a", "#1d2a3d"]


def lit(wide, deep, high, power):
    """Two wide lamps under the ceiling and one that lights it; cameras do not see them."""
    top = high - 0.15
    lamp("warm", power, (-wide / 4, -deep / 6, top), UP, (1.0, 0.93, 0.85), side=0.48 * wide)
    lamp("cool", power, (wide / 4, deep / 6, top), UP, (0.86, 0.93, 1.0), side=0.48 * wide)
    lamp("bounce", power / 3, (0, 0, 0.62 * high), (math.pi, 0, 0), (1.0, 0.96, 0.9), side=2.8)


def worn(things):
    """Give the paint of things a grain of all sizes."""
    for thing in things:
        grain(thing.data.materials[0], scale=5.0, darkest=0.7)
    return things


def solids(table):
    """Boxes: (name, size, middle, degrees about z, pattern)."""
    return [
        add(name, *box(size), middle, (0, 0, math.radians(yaw)), pattern)
        for name, size, middle, yaw, pattern in table
    ]


def rounds(table):
    """Turned things: (name, mesh, middle, pattern)."""
    return [
        add(name, *mesh, middle, UP, pattern, smooth=True) for name, mesh, middle, pattern in table
    ]


def framed(name, size, middle, yaw, pattern, frame=WOOD):
    """A picture on a wall: size is (width, height); yaw is 0 in the north, -90 in the east, 90 in
    the west, 180 in the south. Turned otherwise, its frame hides it."""
    turn = math.radians(yaw)
    wide, high = size
    x, y, z = middle
    off = (x + 0.02 * math.sin(turn), y - 0.02 * math.cos(turn), z)
    return [
        add(
            f"{name}_frame",
            *box((wide + 0.14, 0.05, high + 0.14)),
            middle,
            (0, 0, turn),
            stripes_of(frame, 0.2, (1, 0, 1)),
        ),
        add(name, *box((wide, 0.05, high)), off, (0, 0, turn), pattern),
    ]


def books(name, corner, length, shelves, yaw, palettes):
    """A bookcase along x before turning, with a row of books on each shelf."""
    turn = math.radians(yaw)
    c, s = math.cos(turn), math.sin(turn)
    made = []
    for k in range(shelves):
        height = 0.08 + 0.46 * k
        palette = palettes[k % len(palettes)]
        row = length * (0.94 - 0.13 * (k % 3))
        for part, size, along, up, pattern in (
            ("shelf", (length, 0.34, 0.05), length / 2, 0.0, stripes_of(WOOD, 0.3)),
            ("row", (row, 0.24, 0.33), row / 2, 0.19, stripes_of(palette, 0.06)),
        ):
            place = (corner[0] + c * along, corner[1] + s * along, height + up)
            made.append(add(f"{name}_{part}_{k}", *box(size), place, (0, 0, turn), pattern))
    return made
