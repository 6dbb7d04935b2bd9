"""Things of a scene: meshes in metres around their own origin, and lamps."""

import math

import bpy
from mathutils import Vector

from experiments.blender.paint import material


def add(name, vertices, faces, position, rotation, pattern):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(material(name, pattern))
    made = bpy.data.objects.new(name, mesh)
    made.location, made.rotation_euler = position, rotation
    bpy.context.collection.objects.link(made)
    return made


def plane(name, size, position, rotation, pattern):
    x, y = size[0] / 2, size[1] / 2
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    return add(name, corners, [(0, 1, 2, 3)], position, rotation, pattern)


def box(size):
    x, y, z = (side / 2 for side in size)
    corners = [(i * x, j * y, k * z) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
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
