"""A scene with parts removed on trial, in arrays that keep their shapes."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.geometry import normalize_quaternion, product
from gaussray.reconstruct.optimize.rows import EMPTY
from gaussray.scene.deformation import Deformation, Layer
from gaussray.scene.gaussians import Gaussians, concatenate, fold_tint, principal_axes
from gaussray.scene.planes import Planes, features
from gaussray.scene.scene import Scene, static_at
from gaussray.scene.spare_rows import enlarged


class Candidate(eqx.Module):
    """A scene with parts removed on trial.

    Args:
        scene: the scene, whose rows stay.
        rest: the state of every moving Gaussian in which it stays if it rests.
        kept: which Gaussians are kept, static ones first.
        resting: which moving Gaussians are in their state of `rest` at all times.
    """

    scene: Scene
    rest: Gaussians
    kept: Bool[Array, " gaussians"]
    resting: Bool[Array, " moving"]


def whole_candidate(scene: Scene) -> Candidate:
    """The scene with nothing removed but what is transparent: spare rows."""
    # On the host: nothing is compiled for every number of rows.
    opacity = [np.asarray(part.opacity) for part in (scene.static, scene.moving)]
    kept, resting = np.concatenate(opacity) > 0, np.zeros(scene.moving.count, bool)
    return Candidate(scene, scene.moving, jnp.asarray(kept), jnp.asarray(resting))


def in_shape_of(candidate: Candidate, scene: Scene) -> Candidate:
    """Another scene, whole, in arrays of a candidate's shapes as far as it fits into them: its
    programs then serve both.

    Args:
        candidate: the candidate.
        scene: the other scene, with no more coefficients of harmonics.
    """

    def shaped(own: Gaussians, like: Gaussians) -> Gaussians:
        more = like.harmonics.shape[1] - own.harmonics.shape[1]
        if own.count > like.count or not own.count or more < 0:
            return own
        harmonics = np.pad(np.asarray(own.harmonics), ((0, 0), (0, more), (0, 0)))
        return enlarged(replace(own, harmonics=jnp.asarray(harmonics)), like.count)

    like, transient = candidate.scene, scene.transient
    if transient is not None and like.transient is not None:
        transient = enlarged(transient, max(like.transient.count, transient.count))
    static, moving = shaped(scene.static, like.static), shaped(scene.moving, like.moving)
    return whole_candidate(replace(scene, static=static, moving=moving, transient=transient))


def begin_candidate(
    scene: Scene, times: Float[np.ndarray, " instants"]
) -> tuple[Candidate, np.ndarray]:
    """Everything kept and nothing at rest, and how much every moving Gaussian changes.

    It rests in the mean of its states over the times (logarithms of scale and tint). Its change is
    the largest, over the times, of its distance from there in units of its largest scale, of the
    change of its axes relative to their length (turn and stretch), and of the logarithm of its
    tint: 0.1 is a tenth of its size, or of its light.

    Args:
        scene: the whole scene.
        times: the times at which the states are taken; not read without a deformation.
    """
    candidate = whole_candidate(scene)
    if scene.deformation is None or not scene.moving.count:
        return candidate, np.zeros(scene.moving.count)
    rest, change = _rest(scene, jnp.asarray(times, scene.moving.mean.dtype))
    return eqx.tree_at(lambda d: d.rest, candidate, rest), np.asarray(change)


@eqx.filter_jit
def _rest(scene: Scene, times: Float[Array, " instants"]) -> tuple[Gaussians, Array]:
    states = jax.lax.map(lambda time: _moved(scene, time), times)
    quat = normalize_quaternion(states.quat)
    aligned = jnp.sum(quat * quat[:1], axis=-1, keepdims=True) < 0
    quat = normalize_quaternion(jnp.mean(jnp.where(aligned, -quat, quat), axis=0))
    mean = jnp.mean(states.mean, axis=0)
    scale = jnp.exp(jnp.mean(jnp.log(states.scale), axis=0))
    light = jnp.log(states.tint)
    tint = jnp.mean(light, axis=0)

    def length(x: Array, trailing: int) -> Array:
        return jnp.sqrt(jnp.sum(x * x, axis=tuple(range(-trailing, 0))))

    own = principal_axes(quat, scale)
    changes = (
        length(states.mean - mean[None], 1) / jnp.max(scale, axis=-1)[None],
        length(principal_axes(states.quat, states.scale) - own[None], 2) / length(own, 2)[None],
        jnp.max(jnp.abs(light - tint[None]), axis=-1),
    )
    moving = scene.moving
    rest = Gaussians(mean, quat, scale, moving.opacity, moving.harmonics, jnp.exp(tint))
    return fold_tint(rest), jnp.max(jnp.stack(changes), axis=(0, 1))


def _moved(scene: Scene, time: Float[Array, ""]) -> Gaussians:
    """The moving Gaussians at a time, with a tint."""
    moved = scene.moving if scene.deformation is None else scene.deformation(scene.moving, time)
    tint = jnp.ones_like(moved.mean) if moved.tint is None else moved.tint
    return Gaussians(moved.mean, moved.quat, moved.scale, moved.opacity, moved.harmonics, tint)


def at_time(candidate: Candidate, time: Float[Array, ""]) -> Gaussians:
    """All Gaussians of a candidate but transient ones, at one time; static ones first.

    Args:
        candidate: the candidate. Gaussians that it removes are too faint for a ray to meet.
        time: the time, in the capture's unit.
    """
    scene = candidate.scene
    moved, rests = _moved(scene, time), candidate.resting
    # What comes to rest gets the shade of its place.
    rest = static_at(replace(scene, static=candidate.rest), time)
    still = eqx.tree_at(
        lambda g: g.tint, rest, jnp.ones_like(moved.mean), is_leaf=lambda x: x is None
    )

    def chosen(a: Array, b: Array) -> Array:
        return jnp.where(rests.reshape(-1, *(1,) * (a.ndim - 1)), a, b)

    every = concatenate(static_at(scene, time), jax.tree.map(chosen, still, moved))
    opacity = jnp.where(
        candidate.kept, every.opacity, jax.nn.sigmoid(EMPTY).astype(every.opacity.dtype)
    )
    return eqx.tree_at(lambda g: g.opacity, every, opacity)


def without_head(candidate: Candidate, name: str) -> Candidate:
    """The candidate without the residual of one head of the deformation network.

    Args:
        candidate: a candidate with a deformation field.
        name: the head, one of `HEADS`.
    """
    head = getattr(_field(candidate), name)
    return eqx.tree_at(
        lambda d: getattr(d.scene.deformation, name),
        candidate,
        None if head is None else (head[0], jax.tree.map(jnp.zeros_like, head[1])),
        is_leaf=lambda x: x is None,
    )


def without_scale(
    candidate: Candidate, scale: int, times: Float[np.ndarray, " instants"]
) -> Candidate:
    """The candidate with the features of one scale of its planes replaced by their mean over the
    moving Gaussians that it keeps and some times.

    Args:
        candidate: a candidate with a deformation field.
        scale: number of the scale, from 0, the order of `Planes.space`.
        times: the times of the mean, in the capture's unit.
    """
    field = _field(candidate)
    own = scale_rows(field.planes)[scale]
    position, weight = candidate.scene.moving.mean, field.trunk.weight
    kept = candidate.kept[candidate.scene.static.count :]
    mean = _mean_features(field.planes, position, kept, jnp.asarray(times, position.dtype))[own]
    trunk = Layer(weight.at[own].set(0), field.trunk.bias + product("i,io->o", mean, weight[own]))
    return eqx.tree_at(lambda d: d.scene.deformation.trunk, candidate, trunk)


@eqx.filter_jit
def _mean_features(
    planes: Planes, position: Array, kept: Bool[Array, " moving"], times: Array
) -> Float[Array, " features"]:
    share = jnp.where(kept, 1, 0) / jnp.maximum(jnp.sum(kept), 1).astype(position.dtype)
    every = jax.lax.map(lambda time: share @ features(planes, position, time), times)
    return jnp.mean(every, axis=0)


def without_change_in_time(candidate: Candidate, scale: int) -> Candidate:
    """The candidate with the time planes of one scale at their mean over time.

    Args:
        candidate: a candidate with a deformation field.
        scale: number of the scale, from 0, the order of `Planes.time`.
    """
    plane = _field(candidate).planes.time[scale]
    mean = jnp.broadcast_to(jnp.mean(plane, axis=1, keepdims=True), plane.shape)
    return eqx.tree_at(lambda d: d.scene.deformation.planes.time[scale], candidate, mean)


def without_shading(candidate: Candidate) -> Candidate:
    """The candidate without the shadows that pass over what stands still, if there are any.

    Args:
        candidate: the candidate.
    """
    shading = candidate.scene.shading
    if shading is None:
        return candidate
    nothing = jnp.zeros_like(shading.log_gain)
    return eqx.tree_at(lambda d: d.scene.shading.log_gain, candidate, nothing)


def with_degree(candidate: Candidate, part: str, degree: int) -> Candidate:
    """The candidate with harmonics up to a degree only, of its static or of its moving Gaussians.

    Args:
        candidate: the candidate.
        part: static or moving. Static ones include those at rest, which will be static.
        degree: the highest degree that is kept, 0 to 3.
    """
    cut = (degree + 1) ** 2
    if part == "static":
        rest = candidate.rest.harmonics.at[:, cut:].set(0)
        candidate = eqx.tree_at(lambda d: d.rest.harmonics, candidate, rest)
    harmonics = getattr(candidate.scene, part).harmonics.at[:, cut:].set(0)
    return eqx.tree_at(lambda d: getattr(d.scene, part).harmonics, candidate, harmonics)


def _field(candidate: Candidate) -> Deformation:
    field = candidate.scene.deformation
    assert isinstance(field, Deformation)
    return field


def scale_rows(planes: Planes) -> list[np.ndarray]:
    """Which rows of the trunk belong to each scale."""
    widths = [plane.shape[-1] for plane in planes.space]
    return np.split(np.arange(sum(widths)), np.cumsum(widths)[:-1]) if widths else []
