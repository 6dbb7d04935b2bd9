"""Poses from matches: estimated together with lenses, or known and triangulated only."""

import contextlib
import contextvars
import dataclasses
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from gaussray.prepare.colmap import pycolmap
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.focal_length import (
    adjusted_reconstruction,
    expected_focal_lengths,
    settled_focal_length,
)
from gaussray.prepare.lens_check import lens_complaint
from gaussray.prepare.lens_models import MODEL_OF_CHOICE, from_colmap
from gaussray.prepare.missing_poses import (
    FIRST_PAIR,
    FIRST_PAIR_AT_LAST,
    MOSTLY_FLAT,
    best_pair,
    flat_pairs,
    lacks_parallax,
    missing_poses_reason,
)
from gaussray.prepare.options import PosesOptions
from gaussray.prepare.sparse_model import SparseModel, sparse_model_of
from gaussray.prepare.triangulation import ANY_COEFFICIENT
from gaussray.runtime.output import counted
from gaussray.runtime.progress import Progress, say
from gaussray.runtime.side_by_side import GivenUp


# Choices of poses.model that are tried without distortion if they fail.
_STRAIGHTENED = ("radial", "opencv")
# Seconds after which it is told that the mapper works, also while it places no picture.
_BEAT = 10.0
# Fewest pictures of a reconstruction, and those with which each attempt begins.
_LEAST, _FIRST = 2, 2
# Of two pictures alone, no third one can confirm a point: angles in degrees between the rays of the
# first pair's points (the median), and of any point, from which on they count. COLMAP's own, 16 and
# 1.5, are for choosing between pairs; two cameras side by side see a room at 2 to 5.
_PAIR_ANGLE, _POINT_ANGLE = 1.5, 0.1


def verify(database: Path, seed: int) -> None:
    """Find which matches of each pair one geometry explains.

    Args:
        database: COLMAP database with keypoints and matches; the verified ones are added.
        seed: seed of RANSAC, which finds the geometry.
    """
    colmap = pycolmap()
    options = colmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    colmap.geometric_verification(database, two_view_geometry_options=options)


def estimate_poses(
    database: Path, pictures: Path, options: PosesOptions, still: bool = False, once: bool = False
) -> SparseModel:
    """Poses, lenses and points by incremental structure from motion.

    Args:
        database: COLMAP database with keypoints and verified matches.
        pictures: folder of the pictures.
        options: lens model, rough field of view and seed.
        still: whether pictures hold the features of several timestamps of a camera.
        once: whether a single attempt is made, because it is likely to fail.

    Returns:
        Of several reconstructions the one with most pictures, in an arbitrary frame and scale.
        Where the pictures do not tell the focal length, it is a likely one
        (`settled_focal_length`). Where few of the pictures get a pose, or a lens that none is, this
        is tried once more without distortion, which few pictures bend at will.

    Raises:
        PrepareError: No poses or no points are found; the message says why.
    """
    with pycolmap().Database.open(database) as db:
        total = db.num_images()
    if total < _LEAST:
        raise PrepareError(missing_poses_reason(database, still))
    attempts = "" if once else ", if need be in several attempts"
    say(f"Poses of {total} pictures are estimated{attempts}.")
    found = _reconstruction(database, pictures, options)
    # Of pictures from one place, more tries find points that are none, and without a pair to begin
    # with they find nothing.
    begins = best_pair(database) >= FIRST_PAIR_AT_LAST
    again = not once and (found is not None or (begins and flat_pairs(database)[0] < MOSTLY_FLAT))
    if again and options.model in _STRAIGHTENED and _is_poor(found, total):
        say(f"Few pictures have a pose with poses.model={options.model}: once more with pinhole.")
        _forget_distortion(database)
        found = _better(found, _reconstruction(database, pictures, options), total)
    if again and options.model != "opencv_fisheye" and _is_poor(found, total):
        say("Few pictures have a pose: once more with a focal length that is learnt last.")
        held = _reconstruction(database, pictures, options, fixed="focal")
        found = _better(_better(found, held, total), adjusted_reconstruction(held), total)
    if found is None:
        raise PrepareError(missing_poses_reason(database, still))
    expected = expected_focal_lengths(database, options)
    settled, source = settled_focal_length(found, expected)
    return dataclasses.replace(sparse_model_of(settled), focal_source=source)


def poses_with_given_lenses(
    database: Path, pictures: Path, options: PosesOptions, still: bool = False
) -> SparseModel:
    """Poses and points of cameras whose lenses, those of the database, stay as they are.

    Args:
        database: features, verified matches, and known lenses (`set_lenses`).
        pictures: folder of the pictures.
        options: seed.
        still: whether pictures hold the features of several timestamps of a camera.

    Raises:
        PrepareError: No poses or no points are found; the message says why.
    """
    found = _reconstruction(database, pictures, options, fixed="lens")
    if found is None:
        raise PrepareError(
            f"{missing_poses_reason(database, still)} Check as well that poses.lens is of this "
            "camera, zoom and size of pictures."
        )
    return dataclasses.replace(sparse_model_of(found), focal_source="lens")


def _better(first: Any, other: Any, total: int) -> Any:
    """That of two reconstructions which is not poor, or has more pictures; the second of equal
    ones. Either may be None."""
    if first is None or other is None:
        return other if first is None else first

    def worth(found: Any) -> tuple[bool, int]:
        return not _is_poor(found, total), found.num_reg_images()

    return first if worth(first) > worth(other) else other


def _is_poor(reconstruction: Any, total: int) -> bool:
    """Whether fewer than half of the pictures have a pose, or a camera has a lens that none is."""
    if reconstruction is None or reconstruction.num_reg_images() < max(_LEAST, total / 2):
        return True
    cameras = reconstruction.cameras.values()
    lenses = [from_colmap(c.model.name, c.width, c.height, c.params) for c in cameras]
    return any(lens_complaint(lens)[0] == "refuse" for lens in lenses)


def _forget_distortion(database: Path) -> None:
    """Make all cameras of a database pinholes with one focal length."""
    colmap = pycolmap()
    with colmap.Database.open(database) as db:
        for old in db.read_all_cameras():
            new = colmap.Camera(
                model=MODEL_OF_CHOICE["pinhole"],
                width=old.width,
                height=old.height,
                params=[old.mean_focal_length(), old.principal_point_x, old.principal_point_y],
                camera_id=old.camera_id,
            )
            new.has_prior_focal_length = old.has_prior_focal_length
            db.update_camera(new)


class _Attempts:
    """Shows how many pictures have a pose in each of the mapper's attempts. How many there will be
    is not known, nor how much time is left."""

    def __init__(self, total: int):
        self.total, self.number, self.placed = total, 0, 0
        # Units without cost have no time left.
        self.progress = Progress("poses", total, patience=2.0, parts=[(total, 0.0)])

    def begin(self) -> None:
        """An attempt has placed its first two pictures."""
        self.number, self.placed = self.number + 1, _FIRST
        self._report()

    def advance(self) -> None:
        """An attempt has placed one more picture."""
        self.placed += 1
        self._report()

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """Within the block, tell now and then that the mapper works."""
        ended = threading.Event()

        def tell() -> None:
            with contextlib.suppress(GivenUp):
                while not ended.wait(_BEAT):
                    self._report()

        watch = threading.Thread(target=contextvars.copy_context().run, args=(tell,), daemon=True)
        watch.start()
        try:
            yield
        finally:
            ended.set()
            watch.join()

    def end(self, placed: int) -> None:
        """The attempts are over, the best of which has placed so many pictures."""
        best = f"in the best of {counted(self.number, 'attempt')}"
        say(f"{placed} of {self.total} pictures have a pose {best}.")

    def _report(self) -> None:
        # The last picture is not the end: all are adjusted, and some placed again or once more.
        if self.placed < self.total:
            begun = f"have a pose in attempt {self.number}"
            note = begun if self.number else "two are sought to begin with"
            self.progress.report(self.placed, note)


def _reconstruction(
    database: Path,
    pictures: Path,
    options: PosesOptions,
    fixed: Literal["", "focal", "lens"] = "",
) -> Any:
    """The reconstruction with most pictures; None if there is none with points and parallax. Focal
    lengths or whole lenses may stay fixed."""
    colmap = pycolmap()
    mapping = colmap.IncrementalPipelineOptions()
    mapping.min_model_size = _LEAST
    mapping.extract_colors = False
    mapping.random_seed = options.seed
    mapping.mapper.init_min_num_inliers = FIRST_PAIR
    mapping.ba_refine_focal_length = not fixed
    with colmap.Database.open(database) as db:
        total = db.num_images()
        cameras = {camera.camera_id for camera in db.read_all_cameras()}
    if fixed == "lens":
        mapping.constant_cameras = mapping.mapper.constant_cameras = cameras
        mapping.ba_refine_extra_params = False
        mapping.mapper.abs_pose_refine_focal_length = False
        mapping.mapper.abs_pose_refine_extra_params = False
        # Known coefficients may be larger than those that are believed of an estimate.
        mapping.max_extra_param = mapping.mapper.max_extra_param = ANY_COEFFICIENT
        mapping.triangulation.max_extra_param = ANY_COEFFICIENT
    if total == 2:
        mapping.triangulation.ignore_two_view_tracks = False
        mapping.mapper.init_min_tri_angle = _PAIR_ANGLE
        mapping.mapper.filter_min_tri_angle = mapping.triangulation.min_angle = _POINT_ANGLE
    attempts = _Attempts(total)
    with tempfile.TemporaryDirectory() as out, attempts.watched():
        models = colmap.incremental_mapping(
            database,
            pictures,
            out,
            mapping,
            initial_image_pair_callback=attempts.begin,
            next_image_callback=attempts.advance,
        )
    best = max(models.values(), key=lambda m: (m.num_reg_images(), m.num_points3D()), default=None)
    attempts.end(0 if best is None else best.num_reg_images())
    seen = best.compute_num_observations() if best is not None else 0
    # A camera that only turns gets arbitrary poses, with hardly a point.
    return None if best is None or not seen or lacks_parallax(database, seen) else best
