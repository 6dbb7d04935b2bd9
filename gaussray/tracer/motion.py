"""Motion of Gaussians within a frame: parabolas between key times."""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gaussray.scene.gaussians import Gaussians, concatenate, principal_axes
from gaussray.scene.light import Light
from gaussray.scene.scene import Scene, moving_at, persistent_at, static_at
from gaussray.scene.transient import Transients


class Motion(eqx.Module):
    """States of the same Gaussians at increasing key times; one key is a scene that stands still.

    The mean, the axes F = R S and the tint move on an arc of a parabola through every three
    neighbouring keys (0 1 2, then 2 3 4, ...), or on a line between two. That is of third order in
    the key spacing and exact for constant acceleration; a bounce is exact where arcs meet and
    smoothed within one. Before the first and after the last key the scene rests.

    Arcs are blended from `control_points` with weights that are not negative and sum to 1
    (`control_weights`). The support of the blend along any normal n is then at most the largest of
    its control points, n.c + |F^T n| being convex: what bounds them bounds every time of the arc.
    That is why F is blended, not its inverse.

    `rest` are Gaussians without key states that stand still; they come before the others.
    `transient` are Gaussians that live for a short time; they come last. They have no key states:
    every ray meets them where they are, and as opaque as they are, at its own time. Times outside
    of `time_range` (None: there are no limits) count for them as its ends.

    `light` is a factor of what each ray sees, at its own time (`lit`); None is 1.
    """

    time: Float[Array, " keys"]
    gaussians: Gaussians
    rest: Gaussians | None = None
    transient: Transients | None = None
    time_range: Float[Array, "2"] | None = None
    light: Light | None = None

    @property
    def keys(self) -> int:
        """Number of key states, and of control points."""
        return self.time.shape[0]

    def __check_init__(self):
        if self.keys != 2 and self.keys % 2 == 0:
            raise ValueError(
                f"render.keys must be 1, 2 or odd, got {self.keys}: arcs go through three keys and "
                "share their ends."
            )


def still(
    gaussians: Gaussians,
    transient: Transients | None = None,
    time_range: Float[Array, "2"] | None = None,
) -> Motion:
    """The motion of a scene whose static and deformed Gaussians do not move within the frame.

    Args:
        gaussians: Gaussians without key states.
        transient: short-lived Gaussians, which move and fade all the same; None for none.
        time_range: times beyond which transient Gaussians rest; None for no limits.
    """
    lifted = Gaussians(
        mean=gaussians.mean[None],
        quat=gaussians.quat[None],
        scale=gaussians.scale[None],
        opacity=gaussians.opacity,
        harmonics=gaussians.harmonics,
        tint=None if gaussians.tint is None else gaussians.tint[None],
    )
    time = jnp.zeros(1, gaussians.mean.dtype)
    return Motion(time, lifted, None, transient, None if transient is None else time_range)


def scene_motion(
    scene: Scene,
    key_time: Float[Array, " keys"],
    time_range: Float[Array, "2"] | None = None,
    *,
    held: bool = False,
) -> Motion:
    """The motion of a scene within a frame; with one key time the deformation is constant, and the
    shade of static Gaussians is that of the middle.

    Args:
        scene: the scene.
        key_time: increasing times between which the deformation is interpolated.
        time_range: times beyond which transient Gaussians rest; None for no limits.
        held: what derivatives leave out (`scene.deformation.deform`).
    """
    transient = scene.transient if scene.transient is not None and scene.transient.count else None
    middle = (key_time[0] + key_time[-1]) / 2
    if key_time.shape[0] == 1 or scene.deformation is None:
        motion = still(persistent_at(scene, middle, held=held), transient, time_range)
        return replace(motion, light=scene.light)
    rest = static_at(scene, middle, held=held) if scene.static.count else None
    limits = None if transient is None else time_range
    moving = moving_at(scene, key_time, held=held)
    return Motion(key_time, moving, rest, transient, limits, scene.light)


def key_times_across(
    first: Float[Array, ""], last: Float[Array, ""], keys: int, *, least: Float[Array, ""] | float
) -> Float[Array, " keys"]:
    """Key times at even intervals, also where all rays share one time: arcs need a length.

    Args:
        first: time of the first ray.
        last: time of the last ray.
        keys: number of key states, at least two.
        least: what the key times span at least, about the middle of the rays' times.
    """
    room = jnp.maximum(least - (last - first), 0) / 2
    room = jax.lax.stop_gradient(room).astype(first.dtype)
    return jnp.linspace(first - room, last + room, keys, dtype=first.dtype)


def lit(
    motion: Motion, color: Float[Array, "*rays 3"], time: Float[Array, "*rays"]
) -> Float[Array, "*rays 3"]:
    """Colours in the light of the rays' own times.

    Args:
        motion: the scene, whose light counts.
        color: linear light of the rays, in usual light.
        time: times of the rays, in the capture's unit.
    """
    return color if motion.light is None else color * motion.light.at(time)


def merge_rest(motion: Motion) -> Motion:
    """The same motion with the Gaussians without key states repeated at every key."""
    if motion.rest is None:
        return motion
    every = concatenate(motion.rest, motion.gaussians)
    return replace(motion, gaussians=every, rest=None)


def clipped_time(
    time_range: Float[Array, "2"] | None, time: Float[Array, "*times"]
) -> Float[Array, "*times"]:
    """Times clipped to the range of transient Gaussians.

    Args:
        time_range: first and last time; None for no limits.
        time: times, in the capture's unit.
    """
    if time_range is None:
        return time
    return jnp.clip(time, *jax.lax.stop_gradient((time_range[0], time_range[1])))


def control_points(
    motion: Motion,
) -> tuple[Float[Array, "keys gaussians 3"], Float[Array, "keys gaussians 3 3"]]:
    """Mean and axes F of the control points: the ends of the arcs, and between them the inner ones.

    An arc meets its middle key M at the fraction f of its time, so its inner control point is
    (M - (1-f)^2 A - f^2 B) / (2 f (1-f)): 2 M - (A + B) / 2 in the middle of the ends A and B.
    """
    g = motion.gaussians
    return _controls(motion.time, g.mean), _controls(motion.time, principal_axes(g.quat, g.scale))


def _controls(time: Array, x: Array) -> Array:
    """Control points of any quantity that is given at the keys."""
    if len(time) < 3:
        return x
    begin, middle, end = time[:-1:2], time[1::2], time[2::2]
    f = ((middle - begin) / (end - begin)).reshape(-1, *(1,) * (x.ndim - 1))
    inner = (x[1::2] - (1 - f) ** 2 * x[:-1:2] - f**2 * x[2::2]) / (2 * f * (1 - f))
    return x.at[1::2].set(inner)


def control_weights(
    key_time: Float[Array, " keys"], time: Float[Array, ""]
) -> Float[Array, " keys"]:
    """Weight of every control point at a time: Bernstein polynomials of the time within its arc.

    They are smooth within an arc, so gradients reach shutter and trigger times.

    Args:
        key_time: key times, increasing.
        time: in the capture's unit.
    """
    keys = key_time.shape[0]
    if keys == 1:
        return jnp.ones_like(key_time)
    knot = _knots(key_time)
    # 1 in arcs that are over, 0 in those to come.
    s = jnp.clip((time - knot[:-1]) / (knot[1:] - knot[:-1]), 0, 1)
    one = jnp.ones_like(s[:1])
    ends = jnp.concatenate([one, s]) * jnp.concatenate([1 - s, one])
    if keys == 2:
        return ends
    return jnp.zeros_like(key_time).at[::2].set(ends * ends).at[1::2].set(2 * s * (1 - s))


def arc_weights(
    key_time: Float[Array, " keys"], time: Float[Array, "*rays"]
) -> tuple[Float[Array, "*rays 3"], Int[Array, "*rays"]]:
    """The nonzero weights of `control_weights`: those of three consecutive control points.

    Args:
        key_time: key times, increasing, at least two; of two, the third weight is 0.
        time: in the capture's unit.

    Returns:
        The three weights, and the index of the first control point.
    """
    knot = _knots(key_time)
    inner = knot[1:-1].reshape(*(1,) * time.ndim, -1)
    after = jnp.sum(time[..., None] >= inner, axis=-1, dtype=jnp.int32)
    begin, end = knot[after], knot[after + 1]
    s = jnp.clip((time - begin) / (end - begin), 0, 1)
    if key_time.shape[0] == 2:
        return jnp.stack([1 - s, s, jnp.zeros_like(s)], axis=-1), after
    return jnp.stack([(1 - s) ** 2, 2 * s * (1 - s), s * s], axis=-1), 2 * after


def tint_controls(motion: Motion) -> Float[Array, "keys gaussians 3"]:
    """Tints of the control points; a scene without tint has none."""
    tint = motion.gaussians.tint
    return _controls(motion.time, jnp.ones_like(motion.gaussians.mean) if tint is None else tint)


def active_controls(
    key_time: Float[Array, " keys"], earliest: Float[Array, ""], latest: Float[Array, ""]
) -> Bool[Array, " keys"]:
    """The control points with a weight at some time of an interval.

    Args:
        key_time: key times, increasing.
        earliest: first time of the interval.
        latest: last time of the interval.
    """
    knot = _knots(key_time)
    infinite = jnp.full_like(knot[:1], jnp.inf)
    before = jnp.concatenate([-infinite, knot[:-1]])
    after = jnp.concatenate([knot[1:], infinite])
    ends = (before <= latest) & (after >= earliest)
    if key_time.shape[0] < 3:
        return ends
    inner = (knot[:-1] <= latest) & (knot[1:] >= earliest)
    return jnp.zeros(key_time.shape, bool).at[::2].set(ends).at[1::2].set(inner)


def _knots(key_time: Array) -> Array:
    """Where arcs begin and end."""
    return key_time if key_time.shape[0] < 3 else key_time[::2]


def is_valid(gaussians: Gaussians) -> Bool[Array, " gaussians"]:
    """Whether each Gaussian can be traced: all values, and inverses of scales, are finite."""
    g = gaussians
    per_key = jnp.concatenate([g.mean, g.quat, g.scale, 1 / g.scale], axis=-1)
    fine = jnp.all(jnp.isfinite(per_key), axis=(0, -1)) & jnp.all(g.scale > 0, axis=(0, -1))
    if g.tint is not None:
        fine = fine & jnp.all(jnp.isfinite(g.tint), axis=(0, -1))
    return fine & jnp.isfinite(g.opacity) & jnp.all(jnp.isfinite(g.harmonics), axis=(1, 2))


def replace_invalid(g: Gaussians, fine: Bool[Array, " gaussians"]) -> Gaussians:
    """Replace the values of invalid Gaussians by 1.

    Args:
        g: Gaussians with key states.
        fine: which of them are valid.
    """

    def with_ones(x: Array, axis: int) -> Array:
        shape = [-1 if i == axis else 1 for i in range(x.ndim)]
        return jnp.where(fine.reshape(shape), x, 1)

    return map_arrays(with_ones, g)


def pad_gaussians(g: Gaussians) -> Gaussians:
    """Append a Gaussian of zeros to Gaussians with key states."""

    def pad(x: Array, axis: int) -> Array:
        return jnp.pad(x, [(0, 1) if i == axis else (0, 0) for i in range(x.ndim)])

    return map_arrays(pad, g)


def map_arrays(change: Callable[[Array, int], Array], g: Gaussians) -> Gaussians:
    """Gaussians with key states after a change of every array.

    Args:
        change: gets an array and its axis of the Gaussians.
        g: Gaussians with key states.
    """
    return Gaussians(
        mean=change(g.mean, 1),
        quat=change(g.quat, 1),
        scale=change(g.scale, 1),
        opacity=change(g.opacity, 0),
        harmonics=change(g.harmonics, 0),
        tint=None if g.tint is None else change(g.tint, 1),
    )
