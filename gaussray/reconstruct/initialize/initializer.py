"""Which points the first Gaussians stand on: an initialiser, chosen by what the capture holds."""

import warnings
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from gaussray.capture.capture import Capture
from gaussray.capture.errors import CaptureWarning
from gaussray.capture.points import Points
from gaussray.geometry import rotation_matrix
from gaussray.reconstruct.data.pictures import Footage
from gaussray.reconstruct.initialize.from_points import between, in_common_view, inliers, merged
from gaussray.reconstruct.options import FitOptions


class InitialPoints(NamedTuple):
    """Positions in the world, and colours in linear light."""

    position: Float[np.ndarray, "points 3"]
    color: Float[np.ndarray, "points 3"]


@runtime_checkable
class PointSource(Protocol):
    """A function from a capture and its training pictures to points."""

    def __call__(
        self, capture: Capture, footage: Footage, options: FitOptions
    ) -> InitialPoints: ...


class Initializer(NamedTuple):
    """A source of points, and whether these lie `on_surfaces`.

    Only of points on surfaces the pictures tell at once which move, and connected groups of them
    are rigid bodies. Random Gaussians are added around them, and they stay in the scene even if no
    training ray meets them.
    """

    points: PointSource
    on_surfaces: bool


def initializer(capture: Capture) -> Initializer:
    """The initialiser for a capture: its own points if it has any, else random points."""
    if capture.points is not None:
        return Initializer(points_of_capture, on_surfaces=True)
    return Initializer(points_in_view, on_surfaces=False)


def points_of_capture(capture: Capture, footage: Footage, options: FitOptions) -> InitialPoints:
    """The points of the capture without duplicates and outliers; if they are fewer than
    fit.points, the missing ones are put between them."""
    assert capture.points is not None
    position, color = cleaned(capture.points, options.outliers)
    missing = max(options.points - len(position), 0) if len(position) else 0
    more = between(position, color, count=missing, seed=options.seed)
    return InitialPoints(np.concatenate([position, more[0]]), np.concatenate([color, more[1]]))


def points_in_view(capture: Capture, footage: Footage, options: FitOptions) -> InitialPoints:
    """fit.points random grey points where the cameras look."""
    pose = footage.camera.trajectory
    origin = np.asarray(pose.translation)[:, 0]
    axis = np.asarray(rotation_matrix(pose.quat[:, 0])[:, :, 2])
    return InitialPoints(*in_common_view(origin, axis, count=options.points, seed=options.seed))


def cleaned(points: Points, limit: float) -> InitialPoints:
    """The points without duplicates, and without those further than `limit` standard deviations
    from the others (0 keeps all). Warns of how many are left out."""
    count = len(points.position)
    position, color = merged(np.asarray(points.position), np.asarray(points.color))
    keep = inliers(position, limit) if limit else np.ones(len(position), bool)
    if not keep.all() or len(keep) < count:
        warnings.warn(
            f"of {count} starting points, {count - len(keep)} at the place of another and "
            f"{int((~keep).sum())} far from all others are left out. fit.outliers=0 keeps the "
            "latter.",
            CaptureWarning,
            stacklevel=3,
        )
    return InitialPoints(position[keep], color[keep])
