"""Whether pictures and poses belong together: matched details must lie on their epipolar lines.

Details of neighbouring pictures are matched by their looks alone (SIFT, Lowe 2004). The rays of a
match and the line between both cameras lie in one plane if the poses are right. Axes of another
convention, or poses of other pictures, leave them tens of pixels off, which no fit can mend.
"""

import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8
from skimage.feature import SIFT, match_descriptors
from skimage.measure import block_reduce

from gaussray.camera.lens import AbstractLens
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.spread import evenly_spread, spread_indices
from gaussray.geometry import BLENDER_AXES, epipolar_angle, rotation_matrix
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.initialize.stereo.matching import reduction
from gaussray.runtime.stored_programs import kept_jit


# Pictures among which neighbours are sought, and pairs of them that are compared.
_VIEWS, _PAIRS = 24, 6
# Pixels of a picture in which details are sought, at most, and details of one, the strongest.
_PIXELS, _DETAILS = 70_000, 600
# Least cosine between the directions in which neighbours look: else they share little. Below the
# other one they look so differently that wrong axes show: these leave details of neighbours that
# look the same way less than a pixel off.
_ALIKE, TURNED_COSINE = 0.8, 0.97
# A match is believed if the second best is this much worse (Lowe's ratio).
_RATIO = 0.8
# Pixels of the reduced pictures off their lines, in the median, from which on poses are wrong, by
# the least number of matches: few may be wrong themselves, many are not. Wrong matches, and lenses
# that are a little off, cost less.
_WRONG = ((15, 10.0), (40, 4.0), (150, 1.5))
# Poses must be read otherwise if they are more than so many pixels off, and other axes explain at
# least so many matches to less than the last number, and so many times as well. Of eight captures
# five had matches in turned pairs: 0.3 to 1.2 pixels with their own axes, 2.6 to 31 with others.
_DOUBTED, TELLING_MATCHES, _BETTER, _RIGHT = 1.5, 30, 3.0, 1.5
_FLIP = np.diag(BLENDER_AXES)

# What the poses of a file may be instead, and what to do about it.
REMEDIES = {
    "opencv": "camera-to-world matrices in OpenCV's axes (x right, y down, z forward). Captures "
    "have OpenGL's: negate the second and the third column of each transform_matrix",
    "inverse": "world-to-camera matrices. Captures have camera-to-world ones: invert each "
    "transform_matrix",
    "opencv_inverse": "world-to-camera matrices in OpenCV's axes, as COLMAP writes them. Captures "
    "have camera-to-world ones in OpenGL's: invert each transform_matrix, then negate its second "
    "and third column",
}


class Misfit(NamedTuple):
    """How far the matched details of some pairs of pictures lie off their epipolar lines.

    Args:
        matches: number of matches, of all pairs.
        error: median distance in pixels of pictures of at most 70,000 pixels, as the poses are.
        others: the same as the poses would be, read otherwise (REMEDIES).
    """

    matches: int
    error: float
    others: dict[str, float]

    @property
    def reading(self) -> str:
        """How the poses must be read so that they fit; empty if as they are, or if none does."""
        best = min(self.others, key=lambda name: self.others[name])
        doubted = self.matches >= TELLING_MATCHES and self.error > _DOUBTED
        right = self.others[best] < min(_RIGHT, self.error / _BETTER)
        return best if doubted and right else ""


class PoseCheck(NamedTuple):
    """What matched details say of the poses.

    Args:
        near: those of pictures taken close to each other.
        turned: those of pictures that look in different directions.
    """

    near: Misfit
    turned: Misfit

    @property
    def reading(self) -> str:
        """How the poses must be read so that they fit; empty if as they are, or if none does."""
        return self.near.reading or self.turned.reading

    @property
    def sentence(self) -> str:
        """What is wrong; empty if nothing is, or if there are too few matches to tell."""
        count, error, _ = self.near
        wrong = any(count >= least and error > most for least, most in _WRONG)
        if not (self.reading or wrong):
            return ""
        if self.reading and not (wrong or self.near.reading):
            count, error, _ = self.turned
        text = (
            "pictures and poses do not fit together: details that neighbouring pictures share lie "
            f"{error:.1f} pixels off where the poses put them (median of {count}; usual are less "
            "than 1). "
        )
        if self.reading:
            return f"{text}They fit if the poses are {REMEDIES[self.reading]}."
        return (
            f"{text}Poses, lens or order may be those of other pictures, or two sides that look "
            "the same were taken for one; what is fitted to them is blurred. fit.refine=[pose] "
            "mends small errors; `gaussray prepare` finds the poses of the pictures anew."
        )


def warn_of_wrong_poses(footage: Footage) -> None:
    """Warn of poses that contradict the pictures (`pose_check`)."""
    sentence = pose_check(footage).sentence
    if sentence:
        warnings.warn(sentence, CaptureWarning, stacklevel=2)


def pose_check(footage: Footage) -> PoseCheck:
    """Compare matched details of some pairs of neighbouring pictures with the poses.

    Args:
        footage: the training pictures and their cameras. Of each viewpoint the first one counts.
    """
    _, first = np.unique(footage.viewpoints, return_index=True)
    first = np.sort(first)
    chosen = first[spread_indices(len(first), _VIEWS)]
    pose = jax.tree.map(lambda x: np.asarray(x)[chosen, 0], footage.camera.trajectory)
    rotation = np.asarray(rotation_matrix(jnp.asarray(pose.quat)), np.float64)
    eye = np.asarray(pose.translation, np.float64)
    readings = {
        "": (rotation, eye),
        "opencv": (rotation @ _FLIP, eye),
        "inverse": _inverse(rotation @ _FLIP, eye, _FLIP),
        "opencv_inverse": _inverse(rotation @ _FLIP, eye, np.eye(3)),
    }
    seen: dict[int, _Details] = {}

    def misfit(most_alike: float) -> Misfit:
        matched = []
        for pair in nearest_pairs(rotation, eye, most_alike):
            for k in pair:
                if k not in seen:
                    seen[k] = _details(footage, int(chosen[k]))
            matched.append((*pair, *_matches(seen[pair[0]], seen[pair[1]])))
        errors = {
            name: np.concatenate([_off_line(*poses, *match) for match in matched] or [np.zeros(0)])
            for name, poses in readings.items()
        }
        count = len(errors[""])
        medians = {name: float(np.median(x)) if count else 0.0 for name, x in errors.items()}
        return Misfit(count, medians.pop(""), medians)

    return PoseCheck(misfit(1.0), misfit(TURNED_COSINE))


class _Details(NamedTuple):
    """Details of a picture: their viewing directions, descriptors, and the angle of a pixel."""

    ray: Float[np.ndarray, "details 3"]
    descriptor: UInt8[np.ndarray, "details 128"]
    angle: float


def nearest_pairs(
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
    most_alike: float,
) -> list[tuple[int, int]]:
    """Pairs of views that look about the same way and stand close to each other, evenly spread.

    Args:
        rotation: world from camera of each view.
        eye: position of each view in the world.
        most_alike: greatest cosine between the directions in which the views of a pair look.
    """
    apart = np.linalg.norm(eye[:, None] - eye[None], axis=-1)
    alike = rotation[:, :, 2] @ rotation[:, :, 2].T
    apart[(alike < _ALIKE) | (alike > most_alike) | (apart == 0)] = np.inf
    nearest = np.argmin(apart, axis=1)
    found = {
        (min(k, int(n)), max(k, int(n))) for k, n in enumerate(nearest) if np.isfinite(apart[k, n])
    }
    return evenly_spread(sorted(found), _PAIRS)


def _details(footage: Footage, frame: int) -> _Details:
    """The strongest details of a picture."""
    picture, masks = footage.pictures(np.array([frame]))[0], footage.masks(np.array([frame]))
    grey = np.asarray(picture, np.float64).mean(axis=-1) / footage.scale
    factor = reduction(grey.shape, _PIXELS)
    rows, columns = footage.film.height // factor, footage.film.width // factor
    small = block_reduce(grey, factor, np.mean)[:rows, :columns]
    sift = SIFT(upsampling=1)
    try:
        sift.detect_and_extract(small)
    except RuntimeError:  # there is none
        return _Details(np.zeros((0, 3)), np.zeros((0, 128), np.uint8), 1.0)
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
    ray = ray[: len(strongest)]
    lit = np.any(ray != 0, axis=-1)
    return _Details(ray[lit], np.asarray(sift.descriptors)[strongest][lit], angle)


@kept_jit
def _rays(lens: AbstractLens, pixel: Float[Array, "details 2"]) -> Float[Array, "details 3"]:
    return jax.vmap(lens.direction)(pixel)


def _matches(one: _Details, other: _Details) -> tuple[np.ndarray, np.ndarray, float]:
    """Viewing directions in both cameras of the details that match, and the angle of a pixel."""
    pairs: Int[np.ndarray, "matches 2"] = np.zeros((0, 2), int)
    if min(len(one.ray), len(other.ray)) > 1:
        pairs = match_descriptors(
            one.descriptor, other.descriptor, max_ratio=_RATIO, cross_check=True
        )
    return one.ray[pairs[:, 0]], other.ray[pairs[:, 1]], (one.angle + other.angle) / 2


def _inverse(
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
    axes: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "views 3 3"], Float[np.ndarray, "views 3"]]:
    """Rotations and places if matrices of these are world-to-camera ones, in cameras' own axes."""
    turned = np.swapaxes(rotation, 1, 2)
    return turned @ axes, -np.einsum("vij,vj->vi", turned, eye)


def _off_line(
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
    first: int,
    second: int,
    ray: Float[np.ndarray, "matches 3"],
    other: Float[np.ndarray, "matches 3"],
    angle: float,
) -> Float[np.ndarray, " matches"]:
    """Pixels between each detail of the second view and the plane of both cameras and the ray of
    the first."""
    world = ray @ rotation[first].T, other @ rotation[second].T
    return epipolar_angle(*world, eye[second] - eye[first]) / angle
