"""The report of pruning: how much of everything a scene holds, before and after."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from gaussray.scene.deformation import HEADS, Deformation
from gaussray.scene.scene import Scene, transient_count


def part_counts(scene: Scene) -> dict[str, int]:
    """How many Gaussians (all, moving, transient), rigid bodies, network heads, plane scales and
    rows a scene holds, at how many times shadows pass, its degree of harmonics, and the bytes of
    all its arrays."""
    degrees = [int(np.sqrt(x.harmonics.shape[1])) - 1 for x in (scene.static, scene.moving)]
    sizes = {
        "gaussians": scene.count,
        "moving": scene.moving.count,
        "transient": transient_count(scene),
        "bodies": 0,
        "heads": 0,
        "scales": 0,
        "rows": 0,
        "shades": 0 if scene.shading is None else len(scene.shading.time),
        "degree": max(degrees),
        "bytes": sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(scene)),
    }
    field = scene.deformation
    if isinstance(field, Deformation):
        sizes["bodies"] = len(field.bodies.pivot)
        sizes["heads"] = sum(getattr(field, head) is not None for head in HEADS)
        sizes["scales"] = len(field.planes.space)
        sizes["rows"] = sum(plane.shape[1] for plane in field.planes.time)
    return sizes


def clip_report(reports: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The report of a clip: the reports of its segments, and sums over them."""
    report: dict[str, Any] = {"segments": list(reports)}
    for when in ("before", "after"):
        if all(when in part for part in reports):
            sums = ("gaussians", "moving", "bytes")
            report[when] = {name: sum(part[when][name] for part in reports) for name in sums}
    return report


def summary_line(report: dict[str, Any], name: str = "the scene") -> str:
    """One line about the report of pruning.

    Args:
        report: the report (`pruned_scene`, `clip_report`), with a `file`: the bytes of the written
            file.
        name: what to call the scene.
    """
    before, after = report["before"], report["after"]
    field = [
        f"{after[part]} of {before[part]} {noun}"
        for part, noun in (("heads", "heads"), ("scales", "scales of the field"))
        if before.get(part)
    ]
    moving = f"{after['moving']:,} of {before['moving']:,} move"
    if before.get("transient"):
        moving += f", {after['transient']:,} of {before['transient']:,} are transient"
    if after.get("bodies"):
        moving += f", {after['bodies']} bod{'y' if after['bodies'] == 1 else 'ies'}"
    needs = [f"{after['gaussians']:,} of {before['gaussians']:,} Gaussians ({moving})", *field]
    needs += ["shadows that pass"] if after.get("shades") else []
    needs += [f"harmonics of degree {after['degree']}"] if "degree" in after else []
    megabytes = " -> ".join(f"{x / 1e6:.2g}" for x in (before["bytes"], report["file"]))
    gained = f", {after['psnr'] - before['psnr']:+.2f} dB" if "psnr" in after else ""
    return f"{name} needs {', '.join(needs)}: {megabytes} MB{gained}"
