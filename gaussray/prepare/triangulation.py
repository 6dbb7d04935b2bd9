"""Points from matches, by cameras whose poses and lenses are known."""

import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.features import known_camera
from gaussray.prepare.lens_models import LensKeyValues
from gaussray.prepare.sparse_model import SparseModel, sparse_model_of


# Largest coefficient of a lens that is known: no limit.
ANY_COEFFICIENT = 1e12


def triangulate(
    database: Path,
    pictures: Path,
    poses: dict[str, Float[np.ndarray, "3 4"]],
    lenses: dict[str, LensKeyValues],
    most_error: float,
) -> SparseModel:
    """Points from matches and known cameras, which stay as they are.

    Args:
        database: keypoints and verified matches.
        pictures: folder of the pictures.
        poses: world to camera [3, 4] by file.
        lenses: lens by file.
        most_error: observations farther than this many pixels from their point are dropped.
    """
    colmap = pycolmap()
    reconstruction = colmap.Reconstruction()
    with colmap.Database.open(database) as db:
        for name, pose in poses.items():
            image = db.read_image_with_name(name)
            if image.camera_id not in reconstruction.cameras:
                camera = known_camera(lenses[name], image.camera_id)
                reconstruction.add_camera_with_trivial_rig(camera)
            placed = colmap.Image(name=name, camera_id=image.camera_id, image_id=image.image_id)
            rotation = colmap.Rotation3d(np.ascontiguousarray(pose[:, :3]))
            reconstruction.add_image_with_trivial_frame(
                placed, colmap.Rigid3d(rotation, pose[:, 3])
            )
    options = colmap.IncrementalPipelineOptions()
    options.extract_colors = False
    # Points of two views are kept: few cameras see a point three times.
    options.triangulation.ignore_two_view_tracks = False
    # Lenses are known: COLMAP leaves out cameras with a coefficient above 1 otherwise, as OpenCV's
    # calibrations have them (k3).
    options.max_extra_param = options.triangulation.max_extra_param = ANY_COEFFICIENT
    options.mapper.filter_max_reproj_error = most_error
    options.triangulation.complete_max_reproj_error = most_error
    options.triangulation.merge_max_reproj_error = most_error
    with tempfile.TemporaryDirectory() as out:
        result = colmap.triangulate_points(
            reconstruction, database, pictures, out, options=options, refine_intrinsics=False
        )
    return sparse_model_of(result)
