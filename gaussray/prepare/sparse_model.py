"""Poses, lenses and points of a reconstruction, as arrays."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.lens_models import (
    LensKeyValues,
    fisheye_angles,
    fisheye_radii,
    from_colmap,
    to_colmap,
)
from gaussray.prepare.pose_math import camera_centre


@dataclasses.dataclass(frozen=True, eq=False)
class Observations:
    """Where points are seen: for each observation its point, picture, keypoint, pixel and error.

    Args:
        point: index of the point.
        picture: index into `SparseModel.pictures`.
        keypoint: index of the picture's keypoint.
        xy: pixel of the keypoint (centres at 0.5).
        error: distance in pixels from the projection of the point.
    """

    point: Int[np.ndarray, " n"]
    picture: Int[np.ndarray, " n"]
    keypoint: Int[np.ndarray, " n"]
    xy: Float[np.ndarray, "n 2"]
    error: Float[np.ndarray, " n"]


@dataclasses.dataclass(frozen=True, eq=False)
class SparseModel:
    """Poses, lenses and points.

    Args:
        pictures: files of the registered pictures.
        poses: world to camera [3, 4] of each, OpenCV axes.
        lenses: lens of each, keys of a capture's JSON.
        points: points in world space.
        observations: where they are seen.
        focal_source: what tells the focal lengths: a `calibration`, a `lens` that was given
            (`poses.lens`), the `pictures`, what was `expected` before (`poses.fov`, EXIF), or
            nothing: a `guess`.
    """

    pictures: list[str]
    poses: Float[np.ndarray, "pictures 3 4"]
    lenses: list[LensKeyValues]
    points: Float[np.ndarray, "points 3"]
    observations: Observations
    focal_source: str = "calibration"


def sparse_model_of(reconstruction: Any) -> SparseModel:
    """The arrays of a COLMAP reconstruction."""
    registered = (reconstruction.image(i) for i in reconstruction.reg_image_ids())
    # Numbers are in the order in which threads ended; names are in the order of time.
    images = sorted(registered, key=lambda image: image.name)
    index = {image.image_id: k for k, image in enumerate(images)}
    poses = [image.cam_from_world().matrix() for image in images]
    lenses = [
        from_colmap(c.model.name, c.width, c.height, c.params)
        for c in (image.camera for image in images)
    ]
    numbers = sorted(reconstruction.point3D_ids())
    points = np.array([reconstruction.point3D(i).xyz for i in numbers]).reshape(-1, 3)
    rows = []
    for k, number in enumerate(numbers):
        for element in reconstruction.point3D(number).track.elements:
            rows.append((k, index[element.image_id], element.point2D_idx))
    table = np.array(rows, int).reshape(-1, 3)
    xy = np.array([images[p].points2D[q].xy for _, p, q in table.tolist()], np.float64).reshape(
        -1, 2
    )
    order = np.lexsort((table[:, 2], table[:, 1], table[:, 0]))
    table, xy = table[order], xy[order]
    poses = np.array(poses).reshape(-1, 3, 4)
    error = np.zeros(len(table))
    for k in range(len(images)):
        seen = table[:, 1] == k
        pixels, _ = project_points(lenses[k], poses[k], points[table[seen, 0]])
        error[seen] = np.linalg.norm(pixels - xy[seen], axis=1)
    columns = table[:, 0], table[:, 1], table[:, 2]
    names = [image.name for image in images]
    return SparseModel(names, poses, lenses, points, Observations(*columns, xy, error))


def project_points(
    lens: LensKeyValues, pose: Float[np.ndarray, "3 4"], points: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Pixels of world points, NaN where a lens cannot image them, and their depths.

    Args:
        lens: lens of the camera.
        pose: world to camera, OpenCV axes.
        points: positions in the world.

    Returns:
        Pixels (centres at 0.5), and depths along the optical axis in scene units.
    """
    inside = points @ pose[:, :3].T + pose[:, 3]
    pixels = np.full((len(points), 2), np.nan)
    ahead = inside[:, 2] > 1e-9
    if "FISHEYE" in lens["camera_model"]:
        pixels = _fisheye_pixels(lens, inside)
    elif ahead.any():
        pixels[ahead] = camera_of(lens).img_from_cam(inside[ahead])
    return pixels, inside[:, 2]


def _fisheye_pixels(
    lens: LensKeyValues, inside: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """Pixels of points in camera axes, also of those beyond 90 degrees."""
    across = np.linalg.norm(inside[:, :2], axis=1)
    radius = fisheye_radii(lens, np.arctan2(across, inside[:, 2]))
    stretch = np.where(across > 0, radius / np.where(across > 0, across, 1), 0)
    focal, centre = np.array([lens["fl_x"], lens["fl_y"]]), np.array([lens["cx"], lens["cy"]])
    return centre + focal * stretch[:, None] * inside[:, :2]


def pixel_rays(lens: LensKeyValues, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Unit viewing directions of pixels in camera axes, NaN where the lens has none.

    Args:
        lens: lens of the camera.
        pixels: column and row of each place, pixel centres at 0.5.
    """
    if "FISHEYE" in lens["camera_model"]:
        focal, centre = np.array([lens["fl_x"], lens["fl_y"]]), np.array([lens["cx"], lens["cy"]])
        across = (pixels - centre) / focal
        radius = np.linalg.norm(across, axis=1)
        angle = fisheye_angles(lens, radius)
        stretch = np.where(radius > 0, np.sin(angle) / np.where(radius > 0, radius, 1), 1)
        return np.column_stack([stretch[:, None] * across, np.cos(angle)])
    directions = np.array(camera_of(lens).cam_ray_from_img(pixels), np.float64).reshape(-1, 3)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def camera_of(lens: LensKeyValues) -> Any:
    """The COLMAP camera of a lens."""
    model, parameters = to_colmap(lens)
    return pycolmap().Camera(model=model, width=lens["w"], height=lens["h"], params=parameters)


def camera_centres(model: SparseModel) -> Float[np.ndarray, "pictures 3"]:
    """Positions of the cameras in world space."""
    return camera_centre(model.poses)


def kept_pictures(model: SparseModel, keep: Bool[np.ndarray, " pictures"]) -> SparseModel:
    """The model of a part of its pictures, with the points that two of them see.

    Args:
        model: poses, lenses and points.
        keep: which of its pictures are kept.
    """
    seen = model.observations
    mine = keep[seen.picture]
    views = np.bincount(seen.point[mine], minlength=len(model.points))
    mine &= views[seen.point] > 1
    point, picture = np.cumsum(views > 1) - 1, np.cumsum(keep) - 1
    observations = Observations(
        point[seen.point[mine]],
        picture[seen.picture[mine]],
        seen.keypoint[mine],
        seen.xy[mine],
        seen.error[mine],
    )
    kept = np.flatnonzero(keep)
    return dataclasses.replace(
        model,
        pictures=[model.pictures[k] for k in kept],
        poses=model.poses[kept],
        lenses=[model.lenses[k] for k in kept],
        points=model.points[views > 1],
        observations=observations,
    )


def observations_by_picture(model: SparseModel) -> Int[np.ndarray, " pictures"]:
    """Number of observations of each registered picture."""
    return np.bincount(model.observations.picture, minlength=len(model.pictures))
