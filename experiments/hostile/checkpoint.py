"""The state of a tiny fit on disk."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import optax

from gaussray.reconstruct.data.sampler import TileErrorState
from gaussray.reconstruct.optimize.checkpoint import save_checkpoint
from gaussray.reconstruct.optimize.gradient_statistic import GradientStatistic
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.scene.gaussians import Unconstrained


def sample(path: Path) -> None:
    """Write one."""

    def some(count: int) -> Unconstrained:
        shapes = (3,), (4,), (3,), (), (4, 3)
        return Unconstrained(*(jnp.zeros((count, *shape)) for shape in shapes))

    own = Parameters(some(2), some(0), None, None)
    pull = GradientStatistic(jnp.zeros(2), jnp.zeros(2))
    adam = optax.ScaleByAdamState(jnp.zeros((), jnp.int32), own, own)  # type: ignore[arg-type]
    none = GradientStatistic(jnp.zeros(0), jnp.zeros(0))
    state = State(own, adam, pull, none, jnp.zeros((), jnp.int32))
    errors = TileErrorState(np.zeros((1, 3)), np.zeros((2, 2), int), np.zeros(2))
    progress = RunProgress(initial=(2, 0), limit=(4, 5), most=9, tile_errors=errors)
    save_checkpoint(path, state, progress)
