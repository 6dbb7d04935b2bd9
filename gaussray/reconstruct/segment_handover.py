"""What a segment hands over to the next one."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State, begin_state
from gaussray.reconstruct.run_progress import KnownBodies, RunProgress
from gaussray.reconstruct.session import Session
from gaussray.scene.bodies import body_pose_at
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import fold_tint, unconstrain
from gaussray.scene.scene import persistent_at


def hand_over(session: Session, state: State, progress: RunProgress) -> tuple[State, RunProgress]:
    """State and progress with which the next segment begins.

    The state holds all Gaussians as static ones, where they are at the time that both segments
    share, and the refined cameras. Transient Gaussians stay behind: each segment finds its own.
    Things may have come where nothing was.

    Args:
        session: the segment that is done.
        state: its last state.
        progress: its progress.
    """
    scene, _ = session.scene(state, progress)
    last = jnp.asarray(session.times[-1], scene.time_range.dtype)
    known = None
    if isinstance(scene.deformation, Deformation):
        bodies = scene.deformation.bodies
        pivot = np.asarray(bodies.pivot + body_pose_at(bodies, last)[0])
        known = KnownBodies(pivot, np.asarray(bodies.radius))
    static = unconstrain(fold_tint(eqx.filter_jit(persistent_at)(scene, last)))
    moving = jax.tree.map(lambda x: x[:0], static)
    progress = replace(
        progress,
        stage="begin",
        segment=progress.segment + 1,
        bodies=known,
        tile_errors=None,
        moved=None,
        free_space=None,
    )
    return begin_state(Parameters(static, moving, None, state.parameters.corrections)), progress
