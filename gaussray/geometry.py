"""Vectors, quaternions, rigid motions, and the conventions of axes.

World axes are the capture's own. Camera axes are +x right, +y down, +z forward (OpenCV); files in
Blender/OpenGL axes (+x right, +y up, looking down -z) are converted by `BLENDER_AXES` when they are
read or written. Quaternions are (w, x, y, z) and may have any non-zero length. A name says what it
maps to what: `world_from_camera` takes camera coordinates to world coordinates.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


# One program where it is called by itself, and no trace of that in a larger one.
inlined = functools.partial(jax.jit, inline=True)
# The diagonal that turns OpenGL camera axes into ours and back (its own inverse).
BLENDER_AXES = (1.0, -1.0, -1.0)


def product(subscripts: str, *factors: Float[Array, "..."]) -> Float[Array, "..."]:
    """`jnp.einsum` in the factors' own precision.

    By default a GPU rounds the factors of single-precision sums of products to ten bits: a ray
    would miss its pixel by a tenth.

    Args:
        subscripts: which axes are multiplied and summed, as for `jnp.einsum`.
        factors: one array for each group of subscripts.
    """
    return jnp.einsum(subscripts, *factors, precision=jax.lax.Precision.HIGHEST)


@inlined
def safe_norm(vector: Float[Array, "*batch d"]) -> Float[Array, "*batch"]:
    """Length of a vector; at zero both the value and the gradient are 0 instead of NaN. Scaled by
    its largest component first, whose square alone could under- or overflow."""
    # A constant that is multiplied back: the gradient need not pass through it.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(vector), axis=-1, initial=0))
    unit = jnp.where(largest > 0, largest, 1)
    square = jnp.sum((vector / unit[..., None]) ** 2, axis=-1)
    positive = square > 0
    return unit * jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1)), 0)


@inlined
def normalize(vector: Float[Array, "*batch d"]) -> Float[Array, "*batch d"]:
    """Vector of unit length; scaled by its largest component first, so that neither tiny nor huge
    vectors under- or overflow. Zero stays zero."""
    # The result does not depend on the scaling, so its gradient (which could overflow) is left out.
    largest = jax.lax.stop_gradient(jnp.max(jnp.abs(vector), axis=-1, keepdims=True))
    scaled = vector / jnp.where(largest > 0, largest, 1)
    square = jnp.sum(scaled * scaled, axis=-1, keepdims=True)
    return scaled / jnp.sqrt(jnp.where(square > 0, square, 1))


@jax.jit
def normalize_quaternion(quat: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Unit quaternion of the same rotation; the zero quaternion becomes the identity."""
    unit = normalize(quat)
    # Not zeros with a one set: XLA would work that out, and keep it, for millions of Gaussians.
    identity = jnp.broadcast_to(jnp.asarray([1, 0, 0, 0], quat.dtype), quat.shape)
    return jnp.where(jnp.any(unit != 0, axis=-1, keepdims=True), unit, identity)


@jax.jit
def rotation_matrix(quat: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrix of a quaternion (w, x, y, z) of any non-zero length."""
    w, x, y, z = jnp.moveaxis(normalize_quaternion(quat), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


@jax.jit
def multiply(a: Float[Array, "*batch 4"], b: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Hamilton product: the rotation `b` followed by the rotation `a`.

    Args:
        a: quaternion (w, x, y, z) of the second rotation.
        b: quaternion of the first rotation. Lengths multiply.
    """
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    real = aw * bw - jnp.sum(av * bv, axis=-1, keepdims=True)
    return jnp.concatenate([real, aw * bv + bw * av + jnp.cross(av, bv)], axis=-1)


@inlined
def turning(vector: Float[Array, "3"]) -> Float[Array, "4"]:
    """Quaternion of the rotation by |vector| radians about the vector; right and smooth at zero."""
    half = vector / 2
    angle = safe_norm(half)
    return jnp.concatenate([jnp.cos(angle)[None], jnp.sinc(angle / jnp.pi) * half])


@inlined
def rotation_vector(quat: Float[Array, "4"]) -> Float[Array, "3"]:
    """The shortest rotation of a quaternion as angle (radians, at most pi) times axis: the inverse
    of `turning`, right and smooth at zero."""
    unit = normalize_quaternion(quat)
    unit = jnp.where(unit[0] < 0, -unit, unit)
    sine = safe_norm(unit[1:])
    turned = sine > 0
    safe = jnp.where(turned, sine, 1)
    return jnp.where(turned, 2 * jnp.arctan2(safe, unit[0]) / safe, 2) * unit[1:]


def conjugate(quat: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """The opposite rotation of a unit quaternion."""
    return jnp.concatenate([quat[..., :1], -quat[..., 1:]], axis=-1)


@jax.jit
def quaternion(rotation: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """Unit quaternion (w >= 0) of a rotation matrix, by the largest of the four squares (Shepperd).

    Every branch divides by at least 1/2 at its own maximum, so no rotation is ill-conditioned.
    """
    m = rotation
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    candidates = jnp.stack(
        [
            jnp.stack([1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]),
            jnp.stack(
                [m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]]
            ),
            jnp.stack(
                [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1]]
            ),
            jnp.stack(
                [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - trace]
            ),
        ]
    )
    best = candidates[jnp.argmax(jnp.diagonal(candidates))]
    unit = normalize(best)
    return jnp.where(unit[0] < 0, -unit, unit)


def best_rotation(spread: Float[Array, "*n 3 3"]) -> Float[Array, "*n 4"]:
    """The rotation that best takes vectors a to vectors b, of their moments sum(a b^T).

    The quaternion is the eigenvector of the largest eigenvalue of Horn's matrix (1987), found by
    squaring it. Without vectors it is the identity.

    Args:
        spread: the moments, a first.
    """
    s = spread
    trace = s[..., 0, 0] + s[..., 1, 1] + s[..., 2, 2]
    side = jnp.stack(
        [
            s[..., 1, 2] - s[..., 2, 1],
            s[..., 2, 0] - s[..., 0, 2],
            s[..., 0, 1] - s[..., 1, 0],
        ],
        axis=-1,
    )
    identity = jnp.broadcast_to(jnp.eye(3, dtype=s.dtype), s.shape)
    body = s + jnp.swapaxes(s, -1, -2) - trace[..., None, None] * identity
    top = jnp.concatenate([trace[..., None], side], axis=-1)[..., None, :]
    horn = jnp.concatenate([top, jnp.concatenate([side[..., None], body], axis=-1)], axis=-2)
    # All eigenvalues are at most the Frobenius norm in size: shifted by it, none is negative.
    norm = jnp.sqrt(jnp.sum(horn**2, axis=(-2, -1), keepdims=True)) + 1e-30
    power = horn / norm + jnp.broadcast_to(jnp.eye(4, dtype=s.dtype), horn.shape)
    for _ in range(12):
        power = product("...ij,...jk->...ik", power, power)
        power = power / jnp.max(jnp.abs(power), axis=(-2, -1), keepdims=True)
    longest = jnp.argmax(jnp.sum(power**2, axis=-2), axis=-1)
    column = jnp.take_along_axis(power, longest[..., None, None], axis=-1)[..., 0]
    return normalize_quaternion(column)


@inlined
def slerp(
    start: Float[Array, "4"], end: Float[Array, "4"], fraction: Float[Array, ""]
) -> Float[Array, "4"]:
    """Shortest constant-speed rotation from `start` to `end`.

    Below 0.03 rad between the quaternions the sine ratio is replaced by its limit (linear), whose
    error there is under 1e-5 rad.

    Args:
        start: quaternion at the start, of any non-zero length; its sign does not matter.
        end: quaternion at the end, likewise.
        fraction: share of the way: 0 is `start`, 1 is `end`.
    """
    a, b = normalize_quaternion(start), normalize_quaternion(end)
    cosine = jnp.sum(a * b)
    b = jnp.where(cosine < 0, -b, b)
    cosine = jnp.abs(cosine)
    near = cosine > 0.9995
    angle = jnp.arccos(jnp.where(near, 0.5, cosine))
    sine = jnp.sin(angle)
    weight_a = jnp.where(near, 1 - fraction, jnp.sin((1 - fraction) * angle) / sine)
    weight_b = jnp.where(near, fraction, jnp.sin(fraction * angle) / sine)
    return normalize(weight_a * a + weight_b * b)


class RigidTransform(eqx.Module):
    """Rotation then translation: x -> R(quat) x + translation."""

    quat: Float[Array, "*batch 4"]
    translation: Float[Array, "*batch 3"]

    def rotate(self, vector: Float[Array, "3"]) -> Float[Array, "3"]:
        """Direction in the target frame."""
        return product("ij,j->i", rotation_matrix(self.quat), vector)

    def apply(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Point in the target frame."""
        return self.rotate(point) + self.translation

    def inverse_apply(self, point: Float[Array, "3"]) -> Float[Array, "3"]:
        """Point of the target frame in the source frame."""
        return product("ji,j->i", rotation_matrix(self.quat), point - self.translation)


def even_directions(count: int) -> Float[np.ndarray, "count 3"]:
    """Unit vectors that cover the sphere evenly: a spiral by the golden angle."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)


def epipolar_angle(
    ray: Float[np.ndarray, "matches 3"],
    other: Float[np.ndarray, "matches 3"],
    baseline: Float[np.ndarray, "3"],
) -> Float[np.ndarray, " matches"]:
    """The angle in radians between a ray of one camera and the plane of a ray of another camera and
    both cameras: 0 where both rays meet. NaN of NaN; 0 where a ray lies along the baseline.

    Args:
        ray: unit directions of the first camera, in the world.
        other: those of the second one.
        baseline: from one camera to the other.
    """
    normal = np.cross(ray, baseline)
    length = np.linalg.norm(normal, axis=1)
    sine = np.abs(np.einsum("ij,ij->i", normal, other)) / np.where(length > 0, length, np.inf)
    return np.arcsin(np.clip(sine, 0, 1))
