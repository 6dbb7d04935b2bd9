"""Control points on soft surfaces, followed from one time's stereo points to the next.

Some points of the first time become control points. Their motion to each later time is found by
non-rigid registration (`nonrigid_registration`), which begins where the velocities of the time
before lead. What is matched is always the first time's points, so errors do not add up.
"""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from gaussray.reconstruct.initialize.embedded_deformation import (
    RestingSurface,
    registrable,
    resting_surface,
)
from gaussray.reconstruct.initialize.nonrigid_registration import (
    RegistrationOptions,
    registered_surface,
    registration_options,
)
from gaussray.reconstruct.initialize.stereo.from_pictures import MovingPoints
from gaussray.scene.control_points import ControlPoints


# Points around a control point that tell where it goes.
_AROUND = 8


def tracked_surface(
    clouds: Sequence[MovingPoints],
    *,
    options: RegistrationOptions | None = None,
    seed: int = 0,
    report: Callable[[int, int], object] = lambda done, total: None,
) -> ControlPoints | None:
    """Control points on the moving surfaces of the first time, with their poses at all times.

    Args:
        clouds: the moving points of each time, the earliest first; their velocities lead to the
            next.
        options: how carefully to register; None chooses by device.
        seed: of the choice of points.
        report: called with the number of times done and their total.

    Returns:
        The control points; None where the first time has too few points to follow, or there is no
        other time.
    """
    options = options or registration_options(jax.default_backend())
    dice = np.random.default_rng([seed, 3])
    first = clouds[0].points
    own = registrable(first.position, dice)
    surface = resting_surface(
        first.position[own], first.color[own], control=options.control, source=options.source
    )
    if surface is None or len(clouds) < 2:
        return None
    graph, gap = surface.graph, surface.gap
    places, turns = [graph.pivot], [np.tile([1.0, 0, 0, 0], (options.control, 1))]
    for k, cloud in enumerate(clouds[1:], 1):
        there = registrable(cloud.points.position, dice)
        start = _ahead(surface, places, clouds[k - 1], cloud.time)
        found, shade = cloud.points.position[there], cloud.points.color[there]
        motion = registered_surface(surface, found, shade, (start, turns[-1]), options=options)
        # Nothing to follow: as before.
        moved, turned = motion or (places[-1], turns[-1])
        flip = np.sum(turned * turns[-1], axis=1, keepdims=True) < 0
        places.append(moved)
        turns.append(np.where(flip, -turned, turned))
        report(k, len(clouds) - 1)
    place, turn = (np.stack(x, axis=1)[: graph.count] for x in (places, turns))
    return ControlPoints(
        pivot=jnp.asarray(gap * place[:, 0] + surface.middle, jnp.float32),
        radius=jnp.asarray(gap * graph.radius[: graph.count], jnp.float32),
        time=jnp.asarray([cloud.time for cloud in clouds], jnp.float32),
        path=jnp.asarray(gap * (place - place[:, :1]), jnp.float32),
        turn=jnp.asarray(turn, jnp.float32),
    )


def _ahead(
    surface: RestingSurface,
    places: Sequence[Float[np.ndarray, "control 3"]],
    cloud: MovingPoints,
    time: float,
) -> Float[np.ndarray, "control 3"]:
    """Where control points are expected next: they go as the points around them of the time before,
    and at constant speed where none of these has a velocity that is believed."""
    last, graph = places[-1], surface.graph
    onward = last if len(places) < 2 else 2 * last - places[-2]
    position = surface.in_gaps(cloud.points.position[cloud.believed])
    step = cloud.velocity[cloud.believed] * (time - cloud.time) / surface.gap
    if len(position) < _AROUND:
        return onward
    real = slice(0, graph.count)
    away, near = KDTree(position).query(last[real], k=_AROUND, workers=-1)
    weight = np.exp(-0.5 * (away / (2 * graph.radius[real, None])) ** 2)
    total = weight.sum(axis=1, keepdims=True)
    mean = np.sum(weight[..., None] * step[near], axis=1) / np.maximum(total, 1e-9)
    sure, ahead = total / (total + 1), onward.copy()
    ahead[real] = sure * (last[real] + mean) + (1 - sure) * onward[real]
    return ahead
