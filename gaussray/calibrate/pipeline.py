"""Cameras found in pictures of a known scene, with how well they are known."""

import dataclasses
import time as clock
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gaussray.calibrate.parameters import KINDS, Unknown, applied, prepared, units, unknowns
from gaussray.calibrate.results import decibel, demand_effect, labels, parameters, undone
from gaussray.calibrate.solver import Adjustment, Shot, factors
from gaussray.camera.array import rays_per_pixel
from gaussray.camera.lens import AbstractLens
from gaussray.camera.shutter import time_window
from gaussray.capture.formats.paired import PINHOLE_FILE, Capture, View
from gaussray.capture.frames import check_images, read_encoded, read_mask
from gaussray.color import srgb_decode
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.io.atomic import write_json
from gaussray.runtime.devices import leads
from gaussray.runtime.progress import Progress
from gaussray.runtime.provenance import versions
from gaussray.scene.scene import Scene, key_count
from gaussray.scene.segmented import Clip, edges_of, segments_of
from gaussray.tracer.trace import TraceOptions


class CalibrateOptions(eqx.Module):
    """What is found, and in which pictures.

    `parameters` are `focal`, `lens` (principal point and `coefficients`: those named, else those
    that are not 0), `shutter` (the readout), `pose`, `exposure` (gains by channel), `offset` (a
    constant delay). Pictures are those of an `effect` (none = the pinhole views, or the only one)
    and a `split`, of some `cameras` (none named = all), at most `frames` of each, evenly spread
    (0 = all). The `cameras` share focal length, lens and readout; the rest is each one's own.

    `samples` rays per pixel (0 = 1, or 4 where something blurs); levels from pictures of `coarsest`
    blocks on the smaller side up to whole ones, at most `steps` at each; Huber's loss bends at
    `bend` standard deviations.
    """

    parameters: tuple[str, ...] = eqx.field(static=True, default=("pose", "focal"))
    coefficients: tuple[str, ...] = eqx.field(static=True, default=())
    effect: str = eqx.field(static=True, default="")
    split: str = eqx.field(static=True, default="all")
    cameras: tuple[str, ...] = eqx.field(static=True, default=())
    frames: int = eqx.field(static=True, default=0)
    samples: int = eqx.field(static=True, default=0)
    coarsest: int = eqx.field(static=True, default=16)
    steps: int = eqx.field(static=True, default=20)
    bend: float = eqx.field(static=True, default=1.345)

    def __check_init__(self):
        wrong = [kind for kind in self.parameters if kind not in KINDS]
        if wrong or not self.parameters:
            raise ValueError(
                f"calibrate.parameters must be some of {', '.join(KINDS)}, got "
                f"{list(self.parameters)}."
            )
        if self.coefficients and "lens" not in self.parameters:
            raise ValueError(
                "calibrate.coefficients are found with the lens: add lens to calibrate.parameters."
            )
        if self.split not in ("train", "test", "all"):
            raise ValueError(f"calibrate.split must be train, test or all, got {self.split!r}.")
        for name, least in (("frames", 0), ("samples", 0), ("coarsest", 1), ("steps", 1)):
            if getattr(self, name) < least:
                raise ValueError(
                    f"calibrate.{name} must be at least {least}, got {getattr(self, name)}."
                )
        if not self.bend > 0:
            raise ValueError(f"calibrate.bend must be above 0, got {self.bend}.")


def calibrate(
    scene: Scene | Clip,
    capture: Capture,
    out: Path | str,
    *,
    options: CalibrateOptions,
    trace: TraceOptions | None = None,
    quiet: bool = False,
) -> dict[str, Any]:
    """Find what a capture's list says wrongly of its cameras, in pictures of a scene that is known.

    The scene stays as it is. `out` gets the list with the cameras as found (transforms.json, or the
    effect's name), that `render` and `evaluate` read, and report.json, which is returned: of every
    number `start`, `value`, `unit` and its standard errors, what cannot be told apart
    (`confounded`), and PSNR over the compared pixels before and after, gains included.

    A standard error says how far the value would scatter if the errors of the residuals were drawn
    again, `independent` from pixel to pixel, or alike within `tiles` of 8 x 8 pixels; what the
    scene has wrong everywhere shifts values beyond both.

    ValueError for what no picture tells, for frames of a clip that look into two of its segments,
    for cameras that do not share their lens, and where what is found is no lens.
    """
    began = clock.monotonic()
    effect, views = _chosen(capture, options)
    lens = prepared(views[0].camera.lens, options.coefficients)
    told = unknowns(options.parameters, lens, options.coefficients, capture.time_unit)
    names = list(dict.fromkeys(view.camera_name for view in views))
    _check(views, told)
    check_images(views)
    shots = [_shot(scene, view, lens, names.index(view.camera_name)) for view in views]
    unit = units(shots[0].camera)
    samples = options.samples or max(rays_per_pixel(shot.camera) for shot in shots)
    trace = trace or TraceOptions()
    adjustment = Adjustment(shots, told, unit, samples=samples, bend=options.bend, trace=trace)
    labelled, levels = labels(adjustment, names), factors(shots, options.coarsest)
    demand_effect(adjustment.begin(levels[0]), labelled)

    progress = Progress("calibrate", len(levels), quiet=quiet)
    found = adjustment.solve(
        levels,
        steps=options.steps,
        told=lambda f, i, s: progress.report(levels.index(f), f"1/{f}, step {i}: {255 * s:.2f}"),
    )
    report = {
        "effect": effect,
        "cameras": names,
        "pictures": len(views),
        "parameters": parameters(adjustment, found, labelled),
        "confounded": undone(found, labelled),
        "psnr": {"before": decibel(found.before), "after": decibel(found.after)},
        "levels": [
            {"pixels": f, "steps": n, "deviation": round(255 * s, 4)} for f, n, s in found.levels
        ],
        "seconds": round(clock.monotonic() - began, 1),
        "versions": versions(),
    }
    if leads():
        _write(Path(out), capture, effect, names, adjustment, found, report)
    return report


def _chosen(capture: Capture, options: CalibrateOptions) -> tuple[str, list[View]]:
    groups = {"pinhole": capture.views, **capture.effects}
    groups = {name: views for name, views in groups.items() if views}
    effect = options.effect or ("pinhole" if "pinhole" in groups else next(iter(groups)))
    if effect not in groups:
        raise ValueError(
            f"calibrate.effect must be among {', '.join(groups)} of {capture.folder}, "
            f"got {effect!r}."
        )
    known = dict.fromkeys(view.camera_name for view in groups[effect])
    for name in options.cameras:
        if name not in known:
            raise ValueError(f"calibrate.cameras must be among {', '.join(known)}, got {name!r}.")
    picked: list[View] = []
    for name in options.cameras or known:
        own = [view for view in groups[effect] if view.camera_name == name]
        own = [view for view in own if options.split in ("all", view.split)]
        if options.frames and len(own) > options.frames:
            place = np.linspace(0, len(own) - 1, options.frames).round().astype(int)
            own = [own[i] for i in place]
        picked += own
    if not picked:
        raise ValueError(
            f"calibrate.split={options.split} and calibrate.cameras choose no picture of "
            f"{effect} in {capture.folder}."
        )
    return effect, picked


def _check(views: Sequence[View], told: tuple[Unknown, ...]) -> None:
    """Refuse cameras that cannot be adjusted together, and what a list leaves no room for."""
    first = views[0]
    for view in views:
        if view.window is not None:
            raise ValueError(
                "capture.crop and capture.scale must be left alone: the list is that of whole "
                "pictures. calibrate.frames makes the work less."
            )
        one, other = (jax.tree.leaves((v.camera.lens, v.camera.film)) for v in (first, view))
        same = jax.tree.structure(first.camera.lens) == jax.tree.structure(view.camera.lens)
        if not same or first.camera.film != view.camera.film or not _equal(one, other):
            raise ValueError(
                f"calibrate.cameras must share film and lens, as they are recorded, but those of "
                f"{first.camera_name} and {view.camera_name} differ. Name them one by one."
            )
    steps = {float(view.camera.shutter.row_step) for view in views}
    if any(one.kind == "shutter" for one in told) and (0.0 in steps or len(steps) > 1):
        raise ValueError(
            "calibrate.parameters=[shutter] scales one recorded readout of all cameras, got a "
            f"shutter.row_step of {', '.join(f'{x:g}' for x in sorted(steps))}. Write an estimate "
            "into the capture's list, or leave shutter out."
        )


def _equal(one: list[Any], other: list[Any]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def _shot(scene: Scene | Clip, view: View, lens: AbstractLens, owner: int) -> Shot:
    """A picture with its camera, and the segment that shows it."""
    film, shutter, edges = view.camera.film, view.camera.shutter, edges_of(scene)
    first, last = time_window(shutter, (film.width, film.height))
    touched = np.searchsorted(edges, [view.time + first, view.time + last], side="right")
    if touched[0] != touched[1]:
        raise ValueError(
            f"{view.image}: is read out across the time {edges[touched[0]]:g}, where two segments "
            "of the scene meet. Leave it out (calibrate.frames, capture.frames), or reconstruct "
            "with fit.segment=0."
        )
    own = segments_of(scene)[int(touched[0])]
    stored = read_encoded(view)
    full = np.iinfo(stored.dtype).max if stored.dtype == np.uint8 else 1
    light = srgb_decode(stored.astype(np.float64) / full).astype(np.float32)
    mask = np.ones(light.shape[:2], bool)
    if view.mask is not None:
        mask = read_mask(view.mask, view.width, view.height)
    camera = dataclasses.replace(view.camera, lens=lens)
    return Shot(light, mask, camera, owner, own, key_count(own, last - first))


def _write(out, capture, effect, names, adjustment, found, report) -> None:
    """The list with the cameras as found, and the report."""
    listed = capture.views if effect == "pinhole" and capture.views else capture.effects[effect]
    lens, place = adjustment.shots[0].camera.lens, adjustment.places
    records = []
    for view in listed:
        if view.camera_name in names:
            value = found.value[place[names.index(view.camera_name)]]
            camera = dataclasses.replace(view.camera, lens=lens)
            value = jnp.asarray(value, camera.time.dtype)
            try:
                camera, _ = applied(value, camera, adjustment.unit, adjustment.told)
            except ValueError as error:
                raise ValueError(
                    f"what explains the pictures best is no lens: {error} Nothing is written. "
                    "Begin nearer to the truth, with more calibrate.coarsest blocks, or find fewer "
                    "calibrate.coefficients."
                ) from error
            records.append(
                FrameRecord(
                    str(view.image.resolve()),
                    camera,
                    view.camera_name,
                    view.split,
                    effect,
                    view.samples,
                    None if view.mask is None else str(view.mask.resolve()),
                    None if view.depth is None else str(view.depth.resolve()),
                )
            )
    extra = {"time_unit": capture.time_unit}
    out.mkdir(parents=True, exist_ok=True)
    name = PINHOLE_FILE if effect == "pinhole" else f"{effect}.json"
    write_manifest(out / name, records, extra=extra)
    write_json(out / "report.json", report)
