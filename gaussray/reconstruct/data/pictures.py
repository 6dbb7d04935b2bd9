"""Training pictures on the host: in memory, or in a file where they would not fit."""

import dataclasses
import functools
import os
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int, Shaped, UInt8

from gaussray.camera.camera import Camera
from gaussray.camera.film import Film
from gaussray.capture.capture import View, viewpoints
from gaussray.capture.errors import CaptureError, CaptureWarning
from gaussray.capture.frames import is_masked, visible_pixels
from gaussray.capture.picture_stream import stream_encoded
from gaussray.capture.same_lens import array_layout
from gaussray.reconstruct.data.tiles import (
    cut,
    fitting_side,
    join,
    places_in_tiles,
    tile_pixels,
)


# Masks that keep a smaller share of the pixels are warned of.
_FEW_VISIBLE = 0.05


@dataclasses.dataclass(frozen=True, eq=False)
class Footage:
    """Every training picture with its camera; the leading axis is the frame.

    Pictures are stored as square tiles, so that the pixels of a training step are contiguous.

    Args:
        pixel: sRGB-encoded colours: 8-bit levels, or float32 in 0..1 if any file has more bits.
            The pixels of a tile are in the order in which their rays are traced (`tile_order`).
        mask: one bit per pixel, packed into bytes, 0 where the pixel is ignored; None if no view
            has a mask.
        camera: the stacked cameras.
        name: the camera's name.
        side: pixels along the side of a tile.
        bundle: pixels along the side of a ray bundle; None: a tile is one bundle.
        viewpoint: label of the fixed viewpoint (`viewpoints`); None: the name.
    """

    pixel: Shaped[np.ndarray, "frames tiles pixels 3"]
    mask: UInt8[np.ndarray, "frames tiles bytes"] | None
    camera: Camera
    name: Shaped[np.ndarray, " frames"]
    side: int
    bundle: int | None = None
    viewpoint: Shaped[np.ndarray, " frames"] | None = None

    @property
    def viewpoints(self) -> Shaped[np.ndarray, " frames"]:
        """Label of each frame's fixed viewpoint: frames that share one show the same directions.

        The frames of a camera that moves share its name, but no viewpoint.
        """
        return self.name if self.viewpoint is None else self.viewpoint

    @functools.cached_property
    def medians(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """What `median_picture` has found, by the first frame of each camera."""
        return {}

    @functools.cached_property
    def places(self) -> Int[np.ndarray, "h w"]:
        """Where among the pixels of a frame's tiles each pixel of the picture is."""
        return places_in_tiles(tile_pixels(self.film, self.side, self.bundle), self.film)

    @property
    def film(self) -> Film:
        """Size of every picture."""
        return self.camera.film

    @property
    def times(self) -> np.ndarray:
        """Time of every picture."""
        return np.asarray(self.camera.time)

    @property
    def scale(self) -> int:
        """The value of `pixel` that stands for 1: 255 for 8-bit levels, else 1."""
        return 255 if self.pixel.dtype == np.uint8 else 1

    def visible(self, *index) -> Bool[np.ndarray, "*index pixels"] | None:
        """Which pixels of the frames and tiles at this index count; None if all do."""
        if self.mask is None:
            return None
        return np.unpackbits(self.mask[index], axis=-1, count=self.side**2).astype(bool)

    def visible_tiles(self) -> Bool[np.ndarray, "frames tiles"] | None:
        """Tiles of which any pixel counts; None if all do."""
        return None if self.mask is None else np.any(self.mask, axis=-1)

    def part(self, frames: Int[np.ndarray, " n"]) -> "Footage":
        """Some of the pictures alone, with their cameras."""
        return dataclasses.replace(
            self,
            pixel=self.pixel[frames],
            mask=None if self.mask is None else self.mask[frames],
            camera=jax.tree.map(lambda x: x[frames], self.camera),
            name=self.name[frames],
            viewpoint=None if self.viewpoint is None else self.viewpoint[frames],
        )

    def pictures(self, frames: Int[np.ndarray, " n"]) -> Shaped[np.ndarray, "n h w 3"]:
        """Whole pictures."""
        return np.stack([join(self.pixel[frame], self.places) for frame in frames])

    def masks(self, frames: Int[np.ndarray, " n"]) -> Bool[np.ndarray, "n h w"] | None:
        """Which pixels of whole pictures count; None if all do."""
        visible = self.visible(frames)
        return None if visible is None else np.stack([join(x, self.places) for x in visible])


def footage(
    views: Sequence[View],
    *,
    side: int,
    bundle: int | None = None,
    memory: float = 4.0,
    folder: Path | str | None = None,
    report: Callable[[int], object] = lambda done: None,
) -> Footage:
    """Read the pictures of views as tiles.

    Args:
        views: training views, whose cameras must be of one kind.
        side: the largest side of a tile, in pixels.
        bundle: pixels along the side of a ray bundle.
        memory: gigabytes of pictures that are kept in memory. More are kept in a temporary file
            that is mapped into memory and that the system removes with the footage.
        folder: folder of the temporary file; None for the system's own.
        report: called with the number of pictures read, after each picture.

    Raises:
        CaptureError: there are no views, or cameras or pictures differ in kind or size.
        OSError: a picture cannot be read, or the disk is full.
    """
    camera = stacked(views)
    side = fitting_side(camera.film, side, bundle or side)
    pixels = tile_pixels(camera.film, side, bundle)
    masked = any(is_masked(view) for view in views)

    def in_tiles(frame: int, picture: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        tiles = cut(picture, pixels)
        visible = cut(visible_pixels(views[frame]), pixels) if masked else None
        return tiles, None if visible is None else np.packbits(visible, axis=-1)

    dtype, pictures = stream_encoded(views, in_tiles)
    shape = (len(views), *pixels.shape, 3)
    packed = (len(views), len(pixels), -(-(side**2) // 8))
    size = np.prod(shape) * dtype.itemsize + masked * np.prod(packed)
    room = np.empty if size <= 1e9 * memory else _on_disk(folder)
    pixel = room(shape, dtype)
    mask = room(packed, np.dtype(np.uint8)) if masked else None
    for done, (frame, (tiles, visible)) in enumerate(pictures):
        pixel[frame] = tiles
        if mask is not None:
            mask[frame] = visible
        report(done + 1)
    if mask is not None:
        _warn_of_masks(sum(int(np.unpackbits(row).sum()) for row in mask), len(views), camera)
    names = np.array([view.camera_name for view in views])
    return Footage(pixel, mask, camera, names, side, bundle, np.array(viewpoints(views)))


def _warn_of_masks(visible: int, frames: int, camera: Camera) -> None:
    share = visible / (frames * camera.film.width * camera.film.height)
    if share < _FEW_VISIBLE:
        warnings.warn(
            f"masks keep {100 * share:.2g} % of the training pixels; others do not count. White "
            "counts in a mask: invert the masks if they mark what is to be left out.",
            CaptureWarning,
            stacklevel=3,
        )


def stacked(views: Sequence[View]) -> Camera:
    """The cameras of training views, which must be of one kind.

    Raises:
        CaptureError: there is no view, or the views differ in size, lens model, film or shutter.
    """
    if not views:
        raise CaptureError(
            "capture.path holds no view of split 'train'. Mark some frames with "
            '"split": "train" in transforms.json.'
        )
    first = array_layout(views[0].camera)
    for view in views:
        if array_layout(view.camera) != first:
            raise CaptureError(
                f"{view.image}: training views must share one size, lens model, film, shutter and "
                f"number of poses, but this one differs from {views[0].image}. Reconstruct from "
                "the pictures of one kind of camera."
            )
    # On the host: a device takes long to join thousands of small arrays.
    cameras = jax.device_get([view.camera for view in views])
    return jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *cameras)


def _on_disk(folder: Path | str | None) -> Callable[[tuple[int, ...], np.dtype], np.ndarray]:
    """A function that makes arrays in unnamed temporary files, removed with the arrays."""

    def empty(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        size = int(np.prod(shape)) * dtype.itemsize
        where = Path(folder or tempfile.gettempdir())
        try:
            where.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=where) as file:
                # Reserve the space now: writing to a map on a full disk would kill the process.
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(file.fileno(), 0, size)
                return np.memmap(file, dtype, "w+", shape=shape)
        except OSError as error:
            raise OSError(
                f"{where}: the training pictures take {size / 1e9:.1f} GB and cannot be kept there "
                f"({error.strerror}). Free the disk, raise fit.memory, or lower capture.scale."
            ) from error

    return empty
