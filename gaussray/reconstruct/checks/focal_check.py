"""Whether matched details would meet their epipolar lines with another focal length of all lenses.

A longer lens makes the angles between rays smaller, and those of a pixel, too. So distances are
counted in pixels of the tried lens, where each detail is: a lens that merely shrinks all angles
gains nothing. Turns of the cameras keep their angles, and tell which length is right; pictures
whose cameras only moved tell none.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.lens import AbstractLens
from gaussray.camera.lens.abstract import FocalLens
from gaussray.camera.lens.correctable import CorrectableLens
from gaussray.runtime.stored_programs import kept_jit


# Matches fit if they lie less than so many pixels off, and this many times less than before.
_FITTING, BETTER_FIT = 1.5, 3.0
# Factors on the focal length: of all of them, then as many between the neighbours of the best one.
_LEAST, _MOST, _FACTORS = 0.6, 1.6, 12
# The worst of the best three quarters must fit this much better, too: wrong poses are made up for
# in some pairs of pictures at the cost of others.
_MOST_MATCHES, _MOST_BETTER = 75, 2.0
# Pairs with so many matches that there must be: wrong poses of few pairs are made up for.
_PAIRS, _OF_A_PAIR = 3, 5
# Lenses whose focal lengths differ by less than this share have one.
_SAME = 1e-3


class MatchedPixels(NamedTuple):
    """Details that match in two views.

    Args:
        first: index of one view.
        second: index of the other one.
        pixel: where they are in the picture of the first view.
        other: where they are in that of the second one.
        step: pixels that are one in the count of errors.
    """

    first: int
    second: int
    pixel: Float[np.ndarray, "matches 2"]
    other: Float[np.ndarray, "matches 2"]
    step: float


class FocalFit(NamedTuple):
    """A focal length that explains matched details.

    Args:
        factor: how many times as long as the recorded one it is.
        error: median distance of the details from their epipolar lines with it, in pixels.
        recorded: the recorded one in pixels; None if lenses differ, or have none in pixels.
        width: width in pixels of the pictures that it belongs to.
    """

    factor: float
    error: float
    recorded: float | None
    width: int

    @property
    def words(self) -> str:
        """What the focal length should be."""
        text = f"{self.factor:.2f} times as long"
        if self.recorded is None:
            return text
        # Pictures may have been scaled since they were opened, so the factor comes first.
        return (
            f"{text}: multiply fl_x and fl_y by that ({self.factor * self.recorded:.0f} instead of "
            f"{self.recorded:.0f} pixels, in pictures {self.width} pixels wide)"
        )


def explains(error: float, recorded: float) -> bool:
    """Whether details fit, and so much better than as recorded that this is no chance.

    Args:
        error: median distance from the epipolar lines in pixels, as tried.
        recorded: the same as recorded.
    """
    return bool(error < min(_FITTING, recorded / BETTER_FIT))


def focal_fit(
    lens: AbstractLens,
    width: int,
    matched: list[MatchedPixels],
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
) -> FocalFit | None:
    """The focal length of all lenses with which details fit; None if none does.

    Args:
        lens: the stacked lenses of the views.
        width: width of their pictures in pixels.
        matched: the details that match.
        rotation: world from camera of each view.
        eye: position of each view in the world.
    """
    matched = [pair for pair in matched if len(pair.pixel)]
    pairs = sum(len(pair.pixel) >= _OF_A_PAIR for pair in matched)
    if not isinstance(lens, CorrectableLens) or pairs < _PAIRS:
        return None

    def errors(factors: Float[np.ndarray, " factors"]) -> Float[np.ndarray, "_ matches"]:
        # One more: the lens as it is. All calls have one number of factors, and share programs.
        tried = np.append(factors, 1.0)
        off = [line_distances(lens, pair, rotation, eye, tried) for pair in matched]
        return np.concatenate(off, axis=1)

    coarse = np.geomspace(_LEAST, _MOST, _FACTORS)
    step = coarse[1] / coarse[0]
    around = coarse[np.argmin(np.median(errors(coarse)[:-1], axis=1))]
    fine = around * np.geomspace(1 / step, step, _FACTORS)
    off = errors(fine)
    found, most = np.percentile(off, [50, _MOST_MATCHES], axis=1)
    best = int(np.argmin(found[:-1]))
    if best in (0, _FACTORS - 1) or not explains(found[best], found[-1]):
        return None
    if most[best] > most[-1] / _MOST_BETTER:
        return None
    recorded = None
    if isinstance(lens, FocalLens):
        focal = np.asarray(lens.focal)[..., 0]
        recorded = float(focal.flat[0]) if np.ptp(focal) < _SAME * focal.max() else None
    return FocalFit(float(fine[best]), float(found[best]), recorded, width)


def line_distances(
    lens: CorrectableLens,
    pair: MatchedPixels,
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
    factors: Float[np.ndarray, " factors"],
) -> Float[np.ndarray, "factors matches"]:
    """Pixels between each detail of the second view and the line of what the first one sees, to
    first order: what is to vanish by its gradient over the picture. Infinite without a ray.

    Args:
        lens: the stacked lenses of the views.
        pair: the details, and the pixels that count as one.
        rotation: world from camera of each view.
        eye: position of each view in the world.
        factors: factors on the focal length that are tried.
    """

    def rays(view: int, pixel: Float[np.ndarray, "matches 2"]) -> np.ndarray:
        # Sizes that are powers of 2: few programs.
        filled = np.full((1 << max(5, (len(pixel) - 1).bit_length()), 2), pixel[0], np.float32)
        filled[: len(pixel)] = pixel
        found = _scaled_rays(
            jax.tree.map(lambda x: x[view], lens),
            jnp.asarray(filled),
            jnp.float32(pair.step),
            jnp.asarray(factors),
        )
        return np.asarray(found, np.float64)[:, :, : len(pixel)] @ rotation[view].T

    one, other = rays(pair.first, pair.pixel)[:, 0], rays(pair.second, pair.other)
    normal = np.cross(one, eye[pair.second] - eye[pair.first])
    off, right, below = np.moveaxis(np.einsum("fmi,fpmi->fpm", normal, other), 1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = np.abs(off) / np.hypot(right - off, below - off)
    seen = np.any(one != 0, axis=-1) & np.all(np.any(other != 0, axis=-1), axis=1)
    return np.where(seen & np.isfinite(pixels), pixels, np.inf)


@kept_jit
def _scaled_rays(
    lens: CorrectableLens,
    pixel: Float[Array, "details 2"],
    step: Float[Array, ""],
    factors: Float[Array, " factors"],
) -> Float[Array, "factors 3 details 3"]:
    """Directions of pixels, of those a step to the right, and of those a step below."""
    near = jnp.stack([jnp.zeros(2), jnp.array([1.0, 0]), jnp.array([0, 1.0])]) * step
    none = jnp.zeros(lens.coefficient_values.shape[-1:], pixel.dtype)

    def directions(factor: Float[Array, ""]) -> Float[Array, "3 details 3"]:
        scaled = lens.corrected(factor, jnp.zeros(2, pixel.dtype), none)
        around = pixel[None] + near[:, None].astype(pixel.dtype)
        return jax.vmap(jax.vmap(scaled.direction))(around)

    return jax.vmap(directions)(factors.astype(pixel.dtype))
