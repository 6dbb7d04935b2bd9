"""Arrays of Gaussians with a fixed number of rows, of which some hold none.

Density control changes the number of Gaussians, but arrays keep their shapes so that nothing
recompiles.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from gaussray.scene.gaussians import Unconstrained


# Logit opacity of an empty row: far below any cut-off, so no ray meets it.
EMPTY = -30.0


def occupied(gaussians: Unconstrained) -> Bool[np.ndarray, " rows"]:
    """Which rows hold a Gaussian."""
    return np.asarray(gaussians.logit_opacity) > EMPTY / 2


def with_rows(gaussians: Unconstrained, rows: int) -> Unconstrained:
    """The same Gaussians in arrays of `rows` rows; the added rows are empty."""
    missing = rows - gaussians.logit_opacity.shape[0]
    empty = Unconstrained(
        mean=jnp.zeros((missing, 3)),
        quat=jnp.zeros((missing, 4)).at[:, 0].set(1),
        log_scale=jnp.zeros((missing, 3)),
        logit_opacity=jnp.full(missing, EMPTY),
        harmonics=jnp.zeros((missing, *gaussians.harmonics.shape[1:])),
    )
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b.astype(a.dtype)]), gaussians, empty)


def take_rows(tree, rows: np.ndarray):
    """The same tree of arrays with only these rows of each."""
    return jax.tree.map(lambda x: x[rows], tree)
