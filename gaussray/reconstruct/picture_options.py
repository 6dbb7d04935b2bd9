"""Options of a fit that its pictures themselves decide."""

import math
from dataclasses import replace

import equinox as eqx

from gaussray.reconstruct.data.backdrop import BackdropColor, backdrop_sentence
from gaussray.reconstruct.data.contrast import contrast_of, cost_at_contrast
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.data.silhouettes import SILHOUETTES_SENTENCE
from gaussray.reconstruct.optimize.density import DensityOptions
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.tracer.bundle import FAN


def options_for_pictures(
    options: ReconstructOptions,
    footage: Footage,
    backdrop: BackdropColor | None,
    *,
    silhouettes: bool = False,
) -> tuple[ReconstructOptions, list[str]]:
    """The options that suit the pictures, and a sentence about each that users may wonder at.

    Args:
        options: all options.
        footage: the training pictures.
        backdrop: the colour of what is behind everything; None: the pictures show a room.
        silhouettes: whether masks cut a thing out (`are_silhouettes`).
    """
    told = [SILHOUETTES_SENTENCE] * silhouettes
    if backdrop is not None:
        told.append(backdrop_sentence(backdrop))
        # What stands before it is all that there is.
        options = eqx.tree_at(lambda o: o.fit, options, replace(options.fit, surround=0.0))
    usual = options.density.opacity_cost
    options = _with_cost_at_contrast(options, footage)
    cost = options.density.opacity_cost
    if cost < usual:
        told.append(
            f"The pictures are dark or plain: opacity costs {cost:.2g} instead of {usual:.2g} "
            "(density.opacity_cost)."
        )
    return _with_tile_levels(options, footage), told


def _with_cost_at_contrast(options: ReconstructOptions, footage: Footage) -> ReconstructOptions:
    """The options with the cost of opacity that suits the contrast of the pictures, where fit.auto
    has raised it."""
    density = options.density
    chosen = options.fit.auto and "density.opacity_cost" not in options.explicit_keys
    if not chosen or density.opacity_cost <= DensityOptions().opacity_cost:
        return options
    cost = cost_at_contrast(density.opacity_cost, contrast_of(footage))
    return eqx.tree_at(lambda o: o.density, options, replace(density, opacity_cost=cost))


def _with_tile_levels(options: ReconstructOptions, footage: Footage) -> ReconstructOptions:
    """The options with a coarser level of bundles, if the bundles of a tile fill one."""
    trace = options.trace
    block = trace.bundle * math.isqrt(FAN)
    if trace.levels or footage.side % block:
        return options
    return eqx.tree_at(lambda o: o.trace, options, replace(trace, levels=1))
