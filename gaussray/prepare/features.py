"""SIFT features of the pictures and their matches, in a database of COLMAP."""

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.lens_models import MODEL_OF_CHOICE, LensKeyValues, start_focal, to_colmap
from gaussray.prepare.options import PosesOptions
from gaussray.runtime.progress import Progress, say


# Up to so many pictures all pairs are matched; of more, neighbours in time and far ones in steps.
EXHAUSTIVE = 100
_NEAR, _STRIDE = 12, 10
# Pairs that are matched, and pictures in which features are found, between two reports of progress.
_BLOCK, _PICTURES = 200, 16
# Pairs from which on a line tells their number.
_TOLD = 20


@dataclasses.dataclass(frozen=True)
class MatchingPicture:
    """A picture whose features are matched.

    Args:
        file: its file below the folder.
        camera: name of its camera.
        instant: index of its timestamp.
        size: columns and rows.
        photograph: name of the user's file that it is; empty for a frame of a video.
    """

    file: str
    camera: str
    instant: int
    size: tuple[int, int]
    photograph: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Keypoints:
    """Feature positions in pixels (centres at 0.5) and the timestamp at which each was seen."""

    xy: Float[np.ndarray, "n 2"]
    instant: Int[np.ndarray, " n"]


def extract_features(
    database: Path,
    folder: Path,
    groups: Sequence[Sequence[MatchingPicture]],
    options: PosesOptions,
    masks: Path | None = None,
) -> None:
    """Find the features of all pictures; the pictures of a group share their intrinsics.

    Pictures are listed before their features are found: listed by the threads that find them, they
    would be numbered in the order in which these end, and poses would differ from run to run.

    Args:
        database: COLMAP database that is written.
        folder: folder below which the pictures' files lie.
        groups: pictures that share intrinsics, all of one size.
        options: lens model, rough field of view, and most features of a picture.
        masks: folder of masks, named as the pictures and `.png`; features in their black pixels are
            left out. None: all count.
    """
    colmap = pycolmap()
    colmap.Database.open(database).close()
    extraction = colmap.FeatureExtractionOptions()
    extraction.sift.max_num_features = options.features
    done, progress = 0, Progress("features", sum(map(len, groups)), patience=2.0)
    for group in groups:
        reader = colmap.ImageReaderOptions()
        reader.camera_model = MODEL_OF_CHOICE[options.model]
        factor = start_focal(options.model, options.fov, *group[0].size)
        reader.default_focal_length_factor = factor
        if masks is not None:
            reader.mask_path = masks
        files, mode = [picture.file for picture in group], colmap.CameraMode.SINGLE
        colmap.import_images(database, folder, mode, files, reader)
        for first in range(0, len(files), _PICTURES):
            block = files[first : first + _PICTURES]
            colmap.extract_features(
                database,
                folder,
                block,
                camera_mode=mode,
                reader_options=reader,
                extraction_options=extraction,
            )
            done += len(block)
            progress.report(done)
    if options.model == "opencv_fisheye":
        _trust_start_focal(database)


def _trust_start_focal(database: Path) -> None:
    """Have matches verified by rays, for which even a rough focal length serves: no fundamental
    matrix explains the bent epipolar lines of a fisheye. The focal length is estimated all the
    same."""
    with pycolmap().Database.open(database) as db:
        for camera in db.read_all_cameras():
            camera.has_prior_focal_length = True
            db.update_camera(camera)


def set_lenses(database: Path, lenses: dict[str, LensKeyValues]) -> None:
    """Replace the intrinsics of a database by known ones, which then are not estimated.

    Args:
        database: COLMAP database that lists the pictures.
        lenses: lens of each file; files of one camera in the database have one lens.
    """
    colmap = pycolmap()
    with colmap.Database.open(database) as db:
        seen = set()
        for image in db.read_all_images():
            if image.camera_id in seen:
                continue
            seen.add(image.camera_id)
            db.update_camera(known_camera(lenses[image.name], image.camera_id))


def known_camera(lens: LensKeyValues, number: int) -> Any:
    """A COLMAP camera with known parameters.

    Args:
        lens: lens with the size of its pictures.
        number: identifier of the camera in the database.
    """
    model, parameters = to_colmap(lens)
    camera = pycolmap().Camera(
        model=model, width=lens["w"], height=lens["h"], params=parameters, camera_id=number
    )
    camera.has_prior_focal_length = True
    return camera


def match_features(database: Path, pairs: Sequence[tuple[str, str]], seed: int) -> None:
    """Match the features of pairs of pictures, and keep what one geometry explains.

    Args:
        database: COLMAP database with the features; the matches are added to it.
        pairs: files of the two pictures of each pair.
        seed: seed of RANSAC, which finds the geometry.
    """
    colmap = pycolmap()
    if len(pairs) > _TOLD:
        say(f"Features of {len(pairs)} pairs of pictures are matched.")
    listed, options = database.with_suffix(".pairs.txt"), colmap.ImportedPairingOptions()
    options.match_list_path = listed
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    progress = Progress("matching", len(pairs), patience=2.0)
    for first in range(0, len(pairs), _BLOCK):
        block = pairs[first : first + _BLOCK]
        listed.write_text("".join(f"{a} {b}\n" for a, b in block), encoding="utf-8")
        colmap.match_image_pairs(
            database, pairing_options=options, verification_options=verification
        )
        progress.report(first + len(block))


def matched_pairs(
    pictures: Sequence[MatchingPicture], still: Collection[str]
) -> list[tuple[str, str]]:
    """The pairs of pictures that are matched.

    Two cameras that stand still are matched timestamp by timestamp, and a picture of a camera that
    moves with the timestamp of each of them that is next to its own.

    Args:
        pictures: pictures of all cameras, of those that stand still at a few timestamps.
        still: names of the cameras that stand still.
    """
    fixed = [one for one in pictures if one.camera in still]
    moving = [one for one in pictures if one.camera not in still]
    pairs = _same_instant_pairs(fixed) + _moving_pairs(moving)
    for name in dict.fromkeys(one.camera for one in fixed):
        own = [one for one in fixed if one.camera == name]
        for other in moving:
            nearest = min(own, key=lambda one: abs(one.instant - other.instant))
            pairs.append((nearest.file, other.file))
    return pairs


def _moving_pairs(pictures: Sequence[MatchingPicture]) -> list[tuple[str, str]]:
    """The pairs of pictures of moving cameras or of photographs that are matched."""
    if len(pictures) <= EXHAUSTIVE:
        return [(a.file, b.file) for a, b in combinations(pictures, 2)]
    cameras = {name: k for k, name in enumerate(dict.fromkeys(p.camera for p in pictures))}

    def matched(a: MatchingPicture, b: MatchingPicture) -> bool:
        gap = abs(a.instant - b.instant)
        far = a.instant % _STRIDE == 0 and b.instant % _STRIDE == 0
        near = _NEAR if a.camera == b.camera else 1
        return gap <= near or far and abs(cameras[a.camera] - cameras[b.camera]) <= _NEAR

    return [(a.file, b.file) for a, b in combinations(pictures, 2) if matched(a, b)]


def _same_instant_pairs(pictures: Sequence[MatchingPicture]) -> list[tuple[str, str]]:
    """Pairs of pictures of two cameras at one timestamp."""
    return [
        (a.file, b.file)
        for a, b in combinations(pictures, 2)
        if a.camera != b.camera and a.instant == b.instant
    ]


def read_keypoints(database: Path, pictures: Iterable[MatchingPicture]) -> dict[str, Keypoints]:
    """The keypoints of each picture, by file.

    Args:
        database: COLMAP database with the features.
        pictures: pictures whose keypoints are read; all of one have its timestamp.
    """
    with pycolmap().Database.open(database) as db:
        result = {}
        for picture in pictures:
            image = db.read_image_with_name(picture.file)
            xy = db.read_keypoints(image.image_id)[:, :2].astype(np.float64)
            result[picture.file] = Keypoints(xy, np.full(len(xy), picture.instant))
    return result


def median_features(database: Path) -> float:
    """The number of features of a picture, the median of all pictures of a database."""
    with pycolmap().Database.open(database) as db:
        numbers = [image.image_id for image in db.read_all_images()]
        return float(np.median([db.num_keypoints_for_image(number) for number in numbers]))


def verified_matches(database: Path) -> dict[tuple[str, str], Int[np.ndarray, "m 2"]]:
    """Verified matches of each pair of files: indices of keypoints that one geometry explains."""
    with pycolmap().Database.open(database) as db:
        numbers, geometries = db.read_two_view_geometries()
        return _by_names(db, numbers, [geometry.inlier_matches for geometry in geometries])


def raw_matches(database: Path) -> dict[tuple[str, str], Int[np.ndarray, "m 2"]]:
    """Matches of each pair of files by their features alone, before geometric verification."""
    with pycolmap().Database.open(database) as db:
        return _by_names(db, *db.read_all_matches())


def _by_names(
    db: Any, numbers: Sequence[int], matches: Sequence[Any]
) -> dict[tuple[str, str], Int[np.ndarray, "m 2"]]:
    """Matches by the names of their two files, those of pairs that have any, whatever the numbers
    of the pictures: in the order of names, which is that of cameras and times."""
    names = {image.image_id: image.name for image in db.read_all_images()}
    found = {}
    for number, pairs in zip(numbers, matches, strict=True):
        if len(pairs):
            a, b = (names[k] for k in pycolmap().pair_id_to_image_pair(number))
            rows = np.array(pairs, int).reshape(-1, 2)
            found[min(a, b), max(a, b)] = rows if a < b else rows[:, ::-1]
    return dict(sorted(found.items()))
