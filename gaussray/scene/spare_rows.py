"""Rows of Gaussians that no ray meets, up to round numbers: scenes of about the same size then run
the same compiled programs."""

from dataclasses import replace
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene
from gaussray.scene.transient import Transients


AnyGaussians = TypeVar("AnyGaussians", bound=Gaussians | Transients)

# Numbers of rows are multiples of a power of two over this: a sixteenth more than needed, at most.
_PARTS = 32


def round_count(count: int) -> int:
    """The least number of rows that holds so many Gaussians and is a multiple of 1 / 32 of the
    power of two above; 0 for none.

    Args:
        count: number of Gaussians.
    """
    step = max((1 << max(count - 1, 0).bit_length()) // _PARTS, 1)
    return -(-count // step) * step


def with_spare_rows(scene: Scene) -> Scene:
    """The scene with round numbers of Gaussians of each kind. Those that are added are transparent,
    and at the places of others.

    Args:
        scene: the scene, of numbers, not inside of jit. A `ResidualField` holds numbers for each
            moving Gaussian, so these stay as many as they are.

    Returns:
        Static, moving and transient Gaussians in the order of before, each kind with the added ones
        last.
    """
    moving, transient = scene.moving, scene.transient
    if scene.deformation is None or isinstance(scene.deformation, Deformation):
        moving = enlarged(moving, round_count(moving.count))
    if transient is not None:
        transient = enlarged(transient, round_count(transient.count))
    static = enlarged(scene.static, round_count(scene.static.count))
    return replace(scene, static=static, moving=moving, transient=transient)


def enlarged(gaussians: AnyGaussians, rows: int) -> AnyGaussians:
    """The Gaussians and transparent copies of the first ones, in so many rows.

    On the host: nothing is compiled for every number of Gaussians.

    Args:
        gaussians: Gaussians at one time, or transient ones; none stay none.
        rows: number of rows, at least as many as there are Gaussians.
    """
    count = gaussians.count
    if rows == count or not count:
        return gaussians
    source = np.arange(rows) % count
    copies = jax.tree.map(lambda x: np.asarray(x)[source], gaussians)
    copies.opacity[count:] = 0
    return jax.tree.map(jnp.asarray, copies)
