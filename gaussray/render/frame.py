"""A finished picture, and pictures made of pictures: of rows, segments and batches of samples."""

from collections.abc import Iterator, Sequence
from itertools import count as numbers

import equinox as eqx
import numpy as np
from jaxtyping import Float

from gaussray.camera.film import Film
from gaussray.render.options import BATCHES, RenderOptions


# Share of the pixels whose standard error is to be reached.
SHARE = 0.95


class Frame(eqx.Module):
    """A finished picture: linear light, coverage (1 - transmittance) and mean distance t of what is
    seen, with what it cost: `samples` rays per pixel. With `render.error`, `error` is the standard
    error of each pixel's colour, the worst of three channels."""

    color: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"]
    depth: Float[np.ndarray, "h w"]
    seconds: float
    hits: int
    compiled: bool
    samples: int
    error: Float[np.ndarray, "h w"] | None = None


def united(parts: Sequence[Frame]) -> Frame:
    """A frame from what every segment shows of it: where one sees nothing, it adds nothing."""
    if len(parts) == 1:
        return parts[0]
    alpha = sum(part.alpha for part in parts)
    way = sum(part.alpha * part.depth for part in parts)
    return Frame(
        np.sum([part.color for part in parts], axis=0),
        np.asarray(alpha),
        way / np.maximum(alpha, 1e-6),
        sum(part.seconds for part in parts),
        sum(part.hits for part in parts),
        any(part.compiled for part in parts),
        parts[0].samples,
    )


def settled(batches: Iterator[Frame], options: RenderOptions) -> Frame:
    """The mean of as many of the batches as `render.error` takes: running means, and sums of
    squares about them (Welford 1962)."""
    most = options.samples_most // options.samples
    mean = spread = error = np.zeros(())
    seconds, hits, compiled = 0.0, 0, False
    for count in numbers(1):
        frame = next(batches)
        seconds, hits = seconds + frame.seconds, hits + frame.hits
        compiled |= frame.compiled
        depth = frame.depth * frame.alpha
        told = np.dstack([frame.color, frame.alpha, depth]).astype(np.float64)
        away = told - mean
        mean = mean + away / count
        spread = spread + (away * (told - mean))[..., :3]
        if count >= BATCHES:
            error = np.sqrt(spread.max(axis=-1) / (count * (count - 1)))
            if count == most or np.quantile(error, SHARE) <= options.error:
                break
    told = np.dstack([mean[..., :4], mean[..., 4] / np.maximum(mean[..., 3], 1e-6)])
    color, alpha, depth = channels(told.astype(np.float32))
    used = count * options.samples
    return Frame(color, alpha, depth, seconds, hits, compiled, used, error.astype(np.float32))


def joined(film: Film, pieces: Sequence[tuple[int, np.ndarray]]) -> np.ndarray:
    """A picture from chunks of rows, each with its first row, which may overlap."""
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
