"""Camera shake: a stationary random rotation and translation around the path of a camera."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from jaxtyping import Array, Float

from gaussray.camera.sampling import pcg_hash
from gaussray.geometry import RigidTransform, inlined, multiply, turning
from gaussray.io.plain_values import number, readable
from gaussray.io.validate import require


# Waves of the process, and the largest seed, which single precision holds exactly.
WAVES = 64
SHAKE_SEEDS = 2**24


class Shake(eqx.Module):
    """Camera shake: a stationary Gaussian process of rotation and translation, fixed by its seed.

    Rotation vector (radians) and shift (scene units) along the camera's axes are six independent
    processes of mean 0, standard deviations `turn` and `move` per axis, and correlation
    exp(-s^2 / 2 T^2) over a delay s, with T the `correlation_time` in the capture's unit: smooth
    motion with a power spectrum exp(-(2 pi f T)^2 / 2), 90 % of it below f = 1.64 / (2 pi T).
    """

    turn: Float[Array, ""] = eqx.field(converter=number("trajectory.shake.turn"))
    move: Float[Array, ""] = eqx.field(converter=number("trajectory.shake.move"))
    correlation_time: Float[Array, ""] = eqx.field(
        converter=number("trajectory.shake.correlation_time")
    )
    seed: Float[Array, ""] = eqx.field(default=0.0, converter=number("trajectory.shake.seed"))

    def __check_init__(self):
        for key in ("turn", "move"):
            value = getattr(self, key)
            require(
                f"trajectory.shake.{key}", value, lambda x: np.isfinite(x) & (x >= 0), "at least 0"
            )
        time = self.correlation_time
        require(
            "trajectory.shake.correlation_time", time, lambda t: np.isfinite(t) & (t > 0), "above 0"
        )
        require(
            "trajectory.shake.seed",
            self.seed,
            lambda s: (s >= 0) & (s < SHAKE_SEEDS) & (s == np.floor(s)),
            f"a whole number in 0 ... {SHAKE_SEEDS - 1}",
        )

    def __repr__(self) -> str:
        return readable(self)


@inlined
def unit_shake(shake: Shake, time: Float[Array, ""]) -> Float[Array, "6"]:
    """Rotation (3) and translation (3) of the shake at a time, in standard deviations.

    x = sum_i (a_i cos(2 pi f_i t) + b_i sin(2 pi f_i t)) / sqrt(WAVES) with normal a, b of the
    seed: Gaussian at any times, correlated as mean_i cos(2 pi f_i s). The f_i are the middles of
    equal shares of the spectrum, by which the correlation is right to 0.007 for delays up to 5 T
    and to 0.06 up to 60 T.

    Args:
        shake: the shake, whose correlation time and seed count.
        time: in the capture's unit.
    """
    share = (jnp.arange(WAVES, dtype=time.dtype) + WAVES + 0.5) / (2 * WAVES)
    phase = ndtri(share) * time / shake.correlation_time
    wave = jnp.stack([jnp.cos(phase), jnp.sin(phase)])
    number = jnp.arange(12 * WAVES, dtype=jnp.uint32)
    bits = pcg_hash(number + pcg_hash(shake.seed.astype(jnp.uint32)))
    # In the middles of 2^23 equal shares, which single precision holds exactly.
    uniform = ((bits >> 9).astype(time.dtype) + 0.5) / 2**23
    normal = ndtri(uniform).reshape(2, WAVES, 6)
    return jnp.sum(wave[..., None] * normal, axis=(0, 1)) / WAVES**0.5


@inlined
def shake_pose(shake: Shake, pose: RigidTransform, time: Float[Array, ""]) -> RigidTransform:
    """world_from_camera of a camera that shakes around a pose.

    Args:
        shake: the shake.
        pose: world_from_camera without it.
        time: in the capture's unit.
    """
    x = unit_shake(shake, time)
    turned = multiply(pose.quat, turning(shake.turn * x[:3]))
    return RigidTransform(turned, pose.apply(shake.move * x[3:]))
