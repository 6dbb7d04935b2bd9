"""Training pictures through lenses of several models: those of a fit are stacked."""

import dataclasses
from collections.abc import Hashable

import jax
import jax.numpy as jnp

from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.mixed_lens import MixedLens
from gaussray.capture.capture import View
from gaussray.io.plain_values import to_device


def same_lens(views: list[View]) -> list[View]:
    """The views with lenses that can be stacked: as they are if all are of one model, else each as
    a `MixedLens`.

    Args:
        views: training views.
    """
    examples: dict[Hashable, AbstractLens] = {}
    for view in views:
        examples.setdefault(array_layout(view.camera.lens), view.camera.lens)
    if len(examples) < 2:
        return views
    # Views share most of their lenses.
    made: dict[int, MixedLens] = {}
    result = []
    for view in views:
        lens = view.camera.lens
        if id(lens) not in made:
            own = array_layout(lens)
            lenses = tuple(lens if model == own else examples[model] for model in examples)
            made[id(lens)] = MixedLens(lenses, to_device(list(examples).index(own), jnp.int32))
        camera = dataclasses.replace(view.camera, lens=made[id(lens)])
        result.append(dataclasses.replace(view, camera=camera))
    return result


def array_layout(part: AbstractLens | Camera) -> Hashable:
    """Structure and shapes of the arrays of a lens or a camera: alike where it can be stacked."""
    return jax.tree.structure(part), tuple(leaf.shape for leaf in jax.tree.leaves(part))
