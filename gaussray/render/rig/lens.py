"""Builds the lens that a rig gives to a camera, from the config group `lens`."""

from gaussray.camera.film import Film
from gaussray.camera.lens import AbstractLens, check_lens
from gaussray.camera.lens.model import LensOptions as LensOptions
from gaussray.camera.lens.registry import models_by_block, models_by_camera_model, models_by_name


def lens_label(options: LensOptions) -> str:
    """Effect that frames through this lens show; empty if there is none.

    Raises:
        ValueError: If `lens.model` is no lens model.
    """
    return "" if options.model == "keep" else _model(options).effect(options)


def label_of_lens(lens: AbstractLens) -> str:
    """Effect that frames through a camera's own lens show; empty if there is none.

    Distortion of a perspective lens has no name, as in captures that give none.
    """
    keys = lens.record().keys
    block = keys.get("lens")
    if block is None:
        model = models_by_camera_model()[keys["camera_model"]]
    else:
        model = models_by_block()[block["model"]]
    return "" if model.perspective else model.label


def build_lens(film: Film, options: LensOptions) -> AbstractLens:
    """The lens of these options for pictures of this size, its axis in their middle.

    Args:
        film: size of the pictures.
        options: model, field of view and coefficients; `lens.model` is not `keep`.

    Raises:
        ValueError: If the options are no valid lens; the message names the key and its rule.
        OSError: If `lens.file` cannot be read.
    """
    build = _model(options).from_options
    if build is None:
        raise ValueError(f"lens.model {options.model} can be read from captures alone.")
    if options.fov is not None and not 0 < options.fov <= 360:
        raise ValueError(f"lens.fov must be in (0, 360] degrees, got {options.fov}.")
    lens = build(film, options)
    check_lens(lens, film.width, film.height)
    return lens


def _model(options):
    models = models_by_name()
    if options.model not in models:
        raise ValueError(
            f"lens.model must be keep or one of {', '.join(models)}, got {options.model!r}."
        )
    return models[options.model]
