"""What the report of a prepared capture shows, as plain values."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gaussray.prepare.epipolar import EpipolarPair
from gaussray.prepare.lens_check import corner_distortion
from gaussray.prepare.lens_models import lens_fov
from gaussray.prepare.placed_cameras import camera_lenses, picture_errors, picture_name
from gaussray.prepare.placement import Placement
from gaussray.prepare.sources import Source
from gaussray.prepare.sync import Sync
from gaussray.prepare.timeline import Timeline


def facts_of(
    sources: Sequence[Source],
    sync: Sync,
    timeline: Timeline,
    files: dict[str, list[Path]],
    placement: Placement,
    pairs: Sequence[EpipolarPair],
    gains: dict[str, tuple[np.ndarray, int]],
    out: Path,
) -> dict[str, Any]:
    """The content of prepare.json but for the findings.

    Args:
        sources: cameras of the input.
        sync: offsets of their clocks, with confidence and disagreement.
        timeline: rate and number of the timestamps.
        files: for each camera the file of each timestamp, all below `out`.
        placement: poses, lenses and points.
        pairs: pairs of pictures whose epipolar lines the report draws.
        gains: exposure of each registered camera and number of its observations (`exposure_gains`).
        out: the capture's folder, which file paths are relative to.
    """
    lenses, errors = camera_lenses(placement), picture_errors(placement)
    cameras = {}
    for source in sources:
        name = source.name
        pictures = [p for p in placement.pictures.values() if p.camera == name]
        registered = [placement.pictures[f] for f in placement.model.pictures]
        fact: dict[str, Any] = {
            "size": list(source.size(int(timeline.frames[name][len(files[name]) // 2]))),
            "sizes": [list(size) for size in dict.fromkeys(source.sizes)],
            "frames": source.count,
            "rate": round(source.rate, 4),
            "offset": _rounded(sync.offsets[name], 5),
            "confidence": _rounded(sync.confidence[name], 3),
            "disagreement": _rounded(sync.disagreement[name], 5),
            "picture": files[name][len(files[name]) // 2].relative_to(out).as_posix(),
            "still": name in placement.still,
            "pictures": len(pictures),
            "registered": sum(p.camera == name for p in registered),
        }
        if name in lenses:
            count, median, high = errors[name]
            gain, shared = gains[name]
            fact |= {
                "lens": lenses[name],
                "fov": _rounded(lens_fov(lenses[name]), 2),
                "corner_distortion": _rounded(corner_distortion(lenses[name]), 4),
                "observations": count,
                "error": [_rounded(median, 3), _rounded(high, 3)],
                "exposure": [_rounded(x, 3) for x in gain],
                "exposure_observations": shared,
            }
        cameras[name] = fact
    return {
        "cameras": cameras,
        "sync": sync.method,
        "rate": timeline.rate,
        "timestamps": len(timeline.times),
        "still": len(placement.still) == len(sources),
        "calibrated": placement.known,
        "points": len(placement.model.points),
        "epipolar": [_pair(placement, pair, files, out) for pair in pairs],
    }


def _pair(
    placement: Placement, pair: EpipolarPair, files: dict[str, list[Path]], out: Path
) -> dict[str, Any]:
    """A pair with the pictures of one timestamp: that of most of its drawn matches."""
    instants = [instant for _, _, instant in pair.points]
    common = max(set(instants), key=instants.count)

    def picture(name: str) -> dict[str, Any]:
        shot = placement.pictures[name]
        instant = common if shot.camera in placement.still else shot.instant
        path = files[shot.camera][instant].relative_to(out).as_posix()
        alone = len(files[shot.camera]) == 1 or shot.camera in placement.still
        label = shot.camera if alone else picture_name(shot, placement)
        return {"label": label, "file": path}

    size = placement.model.lenses[placement.model.pictures.index(pair.second)]
    first = placement.model.lenses[placement.model.pictures.index(pair.first)]
    return {
        "first": picture(pair.first) | {"size": [first["w"], first["h"]]},
        "second": picture(pair.second) | {"size": [size["w"], size["h"]]},
        "matches": pair.count,
        "distance": _rounded(pair.median, 3),
        "points": [[_pixel(a), _pixel(b)] for a, b, _ in pair.points],
        "lines": [_parts(line) for line in pair.lines],
    }


def _parts(line: np.ndarray) -> list[list[list[float]]]:
    """The finite runs of a line with few points each."""
    finite = np.isfinite(line).all(axis=1)
    edges = np.flatnonzero(np.diff(np.r_[0, finite.astype(int), 0]))
    runs = [line[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [[_pixel(p) for p in run[:: max(len(run) // 40, 1)]] for run in runs if len(run) > 1]


def _pixel(xy: np.ndarray) -> list[float]:
    return [round(float(xy[0]), 1), round(float(xy[1]), 1)]


def _rounded(value: float, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None
