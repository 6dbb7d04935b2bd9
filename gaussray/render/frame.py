"""Rendered frames, and their assembly from strips of rows, segments and batches of samples."""

from collections.abc import Iterator, Sequence
from itertools import count as numbers
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from gaussray.camera.film import Film
from gaussray.render.options import BATCHES, RenderOptions


# Share of the pixels whose standard error must be at most `render.error`.
SHARE = 0.95


class Frame(eqx.Module):
    """A rendered frame, on the host.

    Args:
        color: linear light; 1 is white.
        alpha: coverage, 1 - transmittance.
        depth: mean distance along the ray, in scene units.
        seconds: time that the frame took.
        hits: hits of all rays.
        compiled: whether a program was compiled for it.
        samples: rays per pixel.
        error: with `render.error`, the standard error of each pixel's colour, the largest of three
            channels.
    """

    color: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    seconds: float
    hits: int
    compiled: bool
    samples: int
    error: Float[np.ndarray, "h w"] | None = None


class DevelopedFrame(NamedTuple):
    """A frame that was developed on its device.

    Args:
        values: what its development returned, on the host.
        samples: rays per pixel.
        error: as in `Frame`.
    """

    values: Any
    samples: int
    error: Float[np.ndarray, "h w"] | None = None


def merge_segments(parts: Sequence[Frame]) -> Frame:
    """Merge the frames of several segments, each without the rays of the others."""
    if len(parts) == 1:
        return parts[0]
    alpha = sum(part.alpha for part in parts)
    weighted_depth = sum(part.alpha * part.depth for part in parts)
    return Frame(
        np.sum([part.color for part in parts], axis=0),
        np.asarray(alpha),
        weighted_depth / np.maximum(alpha, 1e-6),
        sum(part.seconds for part in parts),
        sum(part.hits for part in parts),
        any(part.compiled for part in parts),
        parts[0].samples,
    )


def mean_until_error(batches: Iterator[Frame], options: RenderOptions) -> Frame:
    """The mean of as many batches of samples as `render.error` needs.

    Running means, and sums of squares about them (Welford 1962).

    Args:
        batches: frames of the batches.
        options: `error`, `samples` and `samples_most`.
    """
    most = options.samples_most // options.samples
    mean = squares = error = np.zeros(())
    seconds, hits, compiled = 0.0, 0, False
    for count in numbers(1):
        frame = next(batches)
        seconds, hits = seconds + frame.seconds, hits + frame.hits
        compiled |= frame.compiled
        depth = frame.depth * frame.alpha
        values = np.dstack([frame.color, frame.alpha, depth]).astype(np.float64)
        difference = values - mean
        mean = mean + difference / count
        squares = squares + (difference * (values - mean))[..., :3]
        if count >= BATCHES:
            error = np.sqrt(squares.max(axis=-1) / (count * (count - 1)))
            if count == most or np.quantile(error, SHARE) <= options.error:
                break
    values = np.dstack([mean[..., :4], mean[..., 4] / np.maximum(mean[..., 3], 1e-6)])
    color, alpha, depth = channels(values.astype(np.float32))
    used = count * options.samples
    return Frame(color, alpha, depth, seconds, hits, compiled, used, error.astype(np.float32))


def join_rows(film: Film, pieces: Sequence[tuple[int, np.ndarray]]) -> np.ndarray:
    """Assemble a picture from strips of rows, which may overlap.

    Args:
        film: size of the picture.
        pieces: first row and values of each strip.
    """
    if len(pieces) == 1:
        return pieces[0][1]
    first = pieces[0][1]
    whole = np.empty((film.height, film.width, *first.shape[2:]), first.dtype)
    for top, piece in pieces:
        whole[top : top + len(piece)] = piece
    return whole


def channels(values: Float[np.ndarray, "h w 5"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Colour, coverage and depth of a picture's values."""
    return values[..., :3], values[..., 3], values[..., 4]
