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
from gaussray.reconstruct.checks.focal_check import (
    BETTER_FIT,
    FocalFit,
    MatchedPixels,
    explains,
    focal_fit,
)
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
# least so many matches (`explains`). Of eight captures five had matches in turned pairs: 0.3 to
# 1.2 pixels with their own axes, 2.6 to 31 with others. With a lens that is off, too, other axes
# need only explain them to the last number of pixels, but BETTER_FIT times as well as any others.
_DOUBTED, TELLING_MATCHES, _NEARLY = 1.5, 30, 5.0
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
        focal: the focal length with which they fit, with the poses as `PoseCheck.reading` has
            them; None if none is sought or found.
        joint: how poses must be read to fit with this focal length, where that alone tells nothing.
    """

    matches: int
    error: float
    others: dict[str, float]
    focal: FocalFit | None = None
    joint: str = ""

    @property
    def reading(self) -> str:
        """How the poses must be read to fit, or to fit far better; empty if as they are, or if
        that helps nowhere."""
        best = min(self.others, key=lambda name: self.others[name])
        error = self.others[best]
        if self.matches < TELLING_MATCHES:
            return ""
        if self.error > _DOUBTED and explains(error, self.error):
            return best
        rest = min([self.error, *(x for name, x in self.others.items() if name != best)])
        nearly = self.is_wrong() and error < min(_NEARLY, rest / BETTER_FIT)
        return best if nearly else ""

    def is_wrong(self, reading: str = "") -> bool:
        """Whether so many details lie so far off that poses are wrong.

        Args:
            reading: how poses are read; empty: as they are.
        """
        error = self.others.get(reading, self.error)
        return any(self.matches >= least and error > most for least, most in _WRONG)


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
        return self.near.reading or self.turned.reading or self.near.joint

    @property
    def sentence(self) -> str:
        """What is wrong; empty if nothing is, or if there are too few matches to tell."""
        wrong = self.near.is_wrong()
        if not (self.reading or wrong):
            return ""
        told = self.near if wrong or self.near.reading else self.turned
        text = (
            "pictures and poses do not fit together: details that neighbouring pictures share lie "
            f"{told.error:.1f} pixels off where the poses put them (median of {told.matches}; "
            "usual are less than 1). "
        )
        focal = self.near.focal
        if self.reading:
            text += self._reading_words
        if focal is not None:
            they, also = ("Then they", " also") if self.reading else ("They", "")
            text += (
                f"{they} fit ({focal.error:.1f} pixels) if the focal length is{also} "
                f"{focal.words}. Correct the capture first; then fit.refine=[pose,lens] mends "
                "small errors. "
            )
        if not self.reading and focal is None:
            text += (
                "Poses, lens or order may be those of other pictures, or two sides that look the "
                "same were taken for one; what is fitted to them is blurred. fit.refine=[pose] "
                "mends small errors; `gaussray prepare` finds the poses of the pictures anew."
            )
        return text.rstrip()

    @property
    def _reading_words(self) -> str:
        """How the poses must be read, and how far that helps."""
        source = self.near if self.near.reading else self.turned
        error, remedy = source.others[self.reading], REMEDIES[self.reading]
        if not source.reading:
            return f"The poses seem to be {remedy}. "
        if explains(error, source.error):
            return f"They fit if the poses are {remedy}. "
        text = f"They fit far better ({error:.1f} pixels) if the poses are {remedy}. "
        if self.near.focal is None:
            text += "Something else is off as well, such as the lens or single poses. "
        return text


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

    def matches(most_alike: float) -> list[_Match]:
        pairs = nearest_pairs(rotation, eye, most_alike)
        for k in {view for pair in pairs for view in pair} - seen.keys():
            seen[k] = _details(footage, int(chosen[k]))
        return [_Match(i, k, *_matched(seen[i], seen[k])) for i, k in pairs]

    def misfit(matched: list[_Match]) -> Misfit:
        errors = {
            name: np.concatenate([_off_line(turn, place, x) for x in matched] or [np.zeros(0)])
            for name, (turn, place) in readings.items()
        }
        count = len(errors[""])
        medians = {name: float(np.median(x)) if count else 0.0 for name, x in errors.items()}
        return Misfit(count, medians.pop(""), medians)

    matched = matches(1.0)
    found = PoseCheck(misfit(matched), misfit(matches(TURNED_COSINE)))
    if found.near.matches < TELLING_MATCHES or not found.near.is_wrong(found.reading):
        return found
    lens = jax.tree.map(lambda x: x[chosen], footage.camera.lens)
    pixels = [
        MatchedPixels(x.first, x.second, x.one.pixel, x.other.pixel, x.one.step) for x in matched
    ]
    # Where no reading helps alone, one may with another focal length; as they are comes first.
    for name in [found.reading] if found.reading else readings:
        focal = focal_fit(lens, footage.film.width, pixels, *readings[name])
        if focal and (name == found.reading or explains(focal.error, found.near.error)):
            joint = "" if found.reading else name
            return found._replace(near=found.near._replace(focal=focal, joint=joint))
    return found


class _Details(NamedTuple):
    """Details of a picture: where they are, their viewing directions, descriptors, the pixels of
    the picture that are one of the reduced picture, and the angle of that."""

    pixel: Float[np.ndarray, "details 2"]
    ray: Float[np.ndarray, "details 3"]
    descriptor: UInt8[np.ndarray, "details 128"]
    step: int
    angle: float

    def part(self, index: Int[np.ndarray, " n"]) -> "_Details":
        """Some of the details alone."""
        return self._replace(
            pixel=self.pixel[index], ray=self.ray[index], descriptor=self.descriptor[index]
        )


class _Match(NamedTuple):
    """Which details of two views match."""

    first: int
    second: int
    one: _Details
    other: _Details


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
        return _Details(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 128), np.uint8), 1, 1.0)
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
    return _Details(pixel[:-2], ray[:-2], descriptor, factor, angle).part(np.flatnonzero(lit))


@kept_jit
def _rays(lens: AbstractLens, pixel: Float[Array, "details 2"]) -> Float[Array, "details 3"]:
    return jax.vmap(lens.direction)(pixel)


def _matched(one: _Details, other: _Details) -> tuple[_Details, _Details]:
    """The details of both that match, in the same order."""
    pairs: Int[np.ndarray, "matches 2"] = np.zeros((0, 2), int)
    if min(len(one.ray), len(other.ray)) > 1:
        pairs = match_descriptors(
            one.descriptor, other.descriptor, max_ratio=_RATIO, cross_check=True
        )
    return one.part(pairs[:, 0]), other.part(pairs[:, 1])


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
    match: _Match,
) -> Float[np.ndarray, " matches"]:
    """Pixels between each detail of the second view and the plane of both cameras and the ray of
    the first."""
    first, second, one, other = match
    world = one.ray @ rotation[first].T, other.ray @ rotation[second].T
    return epipolar_angle(*world, eye[second] - eye[first]) * 2 / (one.angle + other.angle)
