"""Checks that the arrays of a scene file fit one another."""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, get_args

import equinox as eqx
import jax
from jaxtyping import jaxtyped

from gaussray.runtime.program_files import kept_text
from gaussray.scene.scene import Scene, at


def shape_error(scene: Scene) -> str:
    """What is wrong with the shapes of a scene's arrays; empty if they fit.

    The scene at a time is traced, not computed.
    """
    wrong = next(_wrong_arrays(scene, ""), "")
    if wrong:
        return wrong
    leaves, tree = jax.tree.flatten(scene)
    arrays = tuple((x.shape, x.dtype) for x in leaves)
    return kept_text(("misfit", tree, arrays), lambda: _trace_error(tree, arrays))


def _wrong_arrays(node: Any, name: str, kind: Any = None) -> Iterator[str]:
    """Each array that has other axes than its module says; so much is known without a trace, which
    takes a thousand times as long."""
    if isinstance(node, eqx.Module):
        for field in dataclasses.fields(node):
            path = f"{name}.{field.name}" if name else field.name
            yield from _wrong_arrays(getattr(node, field.name), path, field.type)
    elif isinstance(node, tuple):
        for i, x in enumerate(node):
            yield from _wrong_arrays(x, f"{name}.{i}", next(iter(get_args(kind)), None))
    elif hasattr(node, "shape"):
        kinds = [x for x in (kind, *get_args(kind)) if hasattr(x, "dim_str")]
        # In a context of its own, where axes of the same name in other arrays are not remembered.
        with jaxtyped("context"):
            like = not kinds or isinstance(node, kinds[0])
        if not like:
            axes = kinds[0].dim_str.strip() or "none"
            yield f"'{name}' holds {node.dtype} of shape {node.shape} instead of the axes '{axes}'"


@functools.lru_cache(maxsize=64)
def _trace_error(tree: Any, leaves: tuple) -> str:
    scene = jax.tree.unflatten(tree, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])
    parts = [x for x in (scene.static, scene.moving, scene.transient) if x is not None]
    coefficients = {part.harmonics.shape[1] for part in parts}
    if not coefficients <= {1, 4, 9, 16}:
        return f"harmonics of {sorted(coefficients)} coefficients"
    time = jax.ShapeDtypeStruct((), scene.time_range.dtype)
    try:
        made = jax.eval_shape(at, scene, time)
    except Exception as error:
        return " ".join(str(error).split())[:200]
    count = sum(part.mean.shape[0] for part in parts)
    wanted = {"mean": (3,), "quat": (4,), "scale": (3,), "opacity": ()}
    wrong = [name for name, x in wanted.items() if getattr(made, name).shape != (count, *x)]
    return ", ".join(wrong)
