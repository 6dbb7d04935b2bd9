"""Scenes at the ends of what numbers can express, as the float32 numbers the tracer is given."""

import jax
import numpy as np
from scenes import COUNT, RAYS, Lines, gaussians, padded, rays


def aimed(mean, size, *, distance=3.0, seed=1, direction=None):
    """One ray for every Gaussian in turn, passing it within about its size."""
    r = np.random.default_rng(seed)
    turn = np.arange(RAYS) % len(mean)
    if direction is None:
        direction = r.normal(size=(RAYS, 3))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    distance = np.broadcast_to(distance, len(mean))[turn, None]
    target = mean[turn] + np.broadcast_to(size, len(mean))[turn, None] * r.normal(size=(RAYS, 3))
    return Lines(target - distance * direction, direction, np.zeros(RAYS))


def scales():
    """Scales from 1e-6 to 1e4, each seen from a thousand times its size and from at most 3."""
    g = gaussians(60, seed=3)
    size = np.geomspace(1e-6, 1e4, 60)
    shape = g.scale / np.max(g.scale, axis=-1, keepdims=True)
    g = g._replace(scale=size[:, None] * shape, opacity=0.3 * g.opacity)
    return g, aimed(g.mean, np.minimum(size, 1) * 0.3, distance=np.minimum(3, 1e3 * size))


def anisotropy(ratio=1e6):
    """Discs and needles a million times as wide as thin, seen from every side."""
    g = gaussians(60, seed=4)
    shapes = np.array([[1, 1, 1 / ratio], [1, 1 / ratio, 1 / ratio], [1, ratio**-0.5, 1 / ratio]])
    g = g._replace(scale=0.3 * np.tile(shapes, (20, 1)), opacity=0.5 * g.opacity)
    return g, aimed(g.mean, 0.0)


def upright(ratio=1e6):
    """The same with axes along the world's, where the rotation itself has no rounding."""
    g, r = anisotropy(ratio)
    return g._replace(quat=np.tile([1.0, 0, 0, 0], (60, 1))), r


def far_together():
    """Scene and rays 1e5 away from the origin; what float32 keeps of them is the scene."""
    g = gaussians(64, seed=5, size=(0.1, 0.5), around=(1e5, -1e5, 1e5))
    return g, rays(place=(1e5, -1e5, 1e5 - 3))


def far_apart():
    """Gaussians 1e5 away from the camera, of scales 100 and more."""
    g = gaussians(64, seed=6, size=(300, 1e4), spread=2e4, around=(0, 0, 1e5))
    return g, rays(place=(0, 0, 0), spread=0.15)


def inside():
    """The camera inside of many Gaussians; those whose peak lies behind it are not seen."""
    g = gaussians(64, seed=7, size=(0.3, 3), spread=0.5)
    return g, rays(place=(0, 0, 0), jitter=0.1, spread=3)


def grazing():
    """Rays in the plane of discs, along needles, and tangent to where alpha is cut off."""
    g = gaussians(60, seed=8)
    shape = np.tile([[0.5, 0.5, 1e-3], [0.5, 1e-3, 1e-3], [0.2, 0.2, 0.2]], (20, 1))
    quat = np.tile([1.0, 0, 0, 0], (60, 1))
    g = g._replace(quat=quat, scale=shape, opacity=0.5 * g.opacity)
    r = aimed(g.mean, 0.0, direction=np.tile([1.0, 0, 0], (RAYS, 1)))
    turn = np.arange(RAYS) % 60
    reach = np.sqrt(2 * np.log(g.opacity * 255))[turn] * shape[turn, 2]
    share = np.random.default_rng(9).choice([0, 0.5, 0.99, 1.01], RAYS)
    return g, Lines(r.origin + (share * reach)[:, None] * np.array([0, 0, 1]), r.direction, r.time)


def quaternions():
    """Quaternions of length 1e-30 to 1e30, and zero, which is the identity."""
    g = gaussians(64, seed=10, size=(0.05, 0.5))
    length = np.geomspace(1e-30, 1e30, 64) * (np.arange(64) % 16 != 5)
    return g._replace(quat=g.quat * length[:, None]), rays()


def opacities():
    """Opacities of exactly 0 and 1, and at both cuts."""
    g = gaussians(64, seed=11, size=(0.05, 0.5))
    opacity = np.tile([0, 1, 1 / 255, 0.99], 16)
    return g._replace(opacity=opacity), rays()


def one_cell():
    """Sixty Gaussians in one cell of the grid, and one a thousand units away."""
    g = gaussians(60, seed=12, size=(1e-3, 1e-2), spread=1e-3)
    g.mean[-1] = 1e3
    return g, aimed(g.mean, 1e-3)


def huge_among_tiny():
    """One Gaussian of a thousand units among dust."""
    g = gaussians(60, seed=13, size=(1e-3, 3e-3))
    g.scale[0] = 1e3
    g.opacity[0] = 0.5
    return g, aimed(g.mean, 1e-3)


def one():
    """A single Gaussian."""
    g = gaussians(1, seed=14, size=(0.3, 0.5))
    return g, rays()


SCENES = {
    f.__name__: f
    for f in (
        scales,
        anisotropy,
        upright,
        far_together,
        far_apart,
        inside,
        grazing,
        quaternions,
        opacities,
        one_cell,
        huge_among_tiny,
        one,
    )
}


def scene(name):
    """Gaussians and rays in float32, in the common structure."""
    g, r = anisotropy(300) if name == "mild_anisotropy" else SCENES[name]()
    return jax.tree.map(lambda x: np.asarray(x, np.float32), (padded(g, COUNT), r))
