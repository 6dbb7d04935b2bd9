"""Details of pictures that match by their looks alone (SIFT, Lowe 2004), beside their poses."""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8
from skimage.feature import SIFT, match_descriptors
from skimage.measure import block_reduce

from gaussray.camera.lens import AbstractLens
from gaussray.capture.spread import spread_indices
from gaussray.geometry import epipolar_angle, rotation_matrix
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.initialize.stereo.matching import reduction
from gaussray.runtime.stored_programs import kept_jit


# Pictures that are compared, at most.
_VIEWS = 24
# Pixels of a picture in which details are sought, at most, and details of one, the strongest.
_PIXELS, _DETAILS = 70_000, 600
# A match is believed if the second best is this much worse (Lowe's ratio).
_RATIO = 0.8
# Fewest matches of a pair that tell something: of fewer, most may be wrong.
FEWEST_MATCHES = 15
# Least cosine between the directions in which neighbours look: else they share little.
_ALIKE = 0.8
# Matches of a pair are of one thing if at least so large a share of them and so many lie on the
# lines of one geometry of both cameras, to so many pixels; any eight do. In pairs of four captures
# 0.7 and more do, of two views of a calibration board 0.45.
_SHARE, _MANY, _CLOSE = 0.6, 13, 1.5
# Geometries that are tried, each of eight matches; the best so many are fitted to all that lie
# close, so many times.
_EIGHT, _TRIALS, _BEST, _ROUNDS = 8, 300, 10, 3


class Details(NamedTuple):
    """Details of a picture: where they are, their viewing directions, descriptors, the pixels of
    the picture that are one of the reduced picture, and the angle of that."""

    pixel: Float[np.ndarray, "details 2"]
    ray: Float[np.ndarray, "details 3"]
    descriptor: UInt8[np.ndarray, "details 128"]
    step: int
    angle: float

    def part(self, index: Int[np.ndarray, " n"]) -> "Details":
        """Some of the details alone."""
        return self._replace(
            pixel=self.pixel[index], ray=self.ray[index], descriptor=self.descriptor[index]
        )


class DetailMatch(NamedTuple):
    """Which details of two views match."""

    first: int
    second: int
    one: Details
    other: Details


class PosedViews:
    """Some of the training pictures, evenly spread, of each viewpoint the first one, with their
    details and poses.

    Args:
        footage: the training pictures and their cameras.
    """

    def __init__(self, footage: Footage) -> None:
        _, first = np.unique(footage.viewpoints, return_index=True)
        first = np.sort(first)
        self.footage = footage
        # The frames of the pictures.
        self.chosen = first[spread_indices(len(first), _VIEWS)]
        pose = jax.tree.map(lambda x: np.asarray(x)[self.chosen, 0], footage.camera.trajectory)
        # World from camera, and positions in the world.
        self.rotation = np.asarray(rotation_matrix(jnp.asarray(pose.quat)), np.float64)
        self.eye = np.asarray(pose.translation, np.float64)
        self._details: dict[int, Details] = {}
        self._matches: dict[tuple[int, int], DetailMatch] = {}

    def matches(self, pairs: Iterable[tuple[int, int]]) -> list[DetailMatch]:
        """The details that match in each pair of views."""
        pairs = list(pairs)
        for i, k in pairs:
            if (i, k) not in self._matches:
                found = matched_details(self._of(i), self._of(k))
                self._matches[i, k] = DetailMatch(i, k, *found)
        return [self._matches[pair] for pair in pairs]

    def _of(self, view: int) -> Details:
        if view not in self._details:
            self._details[view] = picture_details(self.footage, int(self.chosen[view]))
        return self._details[view]


def line_offsets(
    match: DetailMatch,
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
) -> Float[np.ndarray, " matches"]:
    """Pixels between each detail of the second view and the plane of both cameras and the ray of
    the first.

    Args:
        match: the details of two views.
        rotation: world from camera of each view.
        eye: position of each view in the world.
    """
    first, second, one, other = match
    world = one.ray @ rotation[first].T, other.ray @ rotation[second].T
    return epipolar_angle(*world, eye[second] - eye[first]) * 2 / (one.angle + other.angle)


def is_of_one_thing(match: DetailMatch) -> bool:
    """Whether most matches fit some pose of both cameras, so that one which they do not fit is to
    blame; not where a pattern repeats, whose parts are taken for each other.

    Geometries through eight matches each are tried (Longuet-Higgins 1981), and the best ones fitted
    to all matches that lie close to their lines (Sampson 1982), by rays: through any lens, and
    whatever its focal length.

    Args:
        match: the details of two views.
    """
    # Rays as alike in all directions as they can be, on which a linear fit is well-conditioned.
    (one, to_one), (other, to_other) = (_evened(x.ray) for x in (match.one, match.other))
    count = len(one)
    if count < _MANY:
        return False
    products = np.einsum("mi,mk->mik", other, one).reshape(count, 9)
    angle = _CLOSE * (match.one.angle + match.other.angle) / 2

    def lying_close(geometry: Float[np.ndarray, "tried 3 3"]) -> Bool[np.ndarray, "tried matches"]:
        essential = to_other.T @ geometry @ to_one
        normal = np.einsum("tik,mk->tmi", essential, match.one.ray)
        opposite = np.einsum("tki,mk->tmi", essential, match.other.ray)
        off = np.abs(np.einsum("tmi,mi->tm", normal, match.other.ray))
        squares = np.sum(normal**2 + opposite**2, axis=-1)
        return off < angle * np.sqrt(squares)

    order = np.random.default_rng(0).random((_TRIALS, count)).argsort(axis=1)[:, :_EIGHT]
    close = lying_close(np.linalg.svd(products[order])[2][:, -1].reshape(-1, 3, 3))
    close = close[np.argsort(-close.sum(axis=1), kind="stable")[:_BEST]]
    most = close.sum(axis=1).max()
    for _ in range(_ROUNDS):
        moments = np.einsum("tm,mi,mk->tik", close, products, products)
        close = lying_close(np.linalg.eigh(moments)[1][:, :, 0].reshape(-1, 3, 3))
        most = max(most, close.sum(axis=1).max())
    return bool(most >= max(_MANY, _SHARE * count))


def _evened(
    ray: Float[np.ndarray, "matches 3"],
) -> tuple[Float[np.ndarray, "matches 3"], Float[np.ndarray, "3 3"]]:
    """Rays through a linear map that makes their second moments the identity, and this map."""
    moments = ray.T @ ray / max(len(ray), 1) + 1e-12 * np.eye(3)
    to_even = np.linalg.inv(np.linalg.cholesky(moments))
    return ray @ to_even.T, to_even


def nearest_pairs(
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
    most_alike: float = 1.0,
    neighbours: int = 1,
) -> list[tuple[int, int]]:
    """Pairs of views that look about the same way and stand close to each other.

    Args:
        rotation: world from camera of each view.
        eye: position of each view in the world.
        most_alike: greatest cosine between the directions in which the views of a pair look.
        neighbours: with so many of its nearest ones a view is a pair.
    """
    apart = np.linalg.norm(eye[:, None] - eye[None], axis=-1)
    alike = rotation[:, :, 2] @ rotation[:, :, 2].T
    apart[(alike < _ALIKE) | (alike > most_alike) | (apart == 0)] = np.inf
    nearest = np.argsort(apart, axis=1, kind="stable")[:, :neighbours]
    found = {
        (min(k, int(n)), max(k, int(n)))
        for k, row in enumerate(nearest)
        for n in row
        if np.isfinite(apart[k, n])
    }
    return sorted(found)


def picture_details(footage: Footage, frame: int) -> Details:
    """The strongest details of a picture.

    Args:
        footage: the pictures and their cameras.
        frame: index of the picture.
    """
    picture, masks = footage.pictures(np.array([frame]))[0], footage.masks(np.array([frame]))
    grey = np.asarray(picture, np.float64).mean(axis=-1) / footage.scale
    factor = reduction(grey.shape, _PIXELS)
    rows, columns = footage.film.height // factor, footage.film.width // factor
    small = block_reduce(grey, factor, np.mean)[:rows, :columns]
    sift = SIFT(upsampling=1)
    try:
        sift.detect_and_extract(small)
    except RuntimeError:  # there is none
        return Details(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 128), np.uint8), 1, 1.0)
    position = np.asarray(sift.positions)
    kept = np.ones(len(position), bool)
    if masks is not None:
        last = np.array(masks[0].shape) - 1
        kept = masks[0][tuple(np.minimum((factor * (position + 0.5)).astype(int), last).T)]
    strongest = np.flatnonzero(kept)[np.argsort(-np.asarray(sift.sigmas)[kept], kind="stable")]
    strongest = strongest[:_DETAILS]
    lens = jax.tree.map(lambda x: x[frame], footage.camera.lens)
    # One size for all pictures: equal lenses share a program.
    pixel = np.zeros((_DETAILS + 2, 2))
    pixel[: len(strongest)] = factor * (position[strongest, ::-1] + 0.5)
    pixel[-2:] = np.array([footage.film.width, footage.film.height]) / 2
    pixel[-1, 0] += factor
    ray = np.asarray(_rays(lens, jnp.asarray(pixel, jnp.float32)), np.float64)
    angle = float(np.linalg.norm(ray[-1] - ray[-2])) or 1.0
    lit = np.any(ray[: len(strongest)] != 0, axis=-1)
    descriptor = np.asarray(sift.descriptors)[strongest]
    return Details(pixel[:-2], ray[:-2], descriptor, factor, angle).part(np.flatnonzero(lit))


@kept_jit
def _rays(lens: AbstractLens, pixel: Float[Array, "details 2"]) -> Float[Array, "details 3"]:
    return jax.vmap(lens.direction)(pixel)


def matched_details(one: Details, other: Details) -> tuple[Details, Details]:
    """The details of both that match, in the same order.

    Args:
        one: the details of a picture.
        other: those of another one.
    """
    pairs: Int[np.ndarray, "matches 2"] = np.zeros((0, 2), int)
    if min(len(one.ray), len(other.ray)) > 1:
        pairs = match_descriptors(
            one.descriptor, other.descriptor, max_ratio=_RATIO, cross_check=True
        )
    return one.part(pairs[:, 0]), other.part(pairs[:, 1])
