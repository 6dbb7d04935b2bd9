"""Many large Gaussians in one another's way, and a picture of them whose order of hits is fixed."""

import jax
import jax.numpy as jnp
import numpy as np

import gaussray
from gaussray.camera.camera import camera_rays
from gaussray.camera.film import pixel_grid
from gaussray.scene.gaussians import whitening_matrix


_rays = jax.jit(camera_rays)


def dense_scene(count: int, seed: int) -> gaussray.Scene:
    """Opaque, long Gaussians of all colours in a cube of side 2."""
    rng = np.random.default_rng(seed)
    return gaussray.Scene(
        gaussray.Gaussians.colored(
            rng.uniform(-1, 1, (count, 3)),
            rng.uniform(0, 1, (count, 3)),
            scale=rng.uniform(0.1, 0.5, (count, 3)),
            opacity=rng.uniform(0.5, 0.95, count),
            quat=rng.normal(size=(count, 4)),
        )
    )


def frozen_picture(scene, camera):
    """A function of a camera: colours of all its pixels, every Gaussian composited in the order in
    which the rays of this `camera` meet them."""
    g = scene.static
    color = 0.5 + 0.28209479177387814 * np.asarray(g.harmonics[:, 0])
    white = np.asarray(whitening_matrix(g.quat, g.scale))

    def responses(camera):
        pixel = pixel_grid(camera.film).reshape(-1, 2)
        rays = _rays(camera, pixel, jnp.full((len(pixel), 5), 0.5))
        origin, direction = (np.asarray(x) for x in (rays.origin, rays.direction))
        o = np.einsum("gij,rgj->rgi", white, origin[:, None] - np.asarray(g.mean)[None])
        d = np.einsum("gij,rj->rgi", white, direction)
        t = -np.sum(o * d, -1) / np.sum(d * d, -1)
        alpha = np.asarray(g.opacity) * np.exp(-0.5 * np.sum((o + t[..., None] * d) ** 2, -1))
        return t, np.where(t > 0, np.minimum(alpha, 0.99), 0)

    order = np.argsort(responses(camera)[0], axis=1)

    def picture(camera):
        alpha = np.take_along_axis(responses(camera)[1], order, axis=1)
        clear = np.cumprod(1 - alpha, axis=1)
        weight = alpha * np.concatenate([np.ones_like(clear[:, :1]), clear[:, :-1]], axis=1)
        return np.einsum("rg,rgc->rc", weight, color[order])

    return picture
