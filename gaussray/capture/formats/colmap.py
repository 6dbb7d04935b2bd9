"""Reads captures calibrated by COLMAP: static ones, and one folder or video per camera."""

import dataclasses
import os
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike, Float

from gaussray.capture.capture import Capture, View
from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.colmap_files import (
    PLACES,
    Model,
    Registered,
    larger_models,
    model_folder,
    read_colmap_model,
)
from gaussray.capture.formats.colmap_frames import frames_together
from gaussray.capture.formats.colmap_project import project_folder
from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.formats.lenses import unusual_pixels
from gaussray.capture.formats.picture_places import other_spellings
from gaussray.capture.formats.poses import opengl_pose, quaternion_turn
from gaussray.capture.formats.transforms import views_in_time, views_of
from gaussray.capture.videos import VIDEO_SUFFIXES, frame_path, read_video
from gaussray.io.natural_order import natural_order


PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".pgm", ".ppm", ".pnm")
# Registered pictures of a camera that stands still may differ by this angle in radians (about a
# pixel) and by this share of the extent of all cameras.
TURN, SHIFT = 1e-3, 1e-3
# The square of a shorter quaternion underflows.
_LEAST = 1e-30


# Folders of original pictures, and the share of them of which fewer in a model are warned of.
_ORIGINALS, _FEW = ("images", "input"), 0.1
# Range of plausible focal lengths in widths of the picture: fields of view of 136 to 3 degrees.
_NEAR, _FAR = 0.2, 20.0


class CameraImages(NamedTuple):
    """The images of one camera: its own folder, and its registered images by path."""

    folder: Path
    images: dict[Path, Registered]


def read_colmap(folder: Path | str, dtype: DTypeLike = jnp.float32) -> Capture:
    """Read a capture calibrated by COLMAP.

    The model (binary or text) is in sparse/0, sparse, colmap/sparse/0 or the folder itself; the
    pictures are in images/ or, by the same names, in the folder. World, poses and pixel centres are
    COLMAP's; its points are the initial points.

    A registered picture stands for all frames of its camera:
    - If pictures are in several folders (`cam00/0000.png`), for all pictures of its folder, in
      natural order of their names.
    - Otherwise (`cam00.jpg`) for the pictures in the folder `cam00`.
    - If that folder has no second picture, for the frames of the video `cam00.mp4` (or .mov .mkv
      .avi .webm) in the capture's folder, in videos/ or in images/.

    All cameras must have the same number of frames; frame i of n is at time i / n. Of folders of
    cameras that stand still, pictures of one number belong together (`frame_numbers`), and those
    whose number a folder lacks are left out, with a warning. If the pictures
    of a folder are registered at one place, the camera is fixed there. If at several, the camera
    moves: only registered pictures are used, each as a camera of its own, at its time in the
    folder. If no camera has a second frame, the capture is static, at time 0, with a warning. No
    camera is held out.

    Args:
        folder: the capture's folder, or that of a project whose `dense/` holds undistorted pictures
            and their model.
        dtype: type of the cameras' numbers.

    Raises:
        CaptureError: files are malformed or contradict each other; the message names file and
            remedy.
        FileNotFoundError: the folder holds no model.
        OSError: a file cannot be read.
    """
    given, folder = Path(folder), project_folder(Path(folder))
    place = model_folder(folder)
    if place is None:
        raise FileNotFoundError(
            f"{folder}: a capture of COLMAP must hold cameras and images (.bin or .txt) in one of "
            f"{', '.join(PLACES)}, got none. Name the folder that has them."
        )
    _check_is_capture(folder, place)
    model = read_colmap_model(place)
    if counts := larger_models(place):
        listed = ", ".join(f"{name} has {count}" for name, count in counts.items())
        Keys(model.file, {}).warn(
            f"of several models this one is read, and others have more pictures ({listed}). Each "
            f"has a world of its own. To read another one, exchange the names of their folders."
        )
    cameras = _cameras(folder, model)
    frames = {name: _frames(folder, name, camera) for name, camera in cameras.items()}
    poses = {image: _pose(model.file, image) for image in model.images}
    extent = float(np.linalg.norm(np.ptp([pose[:, 3] for pose in poses.values()], axis=0)))
    fixed = {n: _is_fixed(list(c.images.values()), poses, extent) for n, c in cameras.items()}
    frames, times = frames_together(folder, frames, all(fixed.values()))
    _check_counts(folder, model, {name: len(paths) for name, paths in frames.items()})
    registered = views_of(Keys(model.file, {}), _keys(model, poses), dtype)
    _check_lenses(model)
    view_of = dict(zip(poses, registered, strict=True))
    views = []
    for name, camera in cameras.items():
        placed = {path: view_of[image] for path, image in camera.images.items()}
        if fixed[name]:
            first = dataclasses.replace(next(iter(placed.values())), camera_name=name)
            views += views_in_time(first, frames[name], times)
        else:
            views += _moving(name, placed, frames[name])
    _warn_of_few(given, model, len(views))
    span = min(view.time for view in views), max(view.time for view in views)
    return Capture(folder, views, {}, model.points, span, "normalised")


def _check_is_capture(folder: Path, place: Path) -> None:
    """Refuse the folder of a model whose pictures lie beside a folder around it."""
    if place.resolve() != folder.resolve() or (folder / "images").is_dir():
        return
    for home in folder.resolve().parents[:3]:
        known = model_folder(home)
        if known is not None and known.resolve() == folder.resolve() and (home / "images").is_dir():
            raise CaptureError(
                f"{folder}: is the model of the capture {home}, which has the pictures. Name that."
            )


def _check_lenses(model: Model) -> None:
    """Warn of implausible focal lengths, which COLMAP finds if there are few pictures, and of
    pixels that are not nearly square."""
    for number, lens in model.cameras.items():
        share = lens["fl_x"] / lens["w"]
        if not _NEAR <= share <= _FAR:
            Keys(model.file, {}).warn(
                f"camera {number} has a focal length of {lens['fl_x']:.4g} pixels for a picture "
                f"{lens['w']} wide: hardly a lens that anybody has. Let COLMAP find one for all "
                "cameras that are alike (--single_camera 1 --camera_model SIMPLE_PINHOLE), or tell "
                "it what is known."
            )
        if unusual := unusual_pixels(lens["fl_x"], lens["fl_y"]):
            Keys(model.file, {}).warn(
                f"camera {number} has {unusual}, which hardly any camera has. If the pictures were "
                "not stretched, let COLMAP find one focal length (--camera_model SIMPLE_RADIAL)."
            )


def _check_counts(folder: Path, model: Model, counts: dict[str, int]) -> None:
    if max(counts.values()) == 1:
        root = folder / "images"
        shown = sum(p.suffix.lower() in PICTURES for p in root.iterdir()) if root.is_dir() else 0
        left = shown - len(model.images)
        Keys(model.file, {}).warn(
            "no camera has a folder or video of frames: the capture is taken as static, at time 0."
            + (f" {left} of {shown} pictures in {root} have no pose." if left > 0 else "")
        )
    elif len(set(counts.values())) > 1:
        listed = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise CaptureError(
            f"{folder}: all cameras must have as many frames, got {listed}. Each needs its "
            "pictures in a folder, or a video, of its name; cut them to the same instants."
        )


def _warn_of_few(folder: Path, model: Model, used: int) -> None:
    """Warn of a model that has hardly any of the pictures in a capture's folder.

    Args:
        folder: the folder, where pictures lie in it or in `images/` or `input/`.
        model: its model.
        used: how many pictures are views.
    """
    places = [place for place in (folder, *(folder / n for n in _ORIGINALS)) if place.is_dir()]
    counts = {p: sum(f.suffix.lower() in PICTURES for f in p.iterdir()) for p in places}
    fullest = max(counts, key=lambda place: counts[place])
    if used < _FEW * counts[fullest]:
        Keys(model.file, {}).warn(
            f"only {used} of the {counts[fullest]} pictures in {fullest} are in the model, and the "
            f"others are not used. `gaussray prepare videos={fullest} out=OUT` finds poses of all."
        )


def _cameras(folder: Path, model: Model) -> dict[str, CameraImages]:
    """The capture's cameras by name."""
    inside = {image.name: _inside(model.file, image.name) for image in model.images}
    roots = [folder / "images", folder]
    known = [r for r in roots if any((r / path.parts[0]).exists() for path in inside.values())]
    root = (known or roots)[0]
    inside |= _spelt_otherwise(model.file, root, inside)
    parents = {path.parent for path in inside.values()}
    shared = 0 if len(parents) == 1 else len(os.path.commonprefix([p.parts for p in parents]))
    cameras: dict[str, CameraImages] = {}
    for image in model.images:
        path = inside[image.name]
        own = path.parent.parts[shared:] if len(parents) > 1 else ()
        name, place = ("_".join(own), path.parent) if own else (path.stem, path.with_suffix(""))
        camera = cameras.setdefault(name, CameraImages(root / place, {}))
        if camera.images and not (own and camera.folder == root / place):
            raise CaptureError(
                f"{model.file}: each camera must have a name of its own, got {image.name} for "
                f"{name} again. Rename the picture."
            )
        camera.images[_held(folder, root / path)] = image
    return cameras


def _spelt_otherwise(
    file: Path, root: Path, inside: dict[str, PurePosixPath]
) -> dict[str, PurePosixPath]:
    """The paths of pictures of which none exists as the model names it, where letter case or suffix
    alone differ."""
    if any((root / path).exists() for path in inside.values()):
        return {}
    spelt = other_spellings(root, list(inside))
    if spelt:
        old, new = next(iter(spelt.items()))
        Keys(file, {}).warn(
            f"no picture has the name that the model has for it. {len(spelt)} of {len(inside)} are "
            f"found if it is spelt otherwise ({new} for {old}), and are read there."
        )
    return {name: PurePosixPath(path) for name, path in spelt.items()}


def _held(folder: Path, path: Path) -> Path:
    """Check that a path stays inside the capture's folder, also through links."""
    name = path.relative_to(folder).as_posix()
    return Keys(folder / "capture", {"picture": name}).inside("picture")


def _inside(file: Path, name: str) -> PurePosixPath:
    """Check that a picture's name is a path inside its folder."""
    path = PurePosixPath(name)
    outside = path.is_absolute() or PureWindowsPath(name).anchor or ".." in path.parts
    # File systems have no longer names, and each reports that differently.
    if outside or not path.parts or max(len(part.encode()) for part in path.parts) > 255:
        raise CaptureError(
            f"{file}: the name of a picture must be a path inside the folder of pictures, got "
            f"{name[:80]!r}. Register the pictures by their names in that folder."
        )
    return path


def _frames(folder: Path, name: str, camera: CameraImages) -> list[Path]:
    """All frames of a camera: the pictures of its folder, of its video, or the registered ones."""
    if camera.folder.is_dir():
        pictures = [p for p in camera.folder.iterdir() if p.suffix.lower() in PICTURES]
        if len(pictures) > 1:
            return [_held(folder, path) for path in sorted(pictures, key=natural_order)]
    places = [folder, folder / "videos", folder / "images"]
    for path in (place / f"{name}{suffix}" for place in places for suffix in VIDEO_SUFFIXES):
        if path.is_file():
            frames = read_video(_held(folder, path)).frames
            return [frame_path(path, i) for i in range(frames)]
    return list(camera.images)


def _pose(file: Path, image: Registered) -> np.ndarray:
    """The camera-to-world matrix in OpenGL axes."""
    quat, translation = np.array(image.quat), np.array(image.translation)
    if not (np.isfinite([*quat, *translation]).all() and np.abs(quat).max() > _LEAST):
        raise CaptureError(
            f"{file}: the pose of {image.name} must be finite, with a quaternion that is not 0, "
            f"got {image.quat} and {image.translation}. Remove the picture, or place it again."
        )
    turn = quaternion_turn(quat).T
    return opengl_pose(turn, -turn @ translation)


def _keys(model: Model, poses: dict[Registered, np.ndarray]) -> list[Keys]:
    """The registered pictures as the keys of JSON frames."""
    shared = {"time": 0.0, "camera": "camera", "split": "train"}
    return [
        Keys(
            model.file,
            {
                **{**shared, **model.cameras[image.camera]},
                **{"file_path": image.name, "transform_matrix": pose},
            },
            k,
        )
        for k, (image, pose) in enumerate(poses.items())
    ]


def _is_fixed(images: list[Registered], poses: dict[Registered, np.ndarray], extent: float) -> bool:
    """Whether all images have one pose and one lens."""
    matrices: Float[np.ndarray, "poses 3 4"] = np.array([poses[image] for image in images])
    change = np.abs(matrices - matrices[0])
    turn = np.linalg.norm(change[:, :, :3], axis=(1, 2)) / np.sqrt(2)
    shift = np.linalg.norm(change[:, :, 3], axis=1)
    one_lens = len({image.camera for image in images}) == 1
    return one_lens and bool(turn.max() <= TURN and shift.max() <= SHIFT * extent)


def _moving(name: str, placed: dict[Path, View], frames: list[Path]) -> list[View]:
    """The registered pictures of a moving camera, at their times among all its frames.

    The view of a registered picture that does not exist keeps time 0; `open_capture` handles
    missing pictures.
    """
    times = dict(zip(frames, views_in_time(next(iter(placed.values())), frames), strict=True))
    views = []
    for path, view in placed.items():
        if path in times:
            camera = dataclasses.replace(view.camera, time=times[path].camera.time)
            view = dataclasses.replace(times[path], camera=camera)
        views.append(dataclasses.replace(view, camera_name=f"{name}_{path.stem}", image=path))
    return views
