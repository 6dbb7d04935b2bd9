"""All lens models, found in the modules of `camera/lens/`.

A new lens is one new file: its module lists its `LensModel`s as `MODELS`. Captures, manifests,
configuration, viewer and calibration read this registry and name no lens themselves.
"""

import functools
import importlib
import pkgutil
from collections.abc import Iterator

from gaussray.camera import lens as package
from gaussray.camera.lens.model import LensModel


@functools.cache
def lens_models() -> tuple[LensModel, ...]:
    """Every lens model, by module name and then in the order of the module."""
    return tuple(_declared())


@functools.cache
def models_by_name() -> dict[str, LensModel]:
    """`lens.model` of the configuration -> model."""
    return {model.name: model for model in lens_models() if model.name}


@functools.cache
def models_by_block() -> dict[str, LensModel]:
    """`model` of a `lens` block in a capture's JSON -> model."""
    return {model.block: model for model in lens_models() if model.block}


@functools.cache
def models_by_camera_model() -> dict[str, LensModel]:
    """`camera_model` in a capture's JSON -> model."""
    return {name: model for model in lens_models() for name in model.camera_models}


def _declared() -> Iterator[LensModel]:
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        yield from getattr(importlib.import_module(module.name), "MODELS", ())
