"""Groups of bundles that march together: sorted by the length of their lists."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from gaussray.tracer.k_nearest import slot_mask
from gaussray.tracer.options import TraceOptions
from gaussray.tracer.table import Lanes


def group_width(options: TraceOptions) -> int:
    """The number of bundles in a group: on a CPU as many as its caches hold."""
    return options.group or (4 if jax.default_backend() == "cpu" else 16)


def split_into_groups(tree, lists, options):
    """Arrays (channels, bundles, rays) as (groups, channels, bundles of a group, rays).

    The bundles are sorted by the length of their lists; the last group is padded with zeros.

    Args:
        tree: arrays (channels, bundles, rays of a bundle), in any structure.
        lists: as for `bundle_groups`; only the counts are read.
        options: options of the tracer; `group` is the number of bundles in a group.
    """
    order = jnp.argsort(lists[2])
    bundles = order.shape[0]
    width = group_width(options)
    groups = -(-bundles // width)
    order = jnp.pad(order, (0, groups * width - bundles), constant_values=-1)

    def split(x):
        ordered = jnp.where(
            (order >= 0).reshape((1,) * (x.ndim - 2) + (-1, 1)), x[..., order, :], 0
        )
        parts = ordered.reshape(*x.shape[:-2], groups, width, x.shape[-1])
        return jnp.moveaxis(parts, -3, 0)

    return jax.tree.map(split, tree)


def bundle_groups(
    lanes: Lanes, lists: tuple[Array, Array, Array], options: TraceOptions
) -> tuple[dict[str, Any], Callable]:
    """The rays and lists of bundles, sorted by list length and cut into groups.

    Args:
        lanes: rays, each array (components, bundles, rays of a bundle).
        lists: Gaussians of all lists, and start and count of every bundle's list.
        options: options of the tracer.

    Returns:
        A dictionary of arrays with a leading axis of groups: `lanes` (the rays), `start`, `count`
        and `mask` (of the lists); and the function that brings results (groups, channels, bundles
        of a group, rays) back to (channels, bundles, rays) in the original order.
    """
    _, start, count = lists
    order = jnp.argsort(count)
    bundles = order.shape[0]
    width = group_width(options)
    groups = -(-bundles // width)
    padding = groups * width - bundles
    parts = {"lanes": split_into_groups(lanes, lists, options)}
    for name, x in (("start", start), ("count", count)):
        parts[name] = jnp.pad(x[order], (0, padding)).reshape(groups, width)
    parts["mask"] = slot_mask(parts["count"])[..., None]
    back = jnp.argsort(order)

    def restore(tree):
        def join(x):
            x = jnp.moveaxis(x, 0, -3)
            x = x.reshape(*x.shape[:-3], groups * width, x.shape[-1])
            return x[..., back, :]

        return jax.tree.map(join, tree)

    return parts, restore
