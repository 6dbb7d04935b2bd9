"""Arrays of JAX and NumPy as PyTorch tensors, without a copy where that is possible."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
import torch

from gaussray.render.picture import Picture


# An item of a dataset; the entry `drawn` holds tensors by key.
Item = dict[str, Any]


def as_tensor(array: jax.Array | np.ndarray) -> torch.Tensor:
    """An array as a tensor on its device.

    The memory of a JAX array is shared by DLPack, that of a NumPy array if it is writable. A tensor
    that shares the memory of a JAX array must not be changed in place: JAX arrays are constant.
    """
    if isinstance(array, jax.Array):
        return torch.from_dlpack(array)
    return torch.from_numpy(array if array.flags.writeable else array.copy())


def picture_tensors(picture: Picture) -> dict[str, torch.Tensor]:
    """The values of a picture as tensors on the device where JAX has them, without a copy.

    Args:
        picture: the picture of `gaussray.render`.

    Returns:
        `color` [h, w, 3] (linear light), `alpha` [h, w] and `depth` [h, w]. They share the memory
        of the picture and must not be changed in place.
    """
    return {name: as_tensor(getattr(picture, name)) for name in ("color", "alpha", "depth")}


def channels_first(tensor: torch.Tensor) -> torch.Tensor:
    """[h, w, c] as [c, h, w], a view; other tensors as they are."""
    return tensor.permute(2, 0, 1) if tensor.ndim == 3 else tensor


def camera_tensors(
    pose: Sequence[Sequence[float]], time: float, times: torch.Tensor
) -> dict[str, torch.Tensor]:
    """The entries of an item that describe its camera: `pose` [4, 4], `time` [] and `pixel_times`
    [h, w].

    Args:
        pose: matrix from camera to world, in OpenGL axes.
        time: the frame's time, in the capture's unit.
        times: the middle of every pixel's exposure [h, w].
    """
    return {
        "pose": torch.tensor(pose, dtype=torch.float32),
        "time": torch.tensor(time, dtype=torch.float32),
        "pixel_times": times,
    }


def pixel_times(row_times: Sequence[float], direction: str, size: tuple[int, int]) -> torch.Tensor:
    """The middle of every pixel's exposure [h, w] from those of the rows, or of the columns where
    the shutter's direction is sideways; one time alone is that of all pixels.

    Args:
        row_times: times from the top, or from the left.
        direction: direction of the shutter, such as `top_to_bottom`.
        size: width and height of the picture.
    """
    times, (width, height) = torch.tensor(row_times, dtype=torch.float32), size
    sideways = direction in ("left_to_right", "right_to_left")
    return (times[None] if sideways else times[:, None]).expand(height, width)


def drawn_tensors(values: Mapping[str, Any]) -> Item:
    """The drawn values that are numbers, in double precision: seeds need all of it."""
    numbers = {key: x for key, x in values.items() if type(x) in (int, float)}
    return {key: torch.tensor(x, dtype=torch.float64) for key, x in numbers.items()}
