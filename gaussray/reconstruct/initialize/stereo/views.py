"""Pictures and cameras as stereo matching needs them: packed pixels, poses, viewing directions."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float, Int, Shaped

from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.shutter import sample_time
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import rotation_matrix
from gaussray.runtime.stored_programs import kept_jit


# Levels of a colour channel in a packed pixel, and the bit that holds its mask.
_LEVELS, _SHIFTS, _MASK_BIT = 1023, (0, 10, 20), 30

# Red, green and blue apart: XLA computes three arrays several times as fast as one with an axis of
# three.
Channels = tuple[Array, ...]


class StereoViews(eqx.Module):
    """Pictures with their lenses and poses; the leading axis is the view (one view has none).

    Args:
        pixel: sRGB-encoded red, green and blue in 10 bits each, and the mask in one more: a sample
            of a picture is then one number per corner, which CPUs gather four times as fast as four
            floats.
        lens: the lenses, for pixels of the whole films.
        world_from_camera: rotations from camera axes to the world.
        origin: positions of the cameras in the world.
        angle: mean angle between the rays of neighbouring pixels, in radians.
        factor: how many times smaller the pictures are than the films, an integer.
    """

    pixel: Int[Array, "*views h w"]
    lens: AbstractLens
    world_from_camera: Float[Array, "*views 3 3"]
    origin: Float[Array, "*views 3"]
    angle: Float[Array, "*views"]
    factor: int = eqx.field(static=True)

    def __getitem__(self, index) -> "StereoViews":
        """The views of this index."""
        return jax.tree.map(lambda x: x[index], self)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the pictures."""
        return self.pixel.shape[-2], self.pixel.shape[-1]


def stereo_views(
    pictures: Shaped[np.ndarray, "views h w 3"],
    cameras: Camera,
    masks: Bool[np.ndarray, "views h w"] | None,
    *,
    factor: int,
) -> StereoViews:
    """Views of reduced pictures, with the poses in the middle of their exposures.

    Args:
        pictures: sRGB-encoded, bytes or floats in 0..1.
        cameras: their cameras, stacked; any lens.
        masks: which pixels count; None is all. A reduced pixel counts if all of its own do.
        factor: integer by which the pictures are reduced; what is left over at the right and at the
            bottom is cut off.
    """
    pixel = np.stack(
        [
            _packed(picture, None if masks is None else masks[k], factor)
            for k, picture in enumerate(pictures)
        ]
    )
    lens, turn, origin, angle = _posed(cameras, factor, pixel.shape[1:])
    return StereoViews(jnp.asarray(pixel), lens, turn, origin, angle, factor)


def _packed(picture, mask, factor):
    """One picture as packed integers."""
    full = 255 if picture.dtype == np.uint8 else 1
    h, w = (n // factor for n in picture.shape[:2])
    every = np.ndindex(factor, factor)
    inside = picture[: h * factor, : w * factor]
    total = sum(inside[i::factor, j::factor].astype(np.float32) for i, j in every)
    mean = np.asarray(total) / (full * factor**2)
    level = np.round(np.clip(mean, 0, 1) * _LEVELS).astype(np.int32)
    seen = np.ones((h, w), bool)
    if mask is not None:
        blocks = mask[: h * factor, : w * factor].reshape(h, factor, w, factor)
        seen = blocks.all(axis=(1, 3))
    return level[..., 0] | level[..., 1] << 10 | level[..., 2] << 20 | seen << _MASK_BIT


@kept_jit
def _posed(cameras: Camera, factor: int, size: tuple[int, int]):
    """Lenses, rotations, origins and pixel angles of stacked cameras."""

    def one(camera: Camera):
        film, half = camera.film, jnp.asarray(0.5, camera.time.dtype)
        middle = jnp.asarray([film.width // 2, film.height // 2], camera.time.dtype)
        size_of_film = film.width, film.height
        time = sample_time(camera.shutter, middle, size_of_film, camera.time, half)
        pose = pose_at(camera.trajectory, time)
        turn = rotation_matrix(pose.quat)
        ray = rays(camera.lens, turn, size, factor)
        gap = jnp.sqrt(jnp.sum((ray[:, :, 1:] - ray[:, :, :-1]) ** 2, axis=0))
        both = jnp.any(ray[:, :, 1:] != 0, axis=0) & jnp.any(ray[:, :, :-1] != 0, axis=0)
        angle = jnp.sum(jnp.where(both, gap, 0)) / jnp.maximum(jnp.sum(both), 1)
        return camera.lens, turn, pose.translation, angle

    return jax.lax.map(one, cameras)


def rays(
    lens: AbstractLens, world_from_camera: Float[Array, "3 3"], size: tuple[int, int], factor: int
) -> Float[Array, "3 h w"]:
    """Unit viewing direction of every reduced pixel's centre, in the world; zero where the lens
    forms no ray.

    Args:
        lens: the lens, for pixels of the whole film.
        world_from_camera: rotation from camera axes to the world.
        size: rows and columns of the reduced picture.
        factor: integer by which the picture is reduced.
    """
    h, w = size
    y, x = jnp.meshgrid(jnp.arange(h), jnp.arange(w), indexing="ij")
    place = factor * (jnp.stack([x.ravel(), y.ravel()], axis=-1) + 0.5)
    local = jax.vmap(lens.direction)(place.astype(world_from_camera.dtype))
    return turned(world_from_camera, local.T.reshape(3, h, w))


def turned(matrix: Float[Array, "3 3"], vector: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    """A matrix times many vectors, in full precision on every device.

    Args:
        matrix: the matrix, a rotation for instance.
        vector: the vectors, components first.
    """
    return jnp.stack([sum(matrix[i, k] * vector[k] for k in range(3)) for i in range(3)])


def seen_at(
    views: StereoViews, point: Float[Array, "3 ..."]
) -> tuple[Float[Array, "views ..."], Float[Array, "views ..."], Bool[Array, "views ..."]]:
    """Where every view sees points of the world.

    Args:
        views: the views.
        point: places in the world, components first.

    Returns:
        Column and row in reduced pixels (centres at 0.5), and whether they lie within the picture
        with room for a bilinear sample. Where they do not, the place is 0.5.
    """
    h, w = views.size

    def one(view: StereoViews):
        from_camera = point - view.origin.reshape(3, *[1] * (point.ndim - 1))
        local = turned(view.world_from_camera.T, from_camera).reshape(3, -1)
        place = jax.vmap(view.lens.project, in_axes=-1, out_axes=-1)(local) / view.factor
        x, y = place.reshape(2, *point.shape[1:])
        # NaN, where the lens does not image the point, compares as outside.
        inside = (x >= 0.5) & (x <= w - 0.5) & (y >= 0.5) & (y <= h - 0.5)
        return jnp.where(inside, x, 0.5), jnp.where(inside, y, 0.5), inside

    return jax.vmap(one)(views)


def distance_from(views: StereoViews, point: Float[Array, "3 ..."]) -> Float[Array, "views ..."]:
    """Distance of points from every view's camera, in scene units.

    Args:
        views: the views.
        point: places in the world, components first.
    """
    shape = (-1, 3, *[1] * (point.ndim - 1))
    return jnp.sqrt(jnp.sum((point[None] - views.origin.reshape(shape)) ** 2, axis=1))


def corners(
    values: Shaped[Array, "views h w"], x: Float[Array, "views ..."], y: Float[Array, "views ..."]
) -> tuple[list[Shaped[Array, "views ..."]], Float[Array, "views ..."], Float[Array, "views ..."]]:
    """The four pixels around places of each view's picture (left and right above, then below), and
    the share of the right and of the lower ones in a bilinear sample.

    Args:
        values: one picture of each view.
        x: columns of the places, pixel centres at 0.5; beyond the picture its border counts.
        y: rows of the places.
    """
    count, h, w = values.shape
    left = jnp.clip(jnp.floor(x - 0.5), 0, w - 2)
    top = jnp.clip(jnp.floor(y - 0.5), 0, h - 2)
    first = (jnp.arange(count, dtype=jnp.int32) * (h * w)).reshape(-1, *[1] * (x.ndim - 1))
    index = first + top.astype(jnp.int32) * w + left.astype(jnp.int32)
    flat = values.reshape(-1)
    around = [flat.at[index + k].get(mode="promise_in_bounds") for k in (0, 1, w, w + 1)]
    # Otherwise a CPU gathers them anew for everything that is computed from them.
    around = jax.lax.optimization_barrier(around)
    return around, jnp.clip(x - 0.5 - left, 0, 1), jnp.clip(y - 0.5 - top, 0, 1)


def sampled(
    pixel: Int[Array, "views h w"], x: Float[Array, "views ..."], y: Float[Array, "views ..."]
) -> tuple[Channels, Bool[Array, "views ..."]]:
    """Bilinear colours of packed pictures, and whether all four pixels around a place are unmasked.

    Args:
        pixel: packed pixels of each view (`StereoViews.pixel`).
        x: columns of the places, pixel centres at 0.5.
        y: rows of the places.
    """
    around, fx, fy = corners(pixel, x, y)
    weights = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    channels = tuple(
        sum(
            weight * ((packed >> shift) & _LEVELS).astype(x.dtype)
            for packed, weight in zip(around, weights, strict=True)
        )
        / _LEVELS
        for shift in _SHIFTS
    )
    a, b, c, d = around
    return jax.lax.optimization_barrier(channels), ((a & b & c & d) >> _MASK_BIT) > 0


def halved(views: StereoViews) -> StereoViews:
    """The views with pictures of half the size; a pixel is masked where any of its four is."""
    h, w = (n // 2 for n in views.size)
    blocks = views.pixel[..., : 2 * h, : 2 * w].reshape(*views.pixel.shape[:-2], h, 2, w, 2)
    parts = [blocks[..., i, :, j] for i in (0, 1) for j in (0, 1)]
    pixel = functools.reduce(jnp.bitwise_and, parts) & (1 << _MASK_BIT)
    for shift in _SHIFTS:
        level = sum((part >> shift) & _LEVELS for part in parts)
        pixel = pixel | ((level + 2) // 4) << shift
    return StereoViews(
        pixel, views.lens, views.world_from_camera, views.origin, 2 * views.angle, 2 * views.factor
    )


def unpacked(pixel: Int[Array, "..."], dtype: DTypeLike) -> tuple[Channels, Bool[Array, "..."]]:
    """Colours (sRGB-encoded, in 0..1) of packed pixels, and which of them count.

    Args:
        pixel: packed pixels (`StereoViews.pixel`).
        dtype: precision of the colours.
    """
    channels = tuple(((pixel >> shift) & _LEVELS).astype(dtype) / _LEVELS for shift in _SHIFTS)
    return channels, (pixel >> _MASK_BIT) > 0


@kept_jit
def places_in_view(
    views: StereoViews, i: Int[Array, ""], position: Float[Array, "points 3"]
) -> tuple[Array, Array, Array, Array]:
    """Column, row and distance at which a view sees points, and whether it does.

    Args:
        views: all views.
        i: number of the view.
        position: the points, in the world.
    """
    alone = views[i[None]]
    column, row, inside = seen_at(alone, position.T)
    return column[0], row[0], distance_from(alone, position.T)[0], inside[0]
