"""How well candidates for the pruned scene match training pictures, and what each Gaussian adds."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float

from gaussray.camera.corrections import apply_color_response
from gaussray.color import LEAST_MSE, psnr_from_mse, srgb_encode
from gaussray.reconstruct.optimize.loss import developed
from gaussray.reconstruct.simplify.candidate import Candidate, at_time
from gaussray.reconstruct.simplify.tile_views import TileView
from gaussray.runtime.devices import from_primary
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0
from gaussray.tracer.alive_transients import most_alive
from gaussray.tracer.measure import HEADROOM, enlarged_capacity, kernel_capacity, measure
from gaussray.tracer.motion import Motion, key_times_across, still
from gaussray.tracer.options import TraceOptions, grid_levels, on_kernel
from gaussray.tracer.shard import trace_sharded
from gaussray.tracer.traverse import Capacity


# Key states of one picture span at least this share of the scene's times.
_LEAST_SPAN = 1e-4
# Room in lists for other views than the one that is measured.
_ROOM_FOR_VIEWS = 2.0


class Tracing(eqx.Module):
    """How candidates are traced.

    Args:
        options: options of the tracer.
        mesh: the devices that share the rays.
        keys: the number of key states of the scene across the times of one picture; 1: all its rays
            share one time.
    """

    options: TraceOptions
    mesh: Mesh = eqx.field(static=True)
    keys: int = eqx.field(static=True, default=1)


# A program returns a value, the sizes of the tracer's lists, and how many entries were dropped.
_Program = Callable[[Candidate, TileView, Tracing, Capacity], tuple[Array, Array, Array]]


class CandidateMeter:
    """Measures candidates on the same tiles, in programs that are compiled once.

    Args:
        views: the tiles to measure PSNR on.
        tracing: how candidates are traced.
    """

    def __init__(self, views: Sequence[TileView], tracing: Tracing):
        self.views, self.tracing = views, tracing
        self.capacity: Capacity | None = None
        self.weight = 3 * float(np.sum([np.sum(view.weight) for view in views]))
        # Whether masks hide any pixels of the tiles.
        self.masked = any(np.any(view.unmasked().weight != view.weight) for view in views)

    def psnr(self, candidate: Candidate, *, least: float = -math.inf) -> float:
        """PSNR of sRGB-encoded colours, in dB, on the meter's tiles.

        Args:
            candidate: what is measured.
            least: in dB. As soon as the PSNR is sure to be below it, the result is -inf, which
                saves the rest of the tiles.
        """
        square, most = 0.0, self.weight * 10 ** (-least / 10)
        for view in self.views:
            square += float(from_primary(self._run(_error, candidate, view)))
            if square > most:
                return -math.inf
        return psnr_from_mse(square / self.weight, least=LEAST_MSE)

    def weights(
        self, candidate: Candidate, views: Sequence[TileView]
    ) -> Float[np.ndarray, " gaussians"]:
        """The sum of the blending weights of every Gaussian in some tiles; static ones first.

        Args:
            candidate: the candidate whose Gaussians are measured.
            views: the tiles to measure on, instead of those of the meter; at least one.
        """
        return from_primary(
            np.sum([self._run(_weights, candidate, view) for view in views], axis=0)
        )

    def _run(self, program: _Program, candidate: Candidate, view: TileView) -> np.ndarray:
        tracing = self.tracing
        if self.capacity is None:
            self.capacity = self._first_capacity(candidate, view)
        while True:
            value, needed, dropped = program(candidate, view, tracing, self.capacity)
            if not int(dropped):
                return np.asarray(value, np.float64)
            wanted = [int(n) for n in needed]
            self.capacity = enlarged_capacity(self.capacity, wanted)

    def _first_capacity(self, candidate: Candidate, view: TileView) -> Capacity:
        """List sizes that most likely suffice for all views: longer ones compile all again."""
        options, dtype = self.tracing.options, view.rays.time.dtype
        transient, alive = candidate.scene.transient, 0
        if transient is not None:
            times = np.array([one.time for one in self.views])
            alive = max(int(HEADROOM * most_alive(transient, times)), 1)
        if on_kernel(options, dtype):
            return kernel_capacity(grid_levels(options, dtype), alive)
        motion = _motion(candidate, view, keys=self.tracing.keys)
        capacity = measure(motion, view.rays, options=options, headroom=_ROOM_FOR_VIEWS)
        return replace(capacity, transient=max(capacity.transient, alive))


@eqx.filter_jit
def _motion(candidate: Candidate, view: TileView, *, keys: int) -> Motion:
    """What a candidate shows across the times of its rays."""
    limits = candidate.scene.time_range
    if keys == 1:
        return still(at_time(candidate, view.time), candidate.scene.transient, limits)
    first, last = jnp.min(view.rays.time), jnp.max(view.rays.time)
    time = key_times_across(first, last, keys, least=_LEAST_SPAN * (limits[1] - limits[0]))
    state = jax.vmap(lambda t: at_time(candidate, t))(time)
    opacity, harmonics = state.opacity[keys // 2], state.harmonics[keys // 2]
    moved = Gaussians(state.mean, state.quat, state.scale, opacity, harmonics, state.tint)
    transient = candidate.scene.transient
    return Motion(time, moved, None, transient, None if transient is None else limits)


@eqx.filter_jit
def _error(
    candidate: Candidate, view: TileView, tracing: Tracing, capacity: Capacity
) -> tuple[Array, Array, Array]:
    """Sum of squared errors, list sizes and how many entries were dropped."""
    motion = _motion(candidate, view, keys=tracing.keys)
    pixels, report = trace_sharded(
        motion, view.rays, options=tracing.options, capacity=capacity, mesh=tracing.mesh
    )
    error = (
        developed(srgb_encode(apply_color_response(view.gain, pixels.color)), view.truth)
        - view.truth
    )
    return jnp.sum(view.weight[:, None] * error * error), report.needed, report.dropped


@eqx.filter_jit
def _weights(
    candidate: Candidate, view: TileView, tracing: Tracing, capacity: Capacity
) -> tuple[Array, Array, Array]:
    """Sum of every Gaussian's blending weights, list sizes and how many entries were dropped.

    A pixel is sum_i w_i c_i, so the sum of the pixels has the slope sum w_i along the colour c_i of
    one Gaussian; that colour is 1/2 + C0 x of its constant harmonic x.
    """
    motion = _motion(candidate, view, keys=tracing.keys)
    every = motion.gaussians

    def light(x: Array) -> tuple[Array, tuple[Array, Array]]:
        harmonics = jnp.broadcast_to(x[:, None, None], (len(x), 1, 3))
        plain = Gaussians(every.mean, every.quat, every.scale, every.opacity, harmonics)
        pixels, report = trace_sharded(
            replace(motion, gaussians=plain),
            view.rays,
            options=tracing.options,
            capacity=capacity,
            mesh=tracing.mesh,
        )
        return jnp.sum(view.weight * pixels.color[:, 0]), (report.needed, report.dropped)

    # The slope is the same wherever colours are not clamped; zeros would be folded at compile time.
    slope, report = jax.grad(light, has_aux=True)(every.opacity)
    return slope / C0, *report
