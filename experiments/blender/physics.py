"""Throw bodies: Bullet at 500 Hz, then a key per step, so that any instant can be rendered."""

from typing import Any, NamedTuple

import bpy
from mathutils import Euler, Quaternion, Vector


RATE = 500  # Bullet steps a second; finer steps lose the bounce
HOLD = 3  # steps during which a body is led at its launch velocity
TILT = (0.5, 0.3, 0.2)  # how a body lies in the hand


class Thrown(NamedTuple):
    """An object where it starts, its collision shape (SPHERE, BOX, ...), and how it is thrown:
    metres per second, radians per second."""

    thing: Any
    shape: str
    mass: float
    velocity: tuple[float, float, float]
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tilt: tuple[float, float, float] = TILT
    restitution: float = 0.8
    friction: float = 0.5
    drag: float = 0.0  # share of the speed that is lost in a second


def bake(fixed, thrown, frames, *, fps, margin):
    """Simulate, then replace the simulation by keys over frames -margin .. frames - 1 + margin.

    Force fields of the scene act. Bodies are thrown at frame -margin.
    """
    scene, steps = bpy.context.scene, RATE // fps
    last = HOLD + 1 + (frames - 1 + 2 * margin) * steps
    start_world(scene, last)
    for thing in fixed:
        collide(thing, "PASSIVE", "MESH", restitution=1.0, friction=0.5)
    for body in thrown:
        collide(body.thing, "ACTIVE", body.shape, body.restitution, body.friction)
        body.thing.rigid_body.mass = body.mass
        body.thing.rigid_body.linear_damping = body.thing.rigid_body.angular_damping = body.drag
        launch(body)
    moving = [body.thing for body in thrown]
    poses = simulate(scene, moving, last)
    scene.render.fps = fps
    bpy.ops.rigidbody.world_remove()
    for thing in moving:
        thing.animation_data_clear()
        key(thing, poses[thing.name], steps, margin)


def start_world(scene, last):
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    scene.render.fps = RATE
    scene.frame_start, scene.frame_end = 1, last
    bpy.ops.rigidbody.world_add()
    world = scene.rigidbody_world
    world.collection = bpy.data.collections.new("rigid_bodies")
    world.substeps_per_frame, world.solver_iterations = 1, 20
    world.point_cache.frame_end = last


def collide(thing, kind, shape, restitution, friction):
    bpy.context.scene.rigidbody_world.collection.objects.link(thing)
    solid = thing.rigid_body
    solid.type, solid.collision_shape = kind, shape
    solid.restitution, solid.friction = restitution, friction
    solid.use_margin, solid.collision_margin = True, 0.0
    solid.linear_damping = solid.angular_damping = 0.0


def launch(body):
    """Lead the body for HOLD steps, so that Bullet lets it go with the wanted velocity and spin."""
    thing, spin, start = body.thing, Vector(body.spin), body.thing.location.copy()
    thing.rotation_mode = "QUATERNION"
    tilt = Euler(body.tilt).to_quaternion()
    for step in range(HOLD + 1):
        seconds = step / RATE
        thing.location = start + seconds * Vector(body.velocity)
        thing.rotation_quaternion = Quaternion(spin, spin.length * seconds) @ tilt
        thing.rigid_body.kinematic = step < HOLD
        for path in ("location", "rotation_quaternion", "rigid_body.kinematic"):
            thing.keyframe_insert(path, frame=1 + step)


def simulate(scene, moving, last):
    poses = {thing.name: [] for thing in moving}
    for step in range(1, last + 1):
        scene.frame_set(step)
        if step <= HOLD:
            continue
        for thing in moving:
            poses[thing.name].append(thing.matrix_world.copy())
    return poses


def key(thing, poses, steps, margin):
    """A key per pose, `steps` of them a frame, from frame -margin."""
    thing.rotation_mode = "QUATERNION"
    previous = poses[0].to_quaternion()
    for step, pose in enumerate(poses):
        turn = pose.to_quaternion()
        turn.make_compatible(previous)
        thing.location, thing.rotation_quaternion = pose.translation, turn
        for path in ("location", "rotation_quaternion"):
            thing.keyframe_insert(path, frame=step / steps - margin)
        previous = turn
