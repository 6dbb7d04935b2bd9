"""Brute force in float64: every Gaussian on every ray, fully sorted. Independent of the tracer.

In numpy: the textbook formulas of the kernel, and the real harmonics from Legendre polynomials.
Moving Gaussians have mean, axes F = R S and tint interpolated through their key states by
Lagrange's polynomials, three keys at a time, and F inverted for every ray. Transient ones are moved
and faded for every ray. `dense` is the same once more in jnp for the sake of its gradients.
"""

import jax
import jax.numpy as jnp
import numpy as np
from numpy.polynomial import legendre

from gaussray.scene.harmonics import radiance


ALPHA_MIN, ALPHA_MAX = 1 / 255, 0.99


def rotation(quat):
    """Rotation matrices of quaternions by the sandwich product; zero is the identity."""
    q = np.asarray(quat, np.float64)
    q = np.where(np.any(q != 0, axis=-1, keepdims=True), q, np.eye(4)[0])
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., :1], q[..., 1:]
    columns = []
    for axis in np.eye(3):
        cross = np.cross(v, axis)
        columns.append(axis + 2 * w * cross + 2 * np.cross(v, cross))
    return np.stack(columns, axis=-1)


def harmonic(degree, order, direction):
    """Real spherical harmonic of unit directions, with the Condon-Shortley sign (-1)^order."""
    x, y, z = np.moveaxis(np.asarray(direction, np.float64), -1, 0)
    m = abs(order)
    polynomial = legendre.Legendre.basis(degree).deriv(m) if m else legendre.Legendre.basis(degree)
    ratio = np.prod(np.arange(degree - m + 1, degree + m + 1, dtype=float))
    value = np.sqrt((2 * degree + 1) / (4 * np.pi * ratio)) * polynomial(z)
    # (x + iy)^m = sin(theta)^m e^(i m phi): no angle, so the poles are ordinary.
    power = (x + 1j * y) ** m
    return value * (-1) ** m * (np.sqrt(2) if m else 1) * (power.imag if order < 0 else power.real)


def light(harmonics, direction):
    """Linear colour max(0, 1/2 + sum c_i Y_i) of every Gaussian along every ray (rays x n x 3)."""
    count = harmonics.shape[1]
    pairs = [(degree, m) for degree in range(4) for m in range(-degree, degree + 1)][:count]
    values = np.stack([harmonic(*pair, direction) for pair in pairs], axis=-1)
    return np.maximum(0.5 + np.einsum("rc,ncd->rnd", values, harmonics), 0)


def key_shares(key_time, time, xp=np):
    """Share of every key state at every time (times x keys), some negative: Lagrange's polynomials
    through the three keys of each arc, or through the only two; constant outside."""
    keys = len(key_time)
    time = xp.clip(time, key_time[0], key_time[-1])
    share = [xp.ones_like(time) if keys == 1 else xp.zeros_like(time)] * keys
    arc = min(keys, 3)
    for first in range(0, keys - 1, 2):
        own = range(first, first + arc)
        inside = (time >= key_time[own[0]]) & (time <= key_time[own[-1]])
        for i in own:
            part = xp.ones_like(time)
            for j in own:
                if j != i:
                    part = part * (time - key_time[j]) / (key_time[i] - key_time[j])
            share[i] = xp.where(inside, part, share[i])
    return xp.stack(share, axis=-1)


def frames(motion, time):
    """Whitening matrix and mean of every Gaussian for every ray; one row suffices if all rest."""
    g = motion.gaussians
    mean, scale = (np.asarray(x, np.float64) for x in (g.mean, g.scale))
    turn = rotation(g.quat)
    if len(mean) == 1:
        return np.swapaxes(turn, -1, -2) / scale[..., :, None], mean
    shares = key_shares(np.asarray(motion.time, np.float64), np.asarray(time, np.float64))
    axes = np.einsum("rk,knij->rnij", shares, turn * scale[..., None, :])
    return np.linalg.inv(axes), np.einsum("rk,kni->rni", shares, mean)


def meet(frame, mean, opacity, origin, direction, alpha_min=ALPHA_MIN, alpha_max=ALPHA_MAX):
    """t and alpha of every (ray, Gaussian) pair; t = inf and alpha = 0 where there is no hit."""
    across = "rnij,rnj->rni"
    with np.errstate(all="ignore"):
        o = np.einsum(across, frame, origin[:, None] - mean)
        d = np.einsum(across, frame, direction[:, None])
        square = np.sum(d * d, axis=-1)
        t = -np.sum(o * d, axis=-1) / square
        raw = opacity * np.exp(-0.5 * np.sum(np.cross(o, d) ** 2, axis=-1) / square)
        met = (t > 0) & (raw > alpha_min)
    return np.where(met, t, np.inf), np.where(met, np.minimum(raw, alpha_max), 0.0)


def hits(motion, rays, **options):
    """t and alpha of every (ray, Gaussian) pair of a moving scene, transient Gaussians last."""
    frame, mean = frames(motion, rays.time)
    opacity = np.asarray(motion.gaussians.opacity, np.float64)
    origin, direction = (np.asarray(x, np.float64) for x in (rays.origin, rays.direction))
    t, alpha = meet(frame, mean, opacity, origin, direction, **options)
    if motion.transient is None:
        return t, alpha
    others = meet(*transient_frames(motion, rays.time), origin, direction, **options)
    return tuple(np.concatenate(x, axis=1) for x in zip((t, alpha), others, strict=True))


def transient_frames(motion, time):
    """Whitening matrix, mean and opacity of every transient Gaussian for every ray."""
    x = {k: np.asarray(v, np.float64) for k, v in vars(motion.transient).items()}
    time = np.asarray(time, np.float64)
    if motion.time_range is not None:
        time = np.clip(time, *np.asarray(motion.time_range, np.float64))
    age = time[:, None] - x["instant"]
    flank = np.where(np.abs(age) > x["plateau"], np.abs(age) - x["plateau"], 0) / x["lifetime"]
    frame = np.swapaxes(rotation(x["quat"]), -1, -2) / x["scale"][:, :, None]
    mean = x["mean"] + age[..., None] * x["velocity"]
    return frame[None], mean, x["opacity"] * np.exp(-(flank**2) / 2)


def trace(motion, rays, **options):
    """Colour, transmittance and depth (sum of weight x t) of every ray."""
    t, alpha = hits(motion, rays, **options)
    order = np.argsort(t, axis=1, kind="stable")
    color = light(np.asarray(motion.gaussians.harmonics, np.float64), rays.direction)
    if motion.gaussians.tint is not None:
        shares = key_shares(np.asarray(motion.time, np.float64), np.asarray(rays.time, np.float64))
        color = color * np.einsum("rk,knc->rnc", shares, motion.gaussians.tint)
    if motion.transient is not None:
        harmonics = np.asarray(motion.transient.harmonics, np.float64)
        color = np.concatenate([color, light(harmonics, rays.direction)], axis=1)
    color = np.take_along_axis(color, order[..., None], 1)
    t, alpha = np.take_along_axis(t, order, 1), np.take_along_axis(alpha, order, 1)
    clear = np.cumprod(np.concatenate([np.ones((len(t), 1)), 1 - alpha], axis=1), axis=1)
    weight = alpha * clear[:, :-1]
    depth = np.sum(weight * np.where(alpha > 0, t, 0), axis=1)
    return np.sum(weight[..., None] * color, axis=1), clear[:, -1], depth


def dense(motion, rays, alpha_min=ALPHA_MIN, alpha_max=ALPHA_MAX):
    """`trace` in plain jnp, differentiable by JAX alone: (colour, transmittance, depth)."""
    g, turn = motion.gaussians, _turns(motion.gaussians.quat)

    def one(ray):
        direction = jnp.where(jnp.any(ray.direction != 0), ray.direction, jnp.ones(3))
        t, raw, met = _met(motion, turn, ray, alpha_min)
        order = jnp.argsort(jax.lax.stop_gradient(jnp.where(met, t, jnp.inf)))
        alpha = jnp.where(met, jnp.minimum(raw, alpha_max), 0)[order]
        clear = jnp.cumprod(jnp.concatenate([jnp.ones(1), 1 - alpha]))
        weight = alpha * clear[:-1]
        color = radiance(jnp.moveaxis(g.harmonics, 0, -1), direction[:, None]).T
        if g.tint is not None:
            color = color * jnp.einsum("k,knc->nc", key_shares(motion.time, ray.time, jnp), g.tint)
        if motion.transient is not None:
            harmonics = jnp.moveaxis(motion.transient.harmonics, 0, -1)
            color = jnp.concatenate([color, radiance(harmonics, direction[:, None]).T])
        color = color[order]
        return weight @ color, clear[-1], weight @ t[order]

    return jax.lax.map(one, rays, batch_size=16)


def met(motion, rays, alpha_min=ALPHA_MIN):
    """Which Gaussians any of the rays meets."""
    turn = _turns(motion.gaussians.quat)

    def look(seen, ray):
        return seen | _met(motion, turn, ray, alpha_min)[2], None

    transient = 0 if motion.transient is None else motion.transient.count
    none = jnp.zeros(motion.gaussians.count + transient, bool)
    return jax.lax.scan(look, none, rays)[0]


def _turns(quat):
    q = jnp.where(jnp.any(quat != 0, axis=-1, keepdims=True), quat, jnp.eye(4)[None, :1])
    q = q / jnp.sqrt(jnp.sum(q * q, axis=-1, keepdims=True))
    w, v = q[..., :1], q[..., 1:]
    turn = []
    for axis in jnp.eye(3):
        cross = jnp.cross(v, jnp.broadcast_to(axis, v.shape))
        turn.append(jnp.broadcast_to(axis, v.shape) + 2 * w * cross + 2 * jnp.cross(v, cross))
    return jnp.stack(turn, axis=-1)


def _met(motion, turn, ray, alpha_min):
    """Distance, opacity on the ray, and whether it counts, of every Gaussian."""
    g = motion.gaussians
    if len(motion.time) == 1:
        mean, frame = g.mean[0], jnp.swapaxes(turn[0], -1, -2) / g.scale[0][:, :, None]
    else:
        shares = key_shares(motion.time, ray.time, jnp)
        mean = jnp.einsum("k,kni->ni", shares, g.mean)
        axes = jnp.einsum("k,knij->nij", shares, turn * g.scale[..., None, :])
        # The inverse by cross products compiles in a fraction of the time of LAPACK's.
        a, b, c = jnp.moveaxis(axes, -1, 0)
        rows = jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=1)
        frame = rows / jnp.sum(a * rows[:, 0], axis=-1)[:, None, None]
    opacity = g.opacity
    if motion.transient is not None:
        others = _transients_at(motion, ray.time)
        frame, mean, opacity = (
            jnp.concatenate(x) for x in zip((frame, mean, opacity), others, strict=True)
        )
    o = jnp.einsum("nij,nj->ni", frame, ray.origin[None] - mean)
    real = jnp.any(ray.direction != 0)
    direction = jnp.where(real, ray.direction, jnp.ones(3))
    d = jnp.einsum("nij,j->ni", frame, direction)
    square = jnp.sum(d * d, axis=-1)
    t = -jnp.sum(o * d, axis=-1) / square
    raw = opacity * jnp.exp(-0.5 * jnp.sum(jnp.cross(o, d) ** 2, axis=-1) / square)
    return t, raw, (t > 0) & (raw > alpha_min) & real


def _transients_at(motion, time):
    """Whitening matrix, mean and opacity of the transient Gaussians at one time."""
    x = motion.transient
    if motion.time_range is not None:
        time = jnp.clip(time, *motion.time_range)
    age = time - x.instant
    outside = jnp.abs(age) > x.plateau
    flank = jnp.where(outside, jnp.abs(age) - x.plateau, 0) / x.lifetime
    frame = jnp.swapaxes(_turns(x.quat[None])[0], -1, -2) / x.scale[:, :, None]
    return frame, x.mean + age[:, None] * x.velocity, x.opacity * jnp.exp(-(flank**2) / 2)
