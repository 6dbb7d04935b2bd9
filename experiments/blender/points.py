"""The starting points: surfaces at the first frame, coloured by the cameras that see them."""

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree


def sample(groups, views, focal, rng):
    """(points, colours) of groups of objects, uniform by area: [(objects, number of points), ...].

    `views` are (world_from_camera, image) of the first frame; a point that none sees is dropped.
    """
    bpy.context.scene.frame_set(0)
    things = {thing.name: thing for some, _ in groups for thing in some}
    meshes = {name: world_triangles(thing) for name, thing in things.items()}
    solid = BVHTree.FromPolygons(*soup(meshes.values()))
    found = [
        seen([meshes[thing.name] for thing in some], count, solid, views, focal, rng)
        for some, count in groups
    ]
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def world_triangles(thing):
    """Triangle corners (n, 3, 3) in the world at the current frame."""
    mesh = thing.data
    mesh.calc_loop_triangles()
    corners = np.empty(len(mesh.vertices) * 3)
    mesh.vertices.foreach_get("co", corners)
    index = np.empty(len(mesh.loop_triangles) * 3, int)
    mesh.loop_triangles.foreach_get("vertices", index)
    pose = np.array(thing.matrix_world)
    return (corners.reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3])[index].reshape(-1, 3, 3)


def soup(meshes):
    corners = np.concatenate(list(meshes)).reshape(-1, 3)
    return corners.tolist(), np.arange(len(corners)).reshape(-1, 3).tolist()


def seen(meshes, count, solid, views, focal, rng):
    """The first `count` random surface points that some view sees."""
    triangles = np.concatenate(meshes)
    points, colours = [], []
    while len(points) < count:
        for point in surface(triangles, count, rng):
            votes = [
                c for c in (look(point, *view, solid, focal) for view in views) if c is not None
            ]
            if votes:
                points.append(point)
                colours.append(np.median(votes, axis=0))
    return np.array(points[:count]), np.array(colours[:count])


def surface(triangles, count, rng):
    """Points uniform by area."""
    edges = triangles[:, 1:] - triangles[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    chosen = rng.choice(len(triangles), count, p=area / area.sum())
    u = rng.random((count, 2))
    u = np.where(u.sum(1, keepdims=True) > 1, 1 - u, u)
    return triangles[chosen, 0] + (u[:, :, None] * edges[chosen]).sum(1)


def look(point, pose, image, solid, focal, slack=1e-3):
    """Colour of the pixel on which the point falls, None if it is outside or hidden."""
    height, width = image.shape[:2]
    x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
    if z > -0.05:
        return None
    column, row = width / 2 - focal * x / z, height / 2 + focal * y / z
    if not (0 <= column < width and 0 <= row < height):
        return None
    ray = point - pose[:3, 3]
    reach = np.linalg.norm(ray)
    if solid.ray_cast(Vector(pose[:3, 3]), Vector(ray / reach), reach - slack)[0] is not None:
        return None
    return image[int(row), int(column)]


def write_ply(path, points, colours):
    """Binary little endian: x y z float, red green blue uchar."""
    kind = np.dtype([(n, "<f4") for n in "xyz"] + [(n, "u1") for n in ("red", "green", "blue")])
    table = np.empty(len(points), kind)
    for k, name in enumerate("xyz"):
        table[name] = points[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        table[name] = np.round(255 * colours[:, k])
    types = {"f": "float", "u": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property {types[kind[name].kind]} {name}" for name in kind.names] + [
        "end_header",
        "",
    ]
    partial = path.with_name(path.name + ".part")
    partial.write_bytes("\n".join(lines).encode() + table.tobytes())
    partial.replace(path)
