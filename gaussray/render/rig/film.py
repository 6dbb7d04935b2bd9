"""The film of a rig's cameras, from options: picture size and pixel filter."""

import dataclasses
import math

import equinox as eqx

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.capture.stored_part import Window
from gaussray.capture.view_part import shutter_of_part
from gaussray.io.safe.limits import within


FITS = ("width", "crop", "letterbox")


class FilmOptions(eqx.Module):
    """Size and pixel filter of the pictures.

    Args:
        filter: keep (the capture's), center, box, gaussian or blackman_harris.
        filter_width: width of the filter in pixels, in total; None is the capture's.
        size: width and height in pixels; empty is the capture's.
        fit: view of pictures of another shape: "width" keeps the capture's horizontal field of
            view, "crop" cuts the capture's view, "letterbox" contains all of it.
    """

    filter: str = eqx.field(static=True, default="keep")
    filter_width: float | None = eqx.field(static=True, default=None)
    size: tuple[int, ...] = eqx.field(static=True, default=())
    fit: str = eqx.field(static=True, default="width")

    def __check_init__(self):
        whole = all(type(n) is int and n > 0 for n in self.size)
        if self.size and not (whole and len(self.size) == 2):
            raise ValueError(
                f"film.size must be [width,height] in pixels, such as [1920,1080], got "
                f"{list(self.size)}."
            )
        within("film.size", "its megapixels", math.prod(self.size), "picture", 1e6)
        if self.fit not in FITS:
            raise ValueError(f"film.fit must be one of {', '.join(FITS)}, got {self.fit!r}.")


def apply_film(camera: Camera, options: FilmOptions) -> Camera:
    """Give a camera the picture size and pixel filter of the options.

    The lens shows the same view on the new pixels, and the readout of that view takes as long.

    Args:
        camera: the camera.
        options: the options.

    Raises:
        ValueError: A value breaks its rule.
    """
    camera = _resized(camera, options)
    film = camera.film
    if options.filter == "keep" and options.filter_width is None:
        return camera
    name = film.filter if options.filter == "keep" else options.filter
    width = film.filter_width if options.filter_width is None else options.filter_width
    return dataclasses.replace(camera, film=Film(film.width, film.height, name, width))


def _resized(camera: Camera, options: FilmOptions) -> Camera:
    film = camera.film
    size = film.width, film.height
    if not options.size or options.size == size:
        return camera
    width, height = options.size
    window = Window(size, visible_part(size, (width, height), options.fit))
    return dataclasses.replace(
        camera,
        film=Film(width, height, film.filter, film.filter_width),
        lens=camera.lens.resized(*window, (width, height)),
        shutter=shutter_of_part(camera.shutter, window, (width, height)),
    )


def visible_part(
    picture: tuple[int, int], size: tuple[int, int], fit: str
) -> tuple[float, float, float, float]:
    """The part of a picture that a picture of another size shows; both have one centre.

    Args:
        picture: width and height of the picture, in pixels.
        size: width and height of the other one.
        fit: as for `FilmOptions`.

    Returns:
        Left, top, width and height in pixels of the first picture; it may exceed its edges.
    """
    across, down = picture[0] / size[0], picture[1] / size[1]
    scale = {"width": across, "crop": min(across, down), "letterbox": max(across, down)}[fit]
    width, height = scale * size[0], scale * size[1]
    return (picture[0] - width) / 2, (picture[1] - height) / 2, width, height
