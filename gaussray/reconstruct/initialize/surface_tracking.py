"""Control points on soft surfaces, followed from one time's stereo points to the next.

Some points of the first time become control points. Their motion to each later time is found by
non-rigid registration (`nonrigid_registration`). What is matched is always the first time's points,
so errors do not add up.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.reconstruct.initialize.from_points import typical_gap
from gaussray.reconstruct.initialize.nonrigid_registration import (
    FEWEST_POINTS,
    RegistrationOptions,
    control_graph,
    dense,
    embedded_points,
    padded_points,
    registered,
    registrable,
    registration_options,
)
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.scene.control_points import ControlPoints


def tracked_surface(
    clouds: Sequence[MovingPoints],
    *,
    options: RegistrationOptions | None = None,
    seed: int = 0,
    report: Callable[[int, int], object] = lambda done, total: None,
) -> ControlPoints | None:
    """Control points on the moving surfaces of the first time, with their poses at all times.

    Args:
        clouds: the moving points of each time, the earliest first.
        options: how carefully to register; None chooses by device.
        seed: of the choice of points.
        report: called with the number of times done and their total.

    Returns:
        The control points; None where the first time has too few points to follow, or there is no
        other time.
    """
    options = options or registration_options(jax.default_backend())
    dice = np.random.default_rng([seed, 3])
    own = registrable(clouds[0].points.position, dice)
    if len(own) < FEWEST_POINTS or len(clouds) < 2:
        return None
    position, color = clouds[0].points.position[own], clouds[0].points.color[own]
    gap = typical_gap(position)
    kept = dense(position, gap)
    if kept.sum() < FEWEST_POINTS:
        return None
    position, color = position[kept], color[kept]
    middle = position.mean(axis=0)
    position = (position - middle) / gap
    graph = control_graph(position, options.control)
    position, color = position[: options.source], color[: options.source]
    surface = embedded_points(position, color, graph, options.source)
    places, turns = [graph.pivot], [np.tile([1.0, 0, 0, 0], (options.control, 1))]
    for k, cloud in enumerate(clouds[1:], 1):
        there = registrable(cloud.points.position, dice)[: options.target]
        # At constant speed so far, unless the points say otherwise.
        start = places[-1] if k < 2 else 2 * places[-1] - places[-2]
        motion = None
        if len(there) >= FEWEST_POINTS:
            found = (cloud.points.position[there] - middle) / gap
            target = padded_points(found, cloud.points.color[there], options.target)
            motion = registered(surface, graph, target, (start, turns[-1]), options=options)
        # Nothing to follow: as before.
        moved, turned = motion or (places[-1], turns[-1])
        flip = np.sum(turned * turns[-1], axis=1, keepdims=True) < 0
        places.append(moved)
        turns.append(np.where(flip, -turned, turned))
        report(k, len(clouds) - 1)
    place, turn = (np.stack(x, axis=1)[: graph.count] for x in (places, turns))
    return ControlPoints(
        pivot=jnp.asarray(gap * place[:, 0] + middle, jnp.float32),
        radius=jnp.asarray(gap * graph.radius[: graph.count], jnp.float32),
        time=jnp.asarray([cloud.time for cloud in clouds], jnp.float32),
        path=jnp.asarray(gap * (place - place[:, :1]), jnp.float32),
        turn=jnp.asarray(turn, jnp.float32),
    )
