"""A known scene filmed twice, by global and by rolling shutters, and learnt from either film.

python experiments/refinement/compare.py SCENE CAPTURE OUT [WAY ...]   (see README.md)
"""

import json
import shutil
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera
from gaussray.camera.shutter import Shutter
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.evaluate import EvaluateOptions, evaluate
from gaussray.io.safe.limits import Limits, limit
from gaussray.reconstruct import ReconstructOptions, reconstruct
from gaussray.reconstruct.options import FitOptions
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.store import load_scene
from gaussray.tracer.options import TraceOptions


# Readout of the rolling shutter in intervals between instants, and how wrong it is recorded.
READOUT, WRONG = 1.0, 1.3
WAYS = {
    # film, recorded readout, what is refined
    "global": ("global", 0.0, ()),
    "rolling": ("rolling", 1.0, ()),
    "rolling, taken as global": ("rolling", 0.0, ()),
    "rolling, 30 % wrong": ("rolling", WRONG, ()),
    "rolling, 30 % wrong, refined": ("rolling", WRONG, ("shutter",)),
}


def main(scene_folder, capture_folder, out, *ways):
    # The lists written here name pictures of other folders.
    limit(Limits(folders=("/",)))
    scene, out = load_scene(scene_folder), Path(out)
    capture = open_capture(capture_folder, "auto", "none", selection=Selection(scale=0.5))
    times = np.unique([view.time for view in capture.views])
    readout = READOUT * float(np.median(np.diff(times)))
    for kind in ("global", "rolling"):
        if not (out / kind / "images").is_dir():
            film(scene, capture, Path(capture_folder), out / kind, readout * (kind == "rolling"))
    rows = []
    for way in ways or WAYS:
        kind, factor, refine = WAYS[way]
        folder = out / way.replace(" ", "_").replace(",", "").replace("%", "percent")
        recorded(out / kind, folder / "capture", readout * factor)
        rows.append({"way": way} | learnt(folder, out / "global", refine))
        print(json.dumps(rows[-1]), flush=True)


def rolling(camera, readout):
    """The camera with its rows read during `readout` around its time."""
    step = readout / (camera.film.height - 1)
    values = (jnp.asarray(x, camera.time.dtype) for x in (-readout / 2, step, 0.0))
    return Camera(**(vars(camera) | {"shutter": Shutter(*values)}))


def film(scene, capture, source, folder, readout):
    """What the training cameras see during a readout, the others at once."""
    renderer = Renderer(scene, options=RenderOptions(samples=4))
    records = []
    for view in capture.views:
        camera = rolling(view.camera, readout) if view.split == "train" else view.camera
        path = f"images/{view.camera_name}/{view.time:.4f}.png"
        records.append(FrameRecord(path, camera, view.camera_name, view.split))
        write_image(folder / path, renderer(camera).color)
    write_manifest(folder / "transforms.json", records, extra={"ply_file_path": "points3d.ply"})
    shutil.copy(source / "points3d.ply", folder / "points3d.ply")


def recorded(filmed, folder, readout):
    """The same film with this readout written down."""
    records = [
        FrameRecord(
            str(view.image.resolve()),
            rolling(view.camera, readout) if view.split == "train" else view.camera,
            view.camera_name,
            view.split,
        )
        for view in read_capture(filmed).views
    ]
    folder.mkdir(parents=True, exist_ok=True)
    write_manifest(folder / "transforms.json", records, extra={"ply_file_path": "points3d.ply"})
    shutil.copy(filmed / "points3d.ply", folder / "points3d.ply")


def learnt(folder, truth, refine):
    """Figures of a reconstruction on the global film's held-out cameras."""
    fit = FitOptions(auto=False, refine=refine)
    began = time.monotonic()
    scene = reconstruct(
        read_capture(folder / "capture"),
        folder / "run",
        options=ReconstructOptions(fit=fit),
        quiet=True,
    )
    seconds = time.monotonic() - began
    report = evaluate(
        scene,
        read_capture(truth),
        folder / "evaluation",
        options=EvaluateOptions(images=False),
        render=RenderOptions(),
        trace=TraceOptions(),
        quiet=True,
    )["effects"]["pinhole"]
    frames = json.loads((folder / "run" / "cameras.json").read_text())["frames"]
    step = [f["shutter"]["row_step"] for f in frames if "shutter" in f]
    found = {"row_step": step[0]} if step else {}
    return {
        "psnr": round(report["psnr"], 2),
        "moving": round(report.get("psnr_moving", float("nan")), 2),
        "seconds": round(seconds),
        **found,
    }


if __name__ == "__main__":
    main(*sys.argv[1:])
