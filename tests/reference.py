"""Brute force in float64 numpy: every Gaussian on every ray, fully sorted. Independent of the tracer.

Positions and the kernel are evaluated in the Gaussian's own frame by the textbook formula; colours by
the harmonics written out once more from their definition by Legendre polynomials is left to their own
test, here degree 0 and 1 suffice.
"""

import numpy as np


def rotation(quat):
    """Rotation matrices of (w, x, y, z) quaternions by the sandwich product."""
    q = np.asarray(quat, np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., :1], q[..., 1:]
    columns = []
    for axis in np.eye(3):
        cross = np.cross(v, axis)
        columns.append(axis + 2 * w * cross + 2 * np.cross(v, cross))
    return np.stack(columns, axis=-1)


def hits(mean, quat, scale, opacity, origin, direction, alpha_min=1 / 255, alpha_max=0.99):
    """t and alpha of every (ray, Gaussian) pair; alpha = 0 where there is no hit."""
    mean, scale, opacity = (np.asarray(x, np.float64) for x in (mean, scale, opacity))
    origin, direction = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    frame = np.swapaxes(rotation(quat), -1, -2) / scale[:, :, None]
    with np.errstate(all="ignore"):
        o = np.einsum("nij,rnj->rni", frame, origin[:, None] - mean[None])
        d = np.einsum("nij,rj->rni", frame, direction)
        square = np.sum(d * d, axis=-1)
        t = -np.sum(o * d, axis=-1) / square
        q = np.sum(np.cross(o, d) ** 2, axis=-1) / square
        raw = opacity * np.exp(-0.5 * q)
    met = (t > 0) & (raw > alpha_min) & np.isfinite(q)
    return np.where(met, t, np.inf), np.where(met, np.minimum(raw, alpha_max), 0.0)


def trace(gaussians, origin, direction, **options):
    """Colour, transmittance and depth of every ray."""
    mean, quat, scale, opacity, harmonics = (
        np.asarray(x, np.float64)
        for x in (
            gaussians.mean,
            gaussians.quat,
            gaussians.scale,
            gaussians.opacity,
            gaussians.harmonics,
        )
    )
    direction = np.asarray(direction, np.float64)
    t, alpha = hits(mean, quat, scale, opacity, origin, direction, **options)
    order = np.argsort(t, axis=1, kind="stable")
    t, alpha = np.take_along_axis(t, order, 1), np.take_along_axis(alpha, order, 1)
    light = 0.28209479177387814 * harmonics[None, :, 0] + 0.5
    if harmonics.shape[1] > 1:
        x, y, z = (direction[:, i, None, None] for i in range(3))
        c = 0.4886025119029199
        light = light + c * (-y * harmonics[:, 1] + z * harmonics[:, 2] - x * harmonics[:, 3])
    light = np.broadcast_to(np.maximum(light, 0), (*t.shape, 3))
    light = np.take_along_axis(light, order[..., None], 1)
    clear = np.cumprod(1 - alpha, axis=1)
    front = np.concatenate([np.ones_like(clear[:, :1]), clear[:, :-1]], axis=1)
    weight = alpha * front
    depth = np.sum(weight * np.where(alpha > 0, t, 0), axis=1)
    end = clear[:, -1] if t.shape[1] else np.ones(len(direction))
    return np.sum(weight[..., None] * light, axis=1), end, depth
