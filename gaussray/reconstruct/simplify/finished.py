"""The scene that a candidate ends as: without what it removed, and without what does nothing."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from gaussray.reconstruct.optimize.rows import take_rows
from gaussray.reconstruct.simplify.candidate import Candidate, scale_rows
from gaussray.scene.bodies import body_of
from gaussray.scene.deformation import HEADS, Deformation, Layer
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene
from gaussray.scene.transient import Transients


def finished_scene(candidate: Candidate) -> Scene:
    """The scene of a candidate, without parts that have no effect.

    These are harmonics of the highest degrees that are zero; a deformation of nothing; bodies that
    hold nothing; heads whose last layer is zero, and scales of the planes that the trunk does not
    look at, or the whole field if no head is left; rows of time planes that are all the same;
    transparent transient Gaussians (spare rows); and shading that is 1 everywhere.
    """
    scene, deformation = candidate.scene, candidate.scene.deformation
    # On the host: nothing shall be compiled for every number of rows.
    parts = scene.static, scene.moving, candidate.rest, candidate.kept, candidate.resting
    static, moving, rest, kept, resting = jax.device_get(parts)
    stay, move = np.split(kept, [len(static.mean)])
    still = _joined(
        take_rows(static, np.flatnonzero(stay)), take_rows(rest, np.flatnonzero(move & resting))
    )
    moved = np.flatnonzero(move & ~resting)
    if not len(moved):
        deformation = None
    elif isinstance(deformation, Deformation):
        held = np.asarray(body_of(deformation.bodies, scene.moving.mean))[moved]
        deformation = _simplified(jax.device_get(deformation), held)
    still, mobile = (
        jax.tree.map(jnp.asarray, _without_zeros(x)) for x in (still, take_rows(moving, moved))
    )
    transient = _visible(scene.transient)
    shading = scene.shading
    if shading is not None and not np.any(np.asarray(shading.log_gain)):
        shading = None
    parts = deformation, scene.time_range, transient, scene.light, shading
    return Scene(still, mobile, *parts)


def _visible(transient: Transients | None) -> Transients | None:
    """The transient Gaussians that are not transparent."""
    if transient is None or np.all(np.asarray(transient.opacity) > 0):
        return transient
    return jax.tree.map(
        jnp.asarray, take_rows(transient, np.flatnonzero(np.asarray(transient.opacity)))
    )


def _joined(first: Gaussians, second: Gaussians) -> Gaussians:
    """Both sets of rows, on the host."""
    most = max(x.harmonics.shape[1] for x in (first, second))

    def padded(x: Gaussians) -> Gaussians:
        missing = most - x.harmonics.shape[1]
        harmonics = np.pad(x.harmonics, ((0, 0), (0, missing), (0, 0)))
        return eqx.tree_at(lambda g: g.harmonics, x, harmonics)

    return jax.tree.map(lambda a, b: np.concatenate([a, b]), padded(first), padded(second))


def _simplified(deformation: Deformation, held: np.ndarray) -> Deformation:
    """The deformation, given on the host, for Gaussians that these bodies hold, without what does
    nothing."""
    bodies, planes, trunk = deformation.bodies, deformation.planes, deformation.trunk
    held = np.unique(held)
    held = held[held < len(bodies.pivot)]
    bodies = eqx.tree_at(
        lambda b: (b.pivot, b.radius, b.path, b.turn),
        bodies,
        (bodies.pivot[held], bodies.radius[held], bodies.path[held], bodies.turn[held]),
    )
    heads = [_or_none(getattr(deformation, name)) for name in HEADS]
    rows = scale_rows(planes)
    used = [s for s, own in enumerate(rows) if np.any(trunk.weight[own])]
    weight, bias = (
        trunk.weight[np.concatenate([np.arange(0), *(rows[s] for s in used)])],
        trunk.bias,
    )
    if not any(heads):
        used, weight, bias = [], weight[:0, :0], bias[:0]
    planes = eqx.tree_at(
        lambda p: (p.space, p.time),
        planes,
        (tuple(planes.space[s] for s in used), tuple(_shortest(planes.time[s]) for s in used)),
    )
    field = eqx.tree_at(
        lambda d: [d.bodies, d.planes, d.trunk],
        deformation,
        [bodies, planes, Layer(jnp.asarray(weight), jnp.asarray(bias))],
    )
    field = eqx.tree_at(
        lambda d: [getattr(d, name) for name in HEADS], field, heads, is_leaf=lambda x: x is None
    )
    return jax.tree.map(jnp.asarray, field)


def _without_zeros(gaussians: Gaussians) -> Gaussians:
    used = np.any(np.asarray(gaussians.harmonics), axis=(0, 2))
    cut = min(n for n in (1, 4, 9, 16) if not used[n:].any())
    return eqx.tree_at(lambda g: g.harmonics, gaussians, gaussians.harmonics[:, :cut])


def _or_none(head: tuple[Layer, Layer] | None) -> tuple[Layer, Layer] | None:
    """The head, if it adds anything."""
    adds = head is not None and any(np.any(np.asarray(x)) for x in jax.tree.leaves(head[1]))
    return head if adds else None


def _shortest(plane: Array | np.ndarray) -> Array | np.ndarray:
    """One row of a time plane whose rows are all the same."""
    return plane[:, :1] if np.all(plane == plane[:, :1]) else plane
