"""Soft things: meshes whose vertices are a function of time, in paint that moves with them."""

from typing import Any, NamedTuple, Protocol

import numpy as np

from experiments.blender.paint import node
from experiments.blender.shapes import add


REST = "rest"  # the attribute that holds the places of the vertices before any deformation


class Shape(Protocol):
    """Vertices (n, 3) in the world at a time from 0 to 1."""

    def __call__(self, time: float) -> np.ndarray: ...


class Soft(NamedTuple):
    """A mesh object and its shape."""

    thing: Any
    shape: Shape

    def pose(self, time):
        """Move the vertices to where they are at a time."""
        mesh = self.thing.data
        mesh.vertices.foreach_set("co", np.asarray(self.shape(time), np.float32).ravel())
        mesh.update()
        self.thing.update_tag(refresh={"DATA"})


def soft(name, rest, faces, shape, pattern, **finish):
    """A soft thing whose pattern lies on its vertices as they are at `rest` (n, 3)."""
    thing = add(name, rest, faces, (0, 0, 0), (0, 0, 0), pattern, smooth=True, **finish)
    stored = thing.data.attributes.new(REST, "FLOAT_VECTOR", "POINT")
    stored.data.foreach_set("vector", np.asarray(rest, np.float32).ravel())
    bind(thing.data.materials[0])
    made = Soft(thing, shape)
    made.pose(0.0)
    return made


def bind(painted):
    """Let the pattern of a material follow the attribute REST instead of the place."""
    tree = painted.node_tree
    rest = node(tree, "ShaderNodeAttribute", {}, attribute_name=REST).outputs["Vector"]
    place = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeTexCoord").outputs["Object"]
    for link in list(place.links):
        tree.links.new(rest, link.to_socket)


def sheet(columns, rows):
    """(u, v) of the vertices of a unit square, row by row, and its faces."""
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    corner = np.arange(columns * (rows - 1)).reshape(rows - 1, columns)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + columns + 1, corner + columns], axis=1)
    return np.stack([u.ravel(), v.ravel()], axis=1), faces.tolist()


def tube_faces(rings, sectors):
    """Faces of a closed tube of rings of vertices, with a last vertex at either end."""
    ring, k = np.meshgrid(np.arange(rings - 1), np.arange(sectors), indexing="ij")
    a, b = (ring * sectors + k).ravel(), (ring * sectors + (k + 1) % sectors).ravel()
    faces = np.stack([a, b, b + sectors, a + sectors], axis=1).tolist()
    first, last, top = rings * sectors, rings * sectors + 1, (rings - 1) * sectors
    for k in range(sectors):
        n = (k + 1) % sectors
        faces += [(first, n, k), (last, top + k, top + n)]
    return faces


def tube(centres, sideways, radii, sectors):
    """Vertices of a closed tube about `centres` (n, 3): `radii` (n, 2) across, along `sideways`
    and at right angles to it."""
    along = np.gradient(centres, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = sideways - along * (along @ sideways)[:, None]
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    turn = 2 * np.pi * np.arange(sectors) / sectors
    rings = (
        centres[:, None]
        + radii[:, :1, None] * np.cos(turn)[:, None] * side[:, None]
        + radii[:, 1:, None] * np.sin(turn)[:, None] * other[:, None]
    )
    return np.concatenate([rings.reshape(-1, 3), centres[:1], centres[-1:]])
