"""Things of a scene: meshes in metres around their own origin, and lamps."""

import math

import bpy
from mathutils import Vector

from experiments.blender.paint import material


def add(name, vertices, faces, position, rotation, pattern, *, smooth=False, **finish):
    """A mesh object in its paint; `finish` is what `paint.material` takes beside the pattern."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(material(name, pattern, **finish))
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    made = bpy.data.objects.new(name, mesh)
    made.location, made.rotation_euler = position, rotation
    bpy.context.collection.objects.link(made)
    return made


def plane(name, size, position, rotation, pattern, **finish):
    x, y = size[0] / 2, size[1] / 2
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    return add(name, corners, [(0, 1, 2, 3)], position, rotation, pattern, **finish)


def box(size):
    x, y, z = (side / 2 for side in size)
    corners = [(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, faces


def lathe(profile, sectors=32):
    """A surface of revolution about z of the (radius, height) points, lowest first; ends at radius
    0 are closed."""
    corners, faces, rings = [], [], []
    for radius, height in profile:
        count = sectors if radius > 0 else 1
        rings.append(list(range(len(corners), len(corners) + count)))
        for k in range(count):
            turn = 2 * math.pi * k / sectors
            corners.append((radius * math.cos(turn), radius * math.sin(turn), height))
    for low, high in zip(rings, rings[1:], strict=False):
        for k in range(sectors):
            n = (k + 1) % sectors
            if len(low) == 1 and len(high) > 1:
                faces.append((low[0], high[n], high[k]))
            elif len(high) == 1 and len(low) > 1:
                faces.append((low[k], low[n], high[0]))
            elif len(low) > 1:
                faces.append((low[k], low[n], high[n], high[k]))
    return corners, faces


def cylinder(radius, height, sectors=32):
    """Closed, about z, centred."""
    low, high = -height / 2, height / 2
    return lathe([(0, low), (radius, low), (radius, high), (0, high)], sectors)


def ring(radius, thickness, sectors=48, sides=12):
    """A torus about z: `radius` to the middle of the tube, which is `thickness` in radius."""
    corners, faces = [], []
    for k in range(sectors):
        turn = 2 * math.pi * k / sectors
        for j in range(sides):
            roll = 2 * math.pi * j / sides
            out = radius + thickness * math.cos(roll)
            up = thickness * math.sin(roll)
            corners.append((out * math.cos(turn), out * math.sin(turn), up))
            a, b = k * sides, (k + 1) % sectors * sides
            n = (j + 1) % sides
            faces.append((a + j, b + j, b + n, a + n))
    return corners, faces


def ball(radius, rings=24, sectors=48):
    corners = [(0, 0, radius), (0, 0, -radius)]
    for ring in range(1, rings):
        height, width = math.cos(math.pi * ring / rings), math.sin(math.pi * ring / rings)
        for sector in range(sectors):
            turn = 2 * math.pi * sector / sectors
            spot = Vector((width * math.cos(turn), width * math.sin(turn), height))
            corners.append(tuple(radius * spot))
    first, last = 2, 2 + (rings - 2) * sectors
    faces = []
    for s in range(sectors):
        n = (s + 1) % sectors
        faces += [(0, first + s, first + n), (1, last + n, last + s)]
        for start in range(first, last, sectors):
            faces.append((start + s, start + sectors + s, start + sectors + n, start + n))
    return corners, faces


def lamp(name, power, position, rotation, colour, side=1.6):
    data = bpy.data.lights.new(name, "AREA")
    data.energy, data.color, data.shape, data.size = power, colour, "SQUARE", side
    lit = bpy.data.objects.new(name, data)
    lit.location, lit.rotation_euler, lit.visible_camera = position, rotation, False
    bpy.context.collection.objects.link(lit)


def pivot(name, position, parent=None):
    """An invisible point that others hang on."""
    made = bpy.data.objects.new(name, None)
    made.location, made.parent = position, parent
    bpy.context.collection.objects.link(made)
    return made


def animate(thing, path, keys, interpolation="BEZIER"):
    """Key a property: frame -> value."""
    for frame, value in keys.items():
        setattr(thing, path, value)
        thing.keyframe_insert(path, frame=frame)
    for curve in thing.animation_data.action.fcurves:
        if curve.data_path == path:
            for point in curve.keyframe_points:
                point.interpolation = interpolation


def joined(parts):
    """One mesh of several, each moved by an offset: (mesh, offset) pairs."""
    corners, faces = [], []
    for (some, polygons), offset in parts:
        faces += [tuple(len(corners) + k for k in polygon) for polygon in polygons]
        corners += [tuple(Vector(corner) + Vector(offset)) for corner in some]
    return corners, faces


def shell(size, patterns, **finish):
    """Floor, ceiling and four walls about the origin, facing inwards, in the paint of `patterns`
    by name; `finish` is that of the floor."""
    wide, deep, high = size
    right = math.pi / 2
    sides = {
        "floor": ((wide, deep), (0, 0, 0), (0, 0, 0)),
        "ceiling": ((wide, deep), (0, 0, high), (math.pi, 0, 0)),
        "north": ((wide, high), (0, deep / 2, high / 2), (right, 0, 0)),
        "south": ((wide, high), (0, -deep / 2, high / 2), (right, 0, math.pi)),
        "east": ((deep, high), (wide / 2, 0, high / 2), (right, 0, -right)),
        "west": ((deep, high), (-wide / 2, 0, high / 2), (right, 0, right)),
    }
    return [
        plane(name, *place, patterns[name], **(finish if name == "floor" else {}))
        for name, place in sides.items()
    ]


def hung(carrier, name, mesh, place, rotation, pattern, **finish):
    """A mesh object that follows `carrier`, within which its place and rotation are."""
    made = add(name, *mesh, place, rotation, pattern, **finish)
    made.parent = carrier
    return made
