"""What a placement says about each of its cameras: name, lens, errors, distance to the next."""

import numpy as np

from gaussray.prepare.features import MatchingPicture
from gaussray.prepare.placement import Placement
from gaussray.prepare.sparse_model import camera_centres


def picture_name(picture: MatchingPicture, placement: Placement) -> str:
    """What messages call a picture. A camera that stands still has one pose, for which its name
    stands; a photograph is called as its file, with its camera if there are several.

    Args:
        picture: one of the placement.
        placement: the cameras that stand still, and all pictures.
    """
    if picture.camera in placement.still:
        return picture.camera
    if not picture.photograph:
        return f"{picture.camera} {picture.instant}"
    alone = len({other.camera for other in placement.pictures.values()}) == 1
    return picture.photograph if alone else f"{picture.camera}/{picture.photograph}"


def camera_lenses(placement: Placement) -> dict[str, dict]:
    """The lens of each registered camera by name."""
    model = placement.model
    return {
        placement.pictures[file].camera: lens
        for file, lens in zip(model.pictures, model.lenses, strict=True)
    }


def picture_errors(placement: Placement) -> dict[str, tuple[int, float, float]]:
    """Observations, median and 90th percentile of the errors in pixels, by camera."""
    seen, model = placement.model.observations, placement.model
    names = [placement.pictures[file].camera for file in model.pictures]
    result = {}
    for name in dict.fromkeys(names):
        mine = np.isin(seen.picture, [k for k, other in enumerate(names) if other == name])
        error = seen.error[mine]
        middle, high = np.percentile(error, [50, 90]) if len(error) else (np.nan, np.nan)
        pictures = names.count(name)
        result[name] = len(error) // pictures, float(middle), float(high)
    return result


def neighbour_angles(placement: Placement) -> np.ndarray:
    """For each picture the angle in degrees to the next one, seen from the middle of the points."""
    centres = camera_centres(placement.model)
    middle = np.median(placement.model.points, axis=0)
    direction = centres - middle
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    cosine = np.clip(direction @ direction.T, -1, 1)
    np.fill_diagonal(cosine, -1)
    return np.degrees(np.arccos(cosine.max(axis=1)))
