"""Whether a run that is resumed goes on with the pictures that it began with."""

import hashlib
from pathlib import Path
from typing import Any

from gaussray.capture.capture import Capture
from gaussray.io.atomic import write_json
from gaussray.io.safe.files import read_json
from gaussray.runtime.provenance import array_digest


CAPTURE_FILE = "capture.json"
# What a message calls the facts that it compares.
_NAMES = {
    "pictures": "training pictures",
    "cameras": "cameras",
    "times": "times",
    "size": "pixels a picture",
}


def capture_facts(capture: Capture) -> dict[str, Any]:
    """How many training pictures, cameras and times a capture has, the size of the first picture,
    and a digest of their names, times and cameras."""
    views = [view for view in capture.views if view.split == "train"]
    digest: Any = hashlib.sha256()
    for view in views:
        digest.update(f"{view.image.name} {view.camera_name} {view.time!r}\n".encode())
        digest.update(array_digest(view.camera).digest())
    return {
        "pictures": len(views),
        "cameras": len({view.camera_name for view in views}),
        "times": len({view.time for view in views}),
        "size": [views[0].width, views[0].height] if views else [],
        "digest": digest.hexdigest(),
    }


def write_capture_facts(out: Path, capture: Capture) -> None:
    """Note in the folder of a run which pictures it is of.

    Args:
        out: folder of the run.
        capture: the capture as it is given to `reconstruct`.
    """
    write_json(out / CAPTURE_FILE, capture_facts(capture))


def demand_same_capture(out: Path, capture: Capture) -> None:
    """Refuse to resume with other pictures or cameras than a run began with.

    Args:
        out: folder of the run; of one of an earlier version nothing is known.
        capture: the capture as it is given to `reconstruct`.

    Raises:
        ValueError: they differ; the message says in what.
    """
    path = out / CAPTURE_FILE
    if not path.is_file():
        return
    before, now = read_json(path), capture_facts(capture)
    if not isinstance(before, dict) or before.get("digest") == now["digest"]:
        return
    changes = [
        f"{before.get(key)} {name} then, {now[key]} now"
        for key, name in _NAMES.items()
        if before.get(key) != now[key]
    ]
    what = "; ".join(changes) or "as many, with other names, times or cameras"
    raise ValueError(
        f"out={out} holds an unfinished reconstruction of other pictures ({what}). Give the same "
        "capture.path, and the same capture.frames, scale, crop and test, or choose another folder."
    )
