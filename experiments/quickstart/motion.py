"""Throw the bodies: Bullet at 500 Hz, then a key per step, so that any instant can be rendered."""

import bpy
from mathutils import Euler, Quaternion, Vector


RATE = 500  # Bullet steps a second; finer steps lose the bounce
FPS = 20
STEPS = RATE // FPS  # Bullet steps a frame
MARGIN = 2  # frames simulated before the first and after the last
HOLD = 3  # steps during which a body is led at its launch velocity


def bake(fixed, moving, bodies, frames):
    """Simulate, then replace the simulation by keys over frames -MARGIN .. frames - 1 + MARGIN."""
    scene = bpy.context.scene
    last = HOLD + 1 + (frames - 1 + 2 * MARGIN) * STEPS
    start_world(scene, last)
    for thing in fixed:
        collide(thing, "PASSIVE", "MESH", restitution=1.0)
    for thing, body in zip(moving, bodies, strict=True):
        collide(thing, "ACTIVE", "SPHERE" if body.shape == "ball" else "BOX", restitution=0.8)
        thing.rigid_body.mass = body.size**3
        launch(thing, body)
    poses = simulate(scene, moving, last)
    bpy.ops.rigidbody.world_remove()
    for thing in moving:
        thing.animation_data_clear()
        key(thing, poses[thing.name])


def start_world(scene, last):
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    scene.render.fps = RATE
    scene.frame_start, scene.frame_end = 1, last
    bpy.ops.rigidbody.world_add()
    world = scene.rigidbody_world
    world.collection = bpy.data.collections.new("rigid_bodies")
    world.substeps_per_frame, world.solver_iterations = 1, 20
    world.point_cache.frame_end = last


def collide(thing, kind, shape, restitution):
    bpy.context.scene.rigidbody_world.collection.objects.link(thing)
    solid = thing.rigid_body
    solid.type, solid.collision_shape = kind, shape
    solid.restitution, solid.friction = restitution, 0.5
    solid.use_margin, solid.collision_margin = True, 0.0
    solid.linear_damping = solid.angular_damping = 0.0


def launch(thing, body):
    """Lead the body for HOLD steps, so that Bullet lets it go with the wanted velocity and spin."""
    thing.rotation_mode = "QUATERNION"
    spin = Vector(body.spin)
    tilt = Euler((0.5, 0.3, 0.2)).to_quaternion()
    for step in range(HOLD + 1):
        seconds = step / RATE
        thing.location = Vector(body.position) + seconds * Vector(body.velocity)
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
    scene.render.fps = FPS
    return poses


def key(thing, poses):
    thing.rotation_mode = "QUATERNION"
    previous = poses[0].to_quaternion()
    for step, pose in enumerate(poses):
        turn = pose.to_quaternion()
        turn.make_compatible(previous)
        thing.location, thing.rotation_quaternion = pose.translation, turn
        for path in ("location", "rotation_quaternion"):
            thing.keyframe_insert(path, frame=step / STEPS - MARGIN)
        previous = turn
