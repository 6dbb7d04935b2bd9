"""A camera: film, lens, aperture, shutter and trajectory, and the rays that they form together."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.aperture import Aperture, focused, thin_lens, transmitted
from gaussray.camera.chromatic import reference_pixel
from gaussray.camera.film import Film, sample_offset
from gaussray.camera.lens import AbstractLens
from gaussray.camera.lens.check import check_span
from gaussray.camera.rays import Rays
from gaussray.camera.shutter import Shutter, check_shutter, check_time, sample_time
from gaussray.camera.trajectory import Trajectory, pose_at
from gaussray.io.plain_values import number, optional, readable, to_device, vector
from gaussray.io.validate import check_kind, known, require


def _film(size: Any) -> Any:
    """A film; (width, height) stands for one with the default filter."""
    return Film(*size) if isinstance(size, tuple | list) and len(size) == 2 else size


class Camera(eqx.Module):
    """The camera of one picture.

    Film and lens are required; by default a camera is a pinhole with an instantaneous exposure at
    time 0, in the origin of the world and looking along +z.

    All geometry (projection, labels, focus) is that of `lens`; `chromatic` concerns only the rays
    of a single colour channel.

    Args:
        film: size of the picture in pixels, and the pixel filter; or (width, height).
        lens: the map between pixels and viewing directions.
        aperture: aperture radius and focus distance in scene units; radius 0 is a pinhole.
        shutter: exposure and readout in the capture's unit of time.
        trajectory: world_from_camera over time.
        time: the frame's own time, in the capture's unit.
        chromatic: magnifications of red, green and blue about the optical axis
            (`chromatic.reference_pixel`); None is no chromatic aberration.
        clip_start: nothing nearer than this along a ray is seen, in scene units; None is 0.

    Raises:
        ValueError: If a part is of another type or does not fit the others, a magnification is not
            above 0, `clip_start` is negative, or the time, a plain number, so large that rows
            or instants of the exposure would share one.
    """

    film: Film = eqx.field(converter=_film)
    lens: AbstractLens
    aperture: Aperture = eqx.field(default_factory=Aperture)
    shutter: Shutter = eqx.field(default_factory=Shutter)
    trajectory: Trajectory = eqx.field(default_factory=Trajectory)
    time: Float[Array, ""] = eqx.field(default=0.0, converter=number("camera.time"))
    chromatic: Float[Array, "3"] | None = eqx.field(
        default=None, converter=optional(vector("camera.chromatic", 3))
    )
    clip_start: Float[Array, ""] | None = eqx.field(
        default=None, converter=optional(number("camera.clip_start"))
    )

    def __post_init__(self):
        # Arrays are taken in the precision that they have: captures count times from their first.
        if not isinstance(self.time, int | float | np.number) or not self.time:
            return
        self.film, self.time = _film(self.film), number("camera.time")(self.time)
        if isinstance(self.film, Film) and isinstance(self.shutter, Shutter):
            check_time(self.time, self.shutter, (self.film.width, self.film.height))

    def __check_init__(self):
        check_kind("camera.film", self.film, Film, "(width, height) or a gaussray.Film")
        check_kind("camera.lens", self.lens, AbstractLens, "a lens, such as gaussray.Pinhole")
        check_kind("camera.aperture", self.aperture, Aperture, "a gaussray.Aperture")
        rule = "a gaussray.Shutter, such as gaussray.rolling_shutter(readout, rows)"
        check_kind("camera.shutter", self.shutter, Shutter, rule)
        rule = "a gaussray.Trajectory, such as gaussray.look_at(eye)"
        check_kind("camera.trajectory", self.trajectory, Trajectory, rule)
        require("camera.time", self.time, np.isfinite, "finite")
        check_shutter(self.shutter, (self.film.width, self.film.height))
        if self.chromatic is not None:
            rule = "above 0"
            require("chromatic", self.chromatic, lambda m: np.isfinite(m) & (m > 0), rule)
        if self.clip_start is not None:
            rule = "at least 0"
            require("clip_start", self.clip_start, lambda x: np.isfinite(x) & (x >= 0), rule)

    def __repr__(self) -> str:
        return readable(self)


def check_camera(camera: Camera) -> None:
    """Check what the parts of a camera ask of each other (`check_span`, `check_focus`), where their
    numbers are known.

    Raises:
        ValueError: It is not so.
    """
    check_span(camera.lens, camera.film.width, camera.film.height)
    check_focus(camera.aperture, camera.lens)


def check_focus(aperture: Aperture, lens: AbstractLens) -> None:
    """Refuse depth of field about a plane for a lens that sees beside it, where both are known
    and of one camera.

    Args:
        aperture: the aperture.
        lens: the lens.

    Raises:
        ValueError: The lens sees at 90 degrees from its axis or more.
    """
    radius = aperture.radius
    if aperture.focus != "plane" or not known(radius, *jax.tree.leaves(lens)) or np.ndim(radius):
        return
    with jax.ensure_compile_time_eval():
        wrong = np.asarray(radius) > 0 and lens.sees_sideways
    if wrong:
        raise ValueError(
            "aperture.focus must be sphere for a lens with a field of view of 180 degrees or more, "
            "whose rays do not all meet a plane in front of it, got plane."
        )


def with_chromatic(camera: Camera, magnification: Sequence[float]) -> Camera:
    """The camera with chromatic aberration.

    Args:
        camera: the camera.
        magnification: magnifications of red, green and blue; all 1 is no aberration.
    """
    none = all(m == 1 for m in magnification)
    chromatic = None if none else to_device(magnification, camera.time.dtype)
    return dataclasses.replace(camera, chromatic=chromatic)


def camera_ray(
    camera: Camera,
    pixel: Float[Array, "2"],
    u: Float[Array, "5"],
    magnification: Float[Array, ""] | None = None,
) -> Rays:
    """The ray of one sample of a pixel, in world space.

    Args:
        camera: the camera.
        pixel: index of the pixel (column, row).
        u: film x, film y, lens x, lens y and shutter, in [0, 1). 1/2 everywhere is the chief ray of
            the pixel's centre in the middle of its exposure.
        magnification: of one colour channel, an element of `Camera.chromatic`; None is the lens
            itself (magnification 1).

    Returns:
        One ray. Its direction is zero where the lens forms none.
    """
    film = camera.film
    time = sample_time(camera.shutter, pixel, (film.width, film.height), camera.time, u[4])
    aperture = focused(camera.aperture, time)
    position = pixel + 0.5 + sample_offset(film, u[:2])
    if magnification is not None:
        position = reference_pixel(camera.lens, position, magnification)
    chief = camera.lens.direction(position)
    origin, direction = thin_lens(aperture, chief, u[2:4])
    weight = transmitted(aperture, chief, u[2:4])
    world_from_camera = pose_at(camera.trajectory, time)
    origin, direction = world_from_camera.apply(origin), world_from_camera.rotate(direction)
    return Rays(origin, direction, time, weight, camera.clip_start)


def camera_rays(
    camera: Camera,
    pixel: Float[Array, "rays 2"],
    u: Float[Array, "rays 5"],
    magnification: Float[Array, ""] | None = None,
) -> Rays:
    """The rays of many samples: `camera_ray` for each.

    Args:
        camera: the camera.
        pixel: indices of the pixels (column, row).
        u: film x, film y, lens x, lens y and shutter of each sample, in [0, 1).
        magnification: of one colour channel, for all samples; None is the lens itself.
    """
    return jax.vmap(camera_ray, in_axes=(None, 0, 0, None))(camera, pixel, u, magnification)


def project(camera: Camera, point: Float[Array, "3"]) -> Float[Array, "2"]:
    """Pixel of a point in world space, seen at the frame's own time.

    Rolling shutter (see `rolling_projection`), aperture and chromatic aberration are left out.

    Args:
        camera: the camera.
        point: position in scene units.

    Returns:
        Position (column, row), pixel centres at +0.5; NaN where the lens does not image the point.
    """
    world_from_camera = pose_at(camera.trajectory, camera.time)
    return camera.lens.project(world_from_camera.inverse_apply(point))
