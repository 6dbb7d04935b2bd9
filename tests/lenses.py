"""One lens of every kind, for pictures of any size; most see behind the camera."""

import jax
import jax.numpy as jnp

from gaussray.camera.lens import (
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FTheta,
    Pinhole,
    ThinPrismFisheye,
    UnifiedSphere,
    limit_of,
    ray_table,
)


PRISM = (-0.2, 0.05, 0.002, -0.001, -0.01, 0.01, 0.002, 0.001, 0.01, -0.02, 0.015, 0.01)
TILT = (0.08, -0.05)
HALF = {
    "equidistant": 1.92,
    "equisolid": 1.75,
    "stereographic": 2.1,
    "orthographic": 1.45,
    "unified": 1.8,
    "enhanced": 1.75,
    "double_sphere": 1.9,
    "radius_of_angle": 1.7,
    "angle_of_radius": 1.7,
    "thin_prism_fisheye": 1.6,
}
BENT = (0.05, -0.01, 0.003, -0.002, 0.001, -1e-4, 0.004, -0.003)
# Radii at HALF, in focal lengths, roughly.
RIM = {
    "equidistant": 1.92,
    "equisolid": 1.5351,
    "stereographic": 3.487,
    "orthographic": 0.99271,
    "unified": 1.913,
    "enhanced": 1.890,
    "double_sphere": 2.153,
    "thin_prism_fisheye": 1.7,
}


def number(value):
    return jnp.array(float(value))


def zoo(width, height):
    """Name -> lens; rims are a little wider than the smaller side, axes off the middle."""
    size, short = jnp.array([width, height], float), min(width, height) / 2
    center = size * jnp.array([0.51, 0.48])
    wide = {name: 1.15 * short / rim * jnp.array([1.0, 1.02]) for name, rim in RIM.items()}
    half = {name: number(value) for name, value in HALF.items()}
    k = [0.0, 0.9, 0.02, -0.03, 0.004, 0.001]
    scale = jnp.full(2, 1.15 * short / 1.9)

    def radial(kind, name, *coefficients):
        return kind(wide[name], center, jnp.array(coefficients), half[name])

    lenses = {
        "thin_prism": Pinhole(1.1 * size, center, jnp.array(PRISM)),
        "tilted": Pinhole(1.1 * size, center, jnp.array(PRISM + TILT)),
        **{
            name: Fisheye(wide[name], center, half[name], name)
            for name in ("equidistant", "equisolid", "stereographic", "orthographic")
        },
        "unified": radial(UnifiedSphere, "unified", 0.6, 1.0),
        "enhanced": radial(UnifiedSphere, "enhanced", 0.55, 1.2),
        "double_sphere": radial(DoubleSphere, "double_sphere", -0.2, 0.6),
        "thin_prism_fisheye": radial(ThinPrismFisheye, "thin_prism_fisheye", *BENT),
        "radius_of_angle": FTheta(
            scale, center, jnp.array([0, 1.1, 0.02, -0.01]), half["radius_of_angle"],
            "radius_of_angle",
        ),
        "angle_of_radius": FTheta(
            scale, center, jnp.array(k), number(limit_of(k, HALF["angle_of_radius"], "")),
        ),
        "sphere": Equirectangular(size * jnp.array([0.5, 1.0]), size / 2),
        "part_of_the_sphere": Equirectangular(size * jnp.array([0.7, 1.4]), center),
    }  # fmt: skip
    # A sample in the middle of every cell; dark ones where the lens is.
    rows, columns = 25, 37
    column, row = jnp.meshgrid(jnp.arange(columns) + 0.5, jnp.arange(rows) + 0.5)
    share = jnp.stack([column / columns, row / rows], -1)
    look = jax.jit(jax.vmap(jax.vmap(lenses["thin_prism_fisheye"].direction)))
    lenses["table"] = ray_table(look(share * size[None, None]), width, height)
    return lenses
