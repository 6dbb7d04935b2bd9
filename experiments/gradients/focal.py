"""Derivative of a picture's loss by the focal length against finite differences of several steps.

    python -m experiments.gradients.focal [--scene SCENE] [--time TIME]

Prints, for every step: the difference quotient of the whole picture; that with every Gaussian held
in the order in which the rays of the first camera meet it; and that without the limits
`trace.alpha_min` and `trace.transmittance_min`, each relative to the derivative.
"""

import argparse
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import gaussray
from gaussray.camera.camera import camera_rays
from gaussray.camera.film import pixel_grid
from gaussray.io.sample_data import sample
from gaussray.scene.gaussians import Gaussians, fold_tint
from gaussray.scene.harmonics import C0
from gaussray.scene.scene import at
from gaussray.scene.segmented import segment_at
from gaussray.tracer.line import line_hits


# Relative to the focal length: from the rounding of double precision to a pixel at the edge.
STEPS = (1e-8, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
SIZE = (24, 16)
FOCAL = 20.0
# The other picture of the loss is taken with another focal length.
OTHER = 1.03


def main() -> None:
    """Measure cubes of Gaussians and the scene that comes with the package, or another scene."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", help="a fitted scene; default: cubes, and the sample scene")
    parser.add_argument("--time", type=float, default=0.4)
    parser.add_argument("--eye", type=float, nargs=3, default=[2.5, -2.5, 2.0])
    parser.add_argument("--target", type=float, nargs=3, default=[0.0, 0.0, 1.0])
    chosen = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    if chosen.scene:
        path = gaussray.look_at(chosen.eye, chosen.target)
        measure(chosen.scene, still(chosen.scene, chosen.time), path)
        return
    for count, seed in ((60, 1), (400, 1)):
        path = gaussray.look_at((0.0, -4.0, 1.0))
        measure(f"cube of {count} large Gaussians", cube(count, seed), path)
    path = gaussray.look_at(chosen.eye, chosen.target)
    measure("the sample scene", still(str(sample("scene")), chosen.time), path)


def cube(count: int, seed: int) -> Gaussians:
    """Opaque, long Gaussians of all colours in a cube of side 2 (those of the tests)."""
    rng = np.random.default_rng(seed)
    return Gaussians.colored(
        jnp.asarray(rng.uniform(-1, 1, (count, 3))),
        rng.uniform(0, 1, (count, 3)),
        scale=rng.uniform(0.1, 0.5, (count, 3)),
        opacity=rng.uniform(0.5, 0.95, count),
        quat=rng.normal(size=(count, 4)),
    )


def still(file: str, time: float) -> Gaussians:
    """A fitted scene at a time, in double precision, its colours the same from everywhere."""
    part = segment_at(gaussray.load(file), time)
    gaussians = fold_tint(at(part, jnp.asarray(time, part.time_range.dtype)))
    parts = gaussians.mean, gaussians.quat, gaussians.scale, gaussians.opacity
    return Gaussians(*(jnp.asarray(x, jnp.float64) for x in (*parts, gaussians.harmonics[:, :1])))


def measure(name: str, gaussians: Gaussians, path: Any) -> None:
    """Print the derivative and the difference quotients of one scene."""
    scene, options = gaussray.Scene(gaussians), gaussray.RenderOptions(samples=1)

    def camera(focal):
        film = gaussray.Film(*SIZE, "center")
        lens = gaussray.Pinhole(jnp.asarray(focal, jnp.float64), (SIZE[0] / 2, SIZE[1] / 2))
        made = gaussray.Camera(film, lens, trajectory=path)
        return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), made)

    def loss_of(**limits):
        trace = gaussray.TraceOptions(levels=0, backend="array", **limits)
        plan = gaussray.plan(scene, camera(FOCAL), options=options, trace=trace)

        # The scene is an argument: XLA would evaluate a constant one while it compiles.
        @jax.jit
        def picture(scene, focal):
            seen = gaussray.render(scene, camera(focal), plan=plan)
            return seen.color, seen.dropped

        other, dropped = picture(scene, OTHER * FOCAL)
        assert int(dropped) == 0
        return lambda focal: jnp.mean((picture(scene, focal)[0] - other) ** 2)

    free, endless = loss_of(), loss_of(alpha_min=1e-12, transmittance_min=0.0)
    held = held_loss(gaussians, camera)
    slope = float(jax.grad(free)(FOCAL))
    print(f"{name}: {gaussians.count} Gaussians, derivative {slope:.4e}")
    for step in STEPS:
        h = step * FOCAL

        def quotient(loss, h=h):
            return (float(loss(FOCAL + h)) - float(loss(FOCAL - h))) / (2 * h)

        rows = [quotient(loss) / slope - 1 for loss in (free, held)]
        bare = quotient(endless) / float(jax.grad(endless)(FOCAL)) - 1
        print(
            f"  step {step:7.0e}  whole {rows[0]:+8.3%}  order held {rows[1]:+8.3%}  "
            f"no limits {bare:+8.3%}",
            flush=True,
        )


def held_loss(gaussians: Gaussians, camera: Any) -> Any:
    """The same loss with every Gaussian in the order in which the rays of the first camera meet it,
    evaluated without the tracer's lists."""
    trace = gaussray.TraceOptions()
    pixel = pixel_grid(camera(FOCAL).film).reshape(-1, 2)
    u = jnp.full((len(pixel), 5), 0.5)
    color = jnp.maximum(0.5 + C0 * gaussians.harmonics[:, 0], 0)

    def order_of(ray):
        return jnp.argsort(line_hits(gaussians, *ray, options=trace)[0])

    def blended(ray, order):
        alpha = line_hits(gaussians, *ray, options=trace)[1][order]
        front = jnp.concatenate([jnp.ones(1), jnp.cumprod(1 - alpha)[:-1]])
        # The tracer ends a ray behind the hit that leaves less than this.
        front = jnp.where(front > trace.transmittance_min, front, 0)
        return (alpha * front) @ color[order]

    @jax.jit
    def picture(focal, orders):
        rays = camera_rays(camera(focal), pixel, u)
        lines = rays.origin, rays.direction
        return jax.lax.map(lambda both: blended(*both), (lines, orders))

    @jax.jit
    def orders_at(focal):
        rays = camera_rays(camera(focal), pixel, u)
        return jax.lax.map(order_of, (rays.origin, rays.direction))

    other = picture(OTHER * FOCAL, orders_at(OTHER * FOCAL))
    held = orders_at(FOCAL)
    return lambda focal: jnp.mean((picture(focal, held) - other) ** 2)


if __name__ == "__main__":
    main()
