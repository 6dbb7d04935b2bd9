"""Our side: the rays and times of our cameras against those that Blender's pictures tell."""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio

from experiments.paired_benchmark.geometry import samples
from experiments.paired_benchmark.geometry.cases import CLIP
from gaussray.camera.camera import camera_rays
from gaussray.camera.film import pixel_grid
from gaussray.camera.trajectory import pose_at
from gaussray.capture.capture import View
from gaussray.geometry import RigidTransform


class Picture(NamedTuple):
    """What the passes of a picture say of every pixel, one row each; metres.

    `moved` is how far the box had gone when the pixel was seen, from where it stands at the frame's
    own time, and `square` its square: both are means in a picture of many samples.
    """

    hit: np.ndarray
    incoming: np.ndarray
    moved: np.ndarray
    square: np.ndarray


def read_picture(path: Path) -> Picture:
    """The four passes of an EXR of `render/renderer.py`."""
    image = oiio.ImageBuf(str(path))
    if image.has_error:
        raise OSError(f"{path}: the picture cannot be read: {image.geterror()}")
    pixels = np.asarray(image.get_pixels(oiio.FLOAT), float)
    names = [name.partition(".")[2] for name in image.spec().channelnames]

    def read(name):
        return pixels[..., [names.index(f"{name}.{c}") for c in "RGB"]].reshape(-1, 3)

    return Picture(read("hit"), read("incoming"), read("moved")[:, 0], read("square")[:, 0])


def compare(view: View, speed: float) -> dict[str, Any]:
    """Errors of a view's camera; `speed` is the box's, in metres a unit of the capture's time.

    `pixels` have a ray on both sides, `mask` on one side only (not told through a filter). The
    following are each the median, the 99th percentile and the maximum over the pixels:

    * `ray`, in pixels: directions of `camera_rays` against Blender's, from the same place of the
      opening, at the same instant of the exposure and through the same point of the filter;
    * `image`, in pixels: where our lens projects the point of Blender's ray that is in focus,
      against the pixel's centre; not told through a filter;
    * `origin`: distance of the rays' origins, in radii of the opening (metres for a pinhole);
    * `time`, in steps of a row (in exposures for a global shutter, in frames for an instant): when
      our row sees, against Blender's; with exposure, against its mean over the row, and `width`
      is how much longer than ours it is, as a share.

    `film`, `lens` and `instant` compare distributions: the largest difference between the shares of
    Blender's samples and of ours below any value (Kolmogorov and Smirnov).
    """
    camera, picture = view.camera, read_picture(view.image)
    filtered = camera.film.filter != "center"
    pixel = np.asarray(pixel_grid(camera.film), np.float32).reshape(-1, 2)
    chief = camera_rays_at(camera, pixel, np.full((len(pixel), 5), 0.5))
    lit, ours_lit = (np.any(d != 0, axis=1) for d in (picture.incoming, chief.direction))
    both = lit if filtered else lit & ours_lit
    pixel, row_time = pixel[both], chief.time[both]
    time = view.time + picture.moved[both] / speed
    hit, direction = in_camera(camera, picture.hit[both], -picture.incoming[both], time)
    focus = in_focus(camera.aperture, hit, direction)
    origin = at_opening(camera.aperture, hit, direction, focus)
    image = pixels_of(camera.lens, focus)

    errors: dict[str, Any] = {"pixels": int(both.sum())}
    offset = image - pixel - 0.5
    if not filtered:
        errors["mask"] = int((lit != ours_lit).sum())
        errors["image"] = summary(np.linalg.norm(offset, axis=1))
    u = sample_numbers(camera, offset, origin, focus, time - row_time)
    for name, axes in (("film", [0, 1]), ("lens", [2, 3]), ("instant", [4])):
        if np.any(u[:, axes] != 0.5):
            errors[name] = samples.unevenness(u[:, axes])

    ours = camera_rays_at(camera, pixel, u)
    our_origin, our_direction = in_camera(camera, ours.origin, ours.direction, ours.time)
    errors["ray"] = summary(in_pixels(camera.lens, image, direction - our_direction))
    radius = float(camera.aperture.radius) or 1.0
    errors["origin"] = summary(np.linalg.norm(origin - our_origin, axis=1) / radius)
    if camera.shutter.exposure > 0:
        return errors | exposure_errors(view, speed, chief.time)
    step = float(camera.shutter.row_step) or 1 / CLIP
    return errors | {"time": summary(np.abs(time - ours.time) / step)}


def sample_numbers(camera, offset, origin, focus, late):
    """The `u` of `camera_rays` that make our camera take Blender's samples; 1/2 where it has no
    choice."""
    u = np.full((len(late), 5), 0.5)
    if camera.film.filter != "center":
        u[:, :2] = samples.of_film(camera.film, offset)
    if camera.aperture.radius > 0:
        u[:, 2:4] = samples.of_opening(camera.aperture, origin, focus)
    if camera.shutter.exposure > 0:
        u[:, 4] = np.clip(late / float(camera.shutter.exposure) + 0.5, 0, 1)
    return u


def camera_rays_at(camera, pixel, u):
    """`camera_rays` as arrays of double precision."""
    u = jnp.asarray(u, jnp.float32)
    rays = jax.jit(camera_rays)(camera, jnp.asarray(pixel), u)
    return jax.tree.map(lambda array: np.asarray(array, float), rays)


def in_camera(camera, point, direction, time):
    """Points and directions of the world in the axes of the camera at each one's time."""

    def turned(point, direction, time):
        world_from_camera = pose_at(camera.trajectory, time)
        turn = RigidTransform(world_from_camera.quat, jnp.zeros_like(direction))
        return world_from_camera.inverse_apply(point), turn.inverse_apply(direction)

    arrays = (jnp.asarray(array, jnp.float32) for array in (point, direction, time))
    return [np.asarray(array, float) for array in jax.jit(jax.vmap(turned))(*arrays)]


def pixels_of(lens, point):
    """Where the lens projects points, in camera axes."""
    project = jax.jit(jax.vmap(lens.project))
    return np.asarray(project(jnp.asarray(point, jnp.float32)), float)


def in_focus(aperture, hit, direction):
    """Where each ray meets the plane or sphere in focus; anywhere on it for a pinhole."""
    if aperture.radius == 0:
        return hit
    distance = float(aperture.focus_distance)
    if aperture.focus == "plane":
        return hit + ((distance - hit[:, 2]) / direction[:, 2])[:, None] * direction
    along = np.sum(hit * direction, axis=1)
    nearest = hit - along[:, None] * direction
    ahead = np.sqrt(distance**2 - np.sum(nearest**2, axis=1))
    return nearest + ahead[:, None] * direction


def at_opening(aperture, hit, direction, focus):
    """Where each ray passes the opening: the plane across the axis, or across its chief ray."""
    if aperture.radius > 0 and aperture.focus == "plane":
        return hit - (hit[:, 2] / direction[:, 2])[:, None] * direction
    back = np.sum(hit * focus, axis=1) / np.sum(direction * focus, axis=1)
    return hit - back[:, None] * direction


def in_pixels(lens, image, difference):
    """Length in pixels of small differences of directions around points of the image; not a number
    where the lens forms no ray."""
    slope = np.asarray(jax.jit(jax.vmap(jax.jacrev(lens.direction)))(jnp.asarray(image)), float)
    formed = np.any(np.nan_to_num(slope) != 0, axis=(1, 2))
    step = np.linalg.pinv(np.nan_to_num(slope)) @ difference[..., None]
    return np.where(formed, np.linalg.norm(step[..., 0], axis=1), np.nan)


def exposure_errors(view, speed, row_time):
    """`time` and `width` from the means of a picture of many samples, row by row."""
    shutter, film = view.camera.shutter, view.camera.film
    exposure = float(shutter.exposure)
    mean = read_picture(view.image.with_suffix(".mean.exr"))

    def by_row(values):
        return values.reshape(film.height, film.width).mean(axis=1)

    moved = by_row(mean.moved) / speed
    late = view.time + moved - by_row(row_time)
    length = np.sqrt(12 * (by_row(mean.square) / speed**2 - moved**2))
    return {
        "time": summary(np.abs(late) / (float(shutter.row_step) or exposure)),
        "width": float(np.mean(length)) / exposure - 1,
    }


def summary(error):
    """Median, 99th percentile and maximum."""
    return [float(value) for value in np.quantile(error, [0.5, 0.99, 1.0])]
