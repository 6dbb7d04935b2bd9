"""The state of a tiny fit on disk."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import optax

from gaussray.reconstruct.optimize.checkpoint import save_checkpoint
from gaussray.reconstruct.optimize.density import Pull
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State
from gaussray.scene.gaussians import Unconstrained


def sample(path: Path) -> None:
    """Write one."""

    def some(count: int) -> Unconstrained:
        shapes = (3,), (4,), (3,), (), (4, 3)
        return Unconstrained(*(jnp.zeros((count, *shape)) for shape in shapes))

    own = Parameters(some(2), some(0), None, None)
    pull = Pull(jnp.zeros(2), jnp.zeros(2))
    adam = optax.ScaleByAdamState(jnp.zeros((), jnp.int32), own, own)  # type: ignore[arg-type]
    none = Pull(jnp.zeros(0), jnp.zeros(0))
    state = State(own, adam, pull, none, jnp.zeros((), jnp.int32))
    info = {"stage": "coarse", "most": 9, "limit": [[0.0] * 3, [1.0] * 3]}
    save_checkpoint(path, state, info=info, notes={"errors": np.zeros(3)})
