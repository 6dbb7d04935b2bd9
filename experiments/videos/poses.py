"""How far the cameras that COLMAP or `gaussray prepare` has found are from the true ones.

python -m experiments.videos.poses CAPTURE DIR/truth.json
"""

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gaussray.capture.formats.colmap_files import model_folder, read_colmap_model
from gaussray.geometry import BLENDER_AXES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("truth", type=Path)
    told = parser.parse_args()
    truth = json.loads(told.truth.read_text())
    places, lenses = estimated(told.capture)
    true = np.array([truth["cameras"][name] for name in places])[:, :3]
    error, turned, scale = compared(np.array(list(places.values())), true)
    spread = np.linalg.norm(np.ptp(true[:, :, 3], axis=0))
    print(f"{len(places)} of {len(truth['cameras'])} cameras, {spread:.2f} m apart at most")
    print(f"centres: {figures(1e3 * error, 'mm')}; directions: {figures(turned, 'degrees')}")
    for number, lens in lenses.items():
        share = lens["fl_x"] / truth["focal"]
        print(f"lens {number}: {lens['fl_x']:.1f} px for {truth['focal']:.1f} ({share - 1:+.2%})")
    print(f"a unit of the model is {scale:.4f} m")


def estimated(capture: Path) -> tuple[dict[str, np.ndarray], dict]:
    """Camera to world [3, 4], x right, y up, by name; and the keys of the lenses, by number."""
    found, prepared = model_folder(capture), capture / "transforms.json"
    if found is not None:
        model = read_colmap_model(found)
        return {Path(image.name).stem: placed(image) for image in model.images}, model.cameras
    if not prepared.is_file():
        raise SystemExit(f"{capture}: neither a model of COLMAP nor transforms.json is there.")
    document = json.loads(prepared.read_text())
    frames = {frame["camera"]: {**document, **frame} for frame in document["frames"]}
    places = {name: np.array(f["transform_matrix"])[:3] for name, f in frames.items()}
    return places, {f["fl_x"]: f for f in frames.values()}


def placed(image) -> np.ndarray:
    """Camera to world [3, 4], x right, y up, of what COLMAP says."""
    turn = Rotation.from_quat(np.array(image.quat)[[1, 2, 3, 0]]).as_matrix().T
    return np.column_stack([turn * BLENDER_AXES, -turn @ np.array(image.translation)])


def compared(found: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Distances of centres, angles in degrees, and the scale of the similarity that takes what was
    found to the truth with the least squares of distances (Umeyama 1991)."""
    here, there = found[:, :, 3], true[:, :, 3]
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    left, size, right = np.linalg.svd(b.T @ a)
    hand = np.array([1, 1, np.sign(np.linalg.det(left @ right))])
    turn = left * hand @ right
    scale = float((size * hand).sum() / (a**2).sum())
    error = np.linalg.norm(scale * a @ turn.T - b, axis=1)
    off = true[:, :, :3].transpose(0, 2, 1) @ turn @ found[:, :, :3]
    return error, np.degrees(Rotation.from_matrix(off).magnitude()), scale


def figures(values: np.ndarray, unit: str) -> str:
    return f"{np.median(values):.3g} {unit} (median), {values.max():.3g} (worst)"


if __name__ == "__main__":
    main()
