"""One lens of every kind, for pictures of any size; most see behind the camera."""

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.lens import (
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FTheta,
    Pinhole,
    ThinPrismFisheye,
    UnifiedSphere,
    limit_of_angle,
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
            scale, center, jnp.array(k), number(limit_of_angle(k, HALF["angle_of_radius"], "")),
        ),
        "sphere": Equirectangular(size * jnp.array([0.5, 1.0]), size / 2),
        "part_of_the_sphere": Equirectangular(size * jnp.array([0.7, 1.4]), center),
    }  # fmt: skip
    # A sample in the middle of every cell; dark ones where the lens is.
    rows, columns = 25, 37
    column, row = jnp.meshgrid(jnp.arange(columns) + 0.5, jnp.arange(rows) + 0.5)
    share = jnp.stack([column / columns, row / rows], -1)
    rays = _look(lenses["thin_prism_fisheye"], share * size[None, None])
    lenses["table"] = ray_table(rays, width, height)
    # Of no weak type, which would be a program of its own.
    return jax.tree.map(lambda x: jnp.asarray(x, x.dtype), lenses)


@jax.jit
def _look(lens, pixels):
    return jax.vmap(jax.vmap(lens.direction))(pixels)


@jax.jit
def sloped(lens, pixels, points, way):
    """What `direction` and `project` give at every pixel and point, and both kinds of derivative,
    in one program: along a `way` of lens, pixels and points, and of the sum of x + 2 y + 3 z
    (column + 2 row) with respect to the lens and each pixel (point)."""

    def one(look, x, to):
        value, push = jax.linearize(look, lens, x)
        weight = jnp.arange(1.0, len(value) + 1).astype(value.dtype)
        return value, push(way[0], to), jax.linear_transpose(push, lens, x)(weight)

    return (
        jax.vmap(lambda x, to: one(lambda lens, x: lens.direction(x), x, to))(pixels, way[1]),
        jax.vmap(lambda x, to: one(lambda lens, x: lens.project(x), x, to))(points, way[2]),
    )


def any_way(lens, pixels, points, seed=0):
    """A random way to go in every number of a lens, and of pixels and points."""
    draw = np.random.default_rng(seed)
    return jax.tree.map(lambda x: jnp.asarray(draw.normal(size=x.shape)), (lens, pixels, points))


def moved(parts, way, step):
    """Lens, pixels and points some way off."""
    return jax.tree.map(lambda x, to: x + step * to, parts, way)


def assert_slopes(found, before, after, way, step, rows, **tolerance):
    """Both kinds of derivative agree with each other wherever there is a value, and with central
    differences in the first rows."""
    value, along, back = jax.tree.map(np.asarray, found)
    lens, other = way
    weight = np.arange(1.0, value.shape[1] + 1)
    pulled = [
        (slope * np.asarray(to)[None]).reshape(len(value), -1).sum(axis=1)
        for slope, to in zip(jax.tree.leaves(back[0]), jax.tree.leaves(lens), strict=True)
    ]
    pulled.append(np.sum(back[1] * other, axis=1))
    scale = np.sum(np.abs(pulled), axis=0) + 1
    seen = np.isfinite(value).all(axis=1)
    differ = (np.sum(pulled, axis=0) - along @ weight) / scale
    np.testing.assert_allclose(differ[seen], 0, atol=1e-9)
    difference = (np.asarray(after[0]) - np.asarray(before[0])) / (2 * step)
    np.testing.assert_allclose(along[:rows], difference[:rows], **tolerance)
