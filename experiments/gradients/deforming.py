"""Derivatives of a picture of a scene that deforms, against difference quotients.

    python -m experiments.gradients.deforming [--scene SCENE]

Prints, for each time and each number: the derivative of a random sum over a small picture, two
central difference quotients, and by how much the derivative is off from that of the smaller step
(where they differ, a colour has reached black between them).
"""

import argparse
import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

import gaussray


TIMES = (0.5, 0.37)
STEPS = (1e-8, 1e-7)
SIZE, FOCAL = (12, 8), 12.0
OPTIONS = gaussray.RenderOptions(samples=1)
# No hit is left out, so that none comes or goes.
TRACE = gaussray.TraceOptions(alpha_min=1e-9, transmittance_min=1e-9)


def main() -> None:
    """Print the table of a scene."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", default="sample")
    chosen = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    scene = jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), gaussray.load(chosen.scene))
    weight = np.random.default_rng(0).normal(size=(SIZE[1], SIZE[0], 3))

    def total(scene: gaussray.Scene, time: float, focal: float) -> jax.Array:
        camera = gaussray.Camera(
            SIZE,
            gaussray.Pinhole(focal, (SIZE[0] / 2, SIZE[1] / 2)),
            trajectory=gaussray.look_at((1.8, -1.8, 1.8), (0, 0, 0.8)),
            time=time,
        )
        picture = gaussray.render(scene, camera, options=OPTIONS, trace=TRACE)
        return jnp.sum(weight * picture.color)

    print("| time | by | derivative | quotients | off |\n|---|---|---|---|---|")
    for time in TIMES:
        row(time, "time", lambda t: total(scene, t, FOCAL), time)
        row(time, "focal length", lambda f, t=time: total(scene, t, f), FOCAL)
        for name in ("mean", "quat", "scale", "opacity", "harmonics"):
            along(time, name, lambda s, t=time: total(s, t, FOCAL), scene)


def along(time: float, name: str, total: Callable, scene: gaussray.Scene) -> None:
    """A row of moving Gaussians that change along a random direction."""
    value = getattr(scene.moving, name)
    change = np.random.default_rng(1).normal(size=value.shape)
    change = change * value if name == "scale" else change

    def moved(share: float) -> jax.Array:
        moving = dataclasses.replace(scene.moving, **{name: value + share * change})
        return total(dataclasses.replace(scene, moving=moving))

    row(time, f"moving.{name}", moved, 0.0)


def row(time: float, name: str, function: Callable[[float], jax.Array], place: float) -> None:
    """The derivative of a function beside difference quotients."""
    derivative = float(jax.grad(function)(place))
    quotients = [float(function(place + h) - function(place - h)) / (2 * h) for h in STEPS]
    off = derivative / quotients[0] - 1
    shown = ", ".join(f"{quotient:.4f}" for quotient in quotients)
    print(f"| {time} | {name} | {derivative:.4f} | {shown} | {100 * off:+.1f} % |", flush=True)


if __name__ == "__main__":
    main()
