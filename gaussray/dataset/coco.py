"""Writes a generated dataset as COCO: pictures and the masks of rigid bodies (Lin et al. 2014)."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from gaussray.dataset.layers import read_integers
from gaussray.dataset.sample_files import SampleFiles
from gaussray.io.atomic import atomic_path


# The label `group` numbers rigid bodies from here on.
FIRST_BODY = 3
_CATEGORY = {"id": 1, "name": "rigid body", "supercategory": "body"}


def write_coco(samples: Iterable[SampleFiles], out: Path) -> int:
    """Write `out`/images and `out`/instances.json.

    An annotation is a rigid body in a frame: mask as run lengths, box, area, and its number from 0
    as `body`, by which it is the same in other frames. Its id is unique in the file.

    Args:
        samples: samples of PNG pictures with the label `group`.
        out: folder of the layout.

    Returns:
        The number of frames.
    """
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for source in samples:
        for i, frame in enumerate(source.frames):
            name = f"{source.name}_{i:04d}.png"
            source.copy(source.file(frame), out / "images" / name)
            images.append(
                {"id": len(images) + 1, "file_name": name, "width": frame["w"]}
                | {"height": frame["h"], "sample": int(source.name)}
            )
            group = read_integers(source.file(frame, "group"))
            for code in np.unique(group[group >= FIRST_BODY]):
                entry = {"id": len(annotations) + 1, "image_id": len(images), "category_id": 1}
                body = {"body": int(code) - FIRST_BODY, "iscrowd": 0}
                annotations.append(entry | body | _region(group == code))
    document = {
        "info": {"description": "rendered by gaussray"},
        "images": images,
        "annotations": annotations,
        "categories": [_CATEGORY],
    }
    with atomic_path(out / "instances.json") as partial:
        partial.write_text(json.dumps(document) + "\n", encoding="utf-8")
    return len(images)


def _region(mask: Bool[np.ndarray, "h w"]) -> dict[str, Any]:
    """Mask, box (left, top, width, height) and area of an instance."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return {
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "area": int(mask.sum()),
    }


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> list[int]:
    """Lengths of runs of 0 and 1 by turns, 0 first, column after column."""
    flat = np.concatenate([[False], mask.T.reshape(-1)])
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    return [int(x) for x in np.diff(np.concatenate([[0], edges, [mask.size]]))]
