"""Arrays of Gaussians with a fixed number of rows, of which some hold none.

Density control changes the number of Gaussians, but arrays keep their shapes so that nothing
recompiles.
"""

from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from gaussray.scene.gaussians import Unconstrained
from gaussray.scene.transient import UnconstrainedTransients


# A kind of Gaussians in unconstrained values.
Kind = TypeVar("Kind", bound=Unconstrained | UnconstrainedTransients)


# Logit opacity of an empty row: far below any cut-off, so no ray meets it.
EMPTY = -30.0


def occupied(gaussians: Unconstrained | UnconstrainedTransients) -> Bool[np.ndarray, " rows"]:
    """Which rows hold a Gaussian."""
    return np.asarray(gaussians.logit_opacity) > EMPTY / 2


@partial(jax.jit, static_argnames="rows")
def with_rows(gaussians: Kind, rows: int) -> Kind:
    """The same Gaussians in arrays of more rows; the added rows are empty.

    Args:
        gaussians: the Gaussians, in unconstrained values.
        rows: rows of the new arrays, at least as many as there are.
    """
    held = gaussians.logit_opacity.shape[0]
    missing = rows - held
    empty = jax.tree.map(lambda x: jnp.zeros((missing, *x.shape[1:]), x.dtype), gaussians)
    # At places of the others: a field that all empty rows read at one place would wait for the
    # gradients of all of them to be added up there.
    place = gaussians.mean[jnp.arange(missing) % held] if held else empty.mean
    empty = eqx.tree_at(
        lambda g: (g.mean, g.quat, g.logit_opacity),
        empty,
        (place, empty.quat.at[:, 0].set(1), jnp.full_like(empty.logit_opacity, EMPTY)),
    )
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), gaussians, empty)


def take_rows(tree, rows: np.ndarray | Array):
    """The same tree of arrays with only some rows of each.

    On the host: nothing is compiled for every number of rows.

    Args:
        tree: arrays with a common leading axis.
        rows: numbers of the rows, in the order of the result.
    """
    tree, rows = jax.device_get((tree, rows))
    return jax.tree.map(lambda x: x[rows], tree)
