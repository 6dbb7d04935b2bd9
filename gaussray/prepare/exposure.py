"""Brightness of the same points in different cameras."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from gaussray.capture.picture_file import read_levels
from gaussray.color import srgb_decode, srgb_encode
from gaussray.prepare.placed_cameras import picture_name
from gaussray.prepare.placement import Placement


# Levels of 255 between which a channel tells its light: neither noise nor clipped.
_DARK, _BRIGHT = 12, 243
# Fewest shared points that say anything of a camera's exposure.
LEAST_SHARED = 20
_ROUNDS = 20
_TABLE = srgb_decode(np.arange(256) / 255.0)
# Percentile of a picture's levels that tells how bright it is, and every so many rows and columns
# of which it is taken.
_BRIGHTEST, _STRIDE = 95, 4
# Stops by which a picture is darker than most if nothing in it can be compared.
_DARKER = 2.0


class ObservedLevels(NamedTuple):
    """What the pictures show.

    Args:
        observed: 8-bit levels of each observation, means over 3 x 3 pixels.
        brightest: for each camera the level that few pixels of a picture exceed.
        clipped: for each camera the share of a picture that is too bright to tell its light.
    """

    observed: Float[np.ndarray, "n 3"]
    brightest: dict[str, float]
    clipped: dict[str, float]


def observed_levels(placement: Placement, files: dict[str, list]) -> ObservedLevels:
    """The levels of each observation, and of the pictures.

    Args:
        placement: observations, and keypoints with the timestamp of each.
        files: for each camera the file of each timestamp.
    """
    seen, model = placement.model.observations, placement.model
    levels = np.zeros((len(seen.point), 3))
    brightest, clipped = {}, {}
    for k, name in enumerate(model.pictures):
        lens, camera = model.lenses[k], placement.pictures[name].camera
        mine = np.flatnonzero(seen.picture == k)
        instants = placement.keypoints[name].instant[seen.keypoint[mine]]
        # A camera without observations has brightness, too.
        for instant in np.unique(instants) if len(instants) else [placement.pictures[name].instant]:
            here = mine[instants == instant]
            picture = read_levels(files[camera][instant], lens["w"], lens["h"])
            if camera not in brightest:
                shown = picture[::_STRIDE, ::_STRIDE]
                brightest[camera] = float(np.percentile(shown, _BRIGHTEST))
                clipped[camera] = float(np.mean((shown >= _BRIGHT).any(axis=2)))
            x, y = (np.clip(seen.xy[here, i].astype(int), 1, s - 2)
                    for i, s in ((0, lens["w"]), (1, lens["h"])))  # fmt: skip
            around = [picture[y + j, x + i] for i in (-1, 0, 1) for j in (-1, 0, 1)]
            levels[here] = np.mean(around, axis=0)
    return ObservedLevels(levels, brightest, clipped)


def exposure_gains(
    placement: Placement, levels: ObservedLevels
) -> dict[str, tuple[Float[np.ndarray, "3"], int]]:
    """How much brighter each camera records the same points than the mean of all cameras.

    Args:
        placement: observations of the points by the cameras.
        levels: those of each observation (`observed_levels`), of which nearly black and nearly
            white ones do not count, and of the pictures.

    Returns:
        For each camera the gain of each channel in stops, and the number of observations. With
        fewer than `LEAST_SHARED` of these the gain is 0, or, where the whole picture is much darker
        than those of the other cameras, how much.
    """
    names = [placement.pictures[name].camera for name in placement.model.pictures]
    cameras = {name: k for k, name in enumerate(dict.fromkeys(names))}
    gains, count = _gains(placement, levels, np.array([cameras[name] for name in names], int))
    dark = _darkness(levels.brightest, [n for n, k in cameras.items() if count[k] >= LEAST_SHARED])
    for name, k in cameras.items():
        if count[k] < LEAST_SHARED:
            gains[k] = dark.get(name, 0.0)
    return {name: (gains[k], int(count[k])) for name, k in cameras.items()}


def picture_gains(
    placement: Placement, levels: ObservedLevels
) -> dict[str, Float[np.ndarray, "3"]]:
    """How much brighter each picture of a camera on its way records the same points than the mean
    of its camera's pictures, in stops, by `picture_name`; of photographs, too. It is NaN for
    pictures with fewer than `LEAST_SHARED` observations; cameras with a single pose are left out.

    Args:
        placement: observations of the points by the pictures.
        levels: those of each observation (`observed_levels`).
    """
    names = placement.model.pictures
    cameras = np.array([placement.pictures[name].camera for name in names])
    if len(set(cameras.tolist())) == len(names):
        return {}
    gains, count = _gains(placement, levels, np.arange(len(names)))
    gains[count < LEAST_SHARED] = np.nan
    result = {}
    for camera in dict.fromkeys(cameras.tolist()):
        own = np.flatnonzero(cameras == camera)
        known = own[count[own] >= LEAST_SHARED]
        if len(own) > 1:
            apart = gains[own] - (gains[known].mean(axis=0) if len(known) else 0.0)
            called = [picture_name(placement.pictures[names[k]], placement) for k in own]
            result |= dict(zip(called, apart, strict=True))
    return result


def _gains(
    placement: Placement, levels: ObservedLevels, owner: Int[np.ndarray, " pictures"]
) -> tuple[Float[np.ndarray, "owners 3"], Int[np.ndarray, " owners"]]:
    """How much brighter each owner of pictures records the same points than the mean of all, in
    stops, and its number of observations; 0 with fewer than `LEAST_SHARED` of these.

    A point's light is the mean over its owners; an owner's gain is the median over its points; both
    are found in turns.
    """
    seen, owners = placement.model.observations, int(owner.max(initial=-1)) + 1
    good = ((levels.observed > _DARK) & (levels.observed < _BRIGHT)).all(axis=1)
    rows = np.flatnonzero(good)
    light = np.log2(_TABLE[np.clip(levels.observed[rows].round().astype(int), 0, 255)])
    point, own = seen.point[rows], owner[seen.picture[rows]]
    shared = _shared(point, own, len(placement.model.points))
    light, point, own = light[shared], point[shared], own[shared]
    gains, count = np.zeros((owners, 3)), np.bincount(own, minlength=owners)
    number = np.maximum(np.bincount(point, minlength=len(placement.model.points)), 1)
    known = count >= LEAST_SHARED
    order = np.argsort(own, kind="stable")
    ends = np.cumsum(count)
    for _ in range(_ROUNDS * bool(known.any())):
        free = light - gains[own]
        sums = [np.bincount(point, free[:, i], minlength=len(number)) for i in range(3)]
        off = (light - (np.stack(sums, axis=1) / number[:, None])[point])[order]
        for k in np.flatnonzero(known):
            gains[k] = np.median(off[ends[k] - count[k] : ends[k]], axis=0)
        gains[known] -= gains[known].mean(axis=0)
    return gains, count


def point_levels(placement: Placement, levels: ObservedLevels) -> np.ndarray:
    """8-bit colours [points, 3]: means over the observations in linear light.

    Args:
        placement: observations of the points.
        levels: those of each observation (`observed_levels`).
    """
    seen = placement.model.observations
    count = len(placement.model.points)
    light = srgb_decode(levels.observed / 255.0)
    number = np.maximum(np.bincount(seen.point, minlength=count), 1)
    mean = [np.bincount(seen.point, light[:, i], minlength=count) / number for i in range(3)]
    return np.floor(255 * srgb_encode(np.stack(mean, axis=1)) + 0.5).astype(np.uint8)


def _darkness(brightest: dict[str, float], known: list[str]) -> dict[str, float]:
    """Stops, below 0, of the cameras whose pictures are much darker than those of most that are
    known."""
    # A black picture has level 0, and no number of stops.
    light = {
        name: float(np.log2(np.interp(max(level, 1.0), np.arange(256), _TABLE)))
        for name, level in brightest.items()
    }
    if not known:
        return {}
    usual = float(np.median([light[name] for name in known]))
    return {name: own - usual for name, own in light.items() if own < usual - _DARKER}


def _shared(point: np.ndarray, camera: np.ndarray, count: int) -> np.ndarray:
    """Observations of points that at least two cameras see."""
    pairs = np.unique(np.stack([point, camera]), axis=1)
    return np.bincount(pairs[0], minlength=count)[point] >= 2
