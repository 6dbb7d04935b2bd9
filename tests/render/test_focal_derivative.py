"""What parts a picture's derivative from difference quotients: changes of the hits, nothing else."""

import jax
import jax.numpy as jnp
import numpy as np
from dense import dense_scene

import gaussray
from gaussray.camera.camera import camera_rays
from gaussray.camera.film import pixel_grid
from gaussray.tracer.line import line_hits


FOCAL, SIDE = 24.0, 16
TRACE = gaussray.TraceOptions(levels=0, group=2)
# Of a smooth function in double precision: rounding divided by the step, and the step squared.
SMOOTH = 1e-4


def camera(focal):
    return gaussray.Camera(
        gaussray.Film(SIDE, SIDE, "center"),
        gaussray.Pinhole(focal, (SIDE / 2, SIDE / 2)),
        trajectory=gaussray.look_at((0, -4, 1)),
    )


def hits(scene, focal):
    """The Gaussians on every ray in the order of their distances, up to where the ray ends."""
    pixel = pixel_grid(camera(focal).film).reshape(-1, 2)
    rays = camera_rays(camera(focal), pixel, jnp.full((len(pixel), 5), 0.5))
    both = jax.jit(jax.vmap(lambda o, d: line_hits(scene.static, o, d, options=TRACE)))
    sequences = []
    for t, alpha in zip(*map(np.asarray, both(rays.origin, rays.direction)), strict=True):
        met = np.flatnonzero(alpha)
        met = met[np.argsort(t[met])]
        front = np.concatenate([[1.0], np.cumprod(1 - alpha[met])[:-1]])
        sequences.append(tuple(met[front > TRACE.transmittance_min]))
    return sequences


def test_difference_quotients_differ_where_hits_change_and_nowhere_else():
    scene = dense_scene(60, seed=1)
    options = gaussray.RenderOptions(samples=1)
    plan = gaussray.plan(scene, camera(FOCAL), options=options, trace=TRACE)
    other = gaussray.render(scene, camera(1.03 * FOCAL), plan=plan).color

    @jax.jit
    @jax.value_and_grad
    def loss(focal):
        return jnp.mean((gaussray.render(scene, camera(focal), plan=plan).color - other) ** 2)

    slope = float(loss(FOCAL)[1])
    same, changed = [], []
    for step in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        ends = [FOCAL * (1 - step), FOCAL * (1 + step)]
        low, high = (float(loss(focal)[0]) for focal in ends)
        off = abs((high - low) / (ends[1] - ends[0]) / slope - 1)
        before, after = (hits(scene, focal) for focal in ends)
        (same if before == after else changed).append(off)
    assert same and max(same) < SMOOTH
    assert changed and min(changed) > 10 * SMOOTH
