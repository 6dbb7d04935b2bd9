"""Whether pictures and poses belong together: matched details must lie on their epipolar lines.

Details of neighbouring pictures are matched by their looks alone (SIFT, Lowe 2004). The rays of a
match and the line between both cameras lie in one plane if the poses are right. Axes of another
convention, or poses of other pictures, leave them tens of pixels off, which no fit can mend.
"""

import math
import warnings
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from gaussray.capture.errors import CaptureWarning
from gaussray.capture.spread import evenly_spread
from gaussray.geometry import BLENDER_AXES
from gaussray.reconstruct.checks.focal_check import (
    BETTER_FIT,
    FocalFit,
    MatchedPixels,
    explains,
    focal_fit,
)
from gaussray.reconstruct.checks.matched_details import (
    FEWEST_MATCHES,
    DetailMatch,
    PosedViews,
    is_of_one_thing,
    line_offsets,
    nearest_pairs,
)
from gaussray.reconstruct.checks.odd_views import odd_views_sentence
from gaussray.reconstruct.data.pictures import Footage


# Pairs of neighbouring pictures that are compared.
_PAIRS = 6
# Pictures look so differently that wrong axes show if the cosine between their directions is less:
# these leave details of neighbours that look the same way less than a pixel off.
TURNED_COSINE = 0.97
# Pixels of the reduced pictures off their lines, in the median, from which on poses are wrong, by
# the least number of matches: few may be wrong themselves, many are not. Wrong matches, and lenses
# that are a little off, cost less.
_WRONG = ((FEWEST_MATCHES, 10.0), (40, 4.0), (150, 1.5))
# Of fewer matches than the first number in all, a quarter must lie farther off than so many pixels,
# too: more than half may be wrong themselves, but wrong poses leave next to none where they are.
_FEW, _QUARTER = _WRONG[1][0], 1.25
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
        quarter: distance in pixels below which a quarter of the details lie, as the poses are.
    """

    matches: int
    error: float
    others: dict[str, float]
    focal: FocalFit | None = None
    joint: str = ""
    quarter: float = math.inf

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
        if not reading and self.matches < _FEW and self.quarter <= _QUARTER:
            return False
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
                "mends small errors; `gaussray prepare` finds poses anew, or, of cameras that "
                "stand still, tells how far a calibration is off (poses.calibration=FILE). If "
                "details merely look alike, as those of a pattern that repeats, the poses may be "
                "right: keep them."
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
    """Warn of poses that contradict the pictures (`pose_check`), all or those of single cameras."""
    views = PosedViews(footage)
    found = _checked(views)
    sentence = found.sentence
    if not (found.reading or found.near.focal):
        sentence = odd_views_sentence(views) or sentence
    if sentence:
        warnings.warn(sentence, CaptureWarning, stacklevel=2)


def pose_check(footage: Footage) -> PoseCheck:
    """Compare matched details of some pairs of neighbouring pictures with the poses.

    Args:
        footage: the training pictures and their cameras. Of each viewpoint the first one counts.
    """
    return _checked(PosedViews(footage))


def _checked(views: PosedViews) -> PoseCheck:
    """The result of `pose_check`."""
    footage, rotation, eye = views.footage, views.rotation, views.eye
    readings = {
        "": (rotation, eye),
        "opencv": (rotation @ _FLIP, eye),
        "inverse": _read_as_world_to_camera(rotation @ _FLIP, eye, _FLIP),
        "opencv_inverse": _read_as_world_to_camera(rotation @ _FLIP, eye, np.eye(3)),
    }

    def misfit(matched: list[DetailMatch]) -> Misfit:
        errors = {
            name: np.concatenate([line_offsets(x, *poses) for x in matched] or [np.zeros(0)])
            for name, poses in readings.items()
        }
        count = len(errors[""])
        medians = {name: float(np.median(x)) if count else 0.0 for name, x in errors.items()}
        quarter = float(np.percentile(errors[""], 25)) if count else 0.0
        return Misfit(count, medians.pop(""), medians, quarter=quarter)

    def near(most_alike: float) -> list[DetailMatch]:
        pairs = evenly_spread(nearest_pairs(rotation, eye, most_alike), _PAIRS)
        found = views.matches(pairs)
        # More matches tell nothing unless most of them fit some pose.
        return [x for x in found if len(x.one.ray) < FEWEST_MATCHES or is_of_one_thing(x)]

    matched = near(1.0)
    found = PoseCheck(misfit(matched), misfit(near(TURNED_COSINE)))
    if found.near.matches < TELLING_MATCHES or not found.near.is_wrong(found.reading):
        return found
    lens = jax.tree.map(lambda x: x[views.chosen], footage.camera.lens)
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


def _read_as_world_to_camera(
    rotation: Float[np.ndarray, "views 3 3"],
    eye: Float[np.ndarray, "views 3"],
    axes: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "views 3 3"], Float[np.ndarray, "views 3"]]:
    """Rotations and places if matrices of these are world-to-camera ones, in cameras' own axes."""
    turned = np.swapaxes(rotation, 1, 2)
    return turned @ axes, -np.einsum("vij,vj->vi", turned, eye)
