"""One training step: time by part of the course, and by number of devices.

python -m benchmarks.bench_reconstruct [--steps 50] [--stages coarse fine]
python -m benchmarks.bench_reconstruct --capture DIR --auto --stages coarse --devices 1 2
python -m benchmarks.bench_reconstruct --capture DIR --auto --kernels 30
python -m benchmarks.bench_reconstruct --room 200000 --rays 32768 262144

A step is rays of one instant, the scene at its time, trace, loss, gradients and Adam. As in a fit,
25 of them run as one program and are waited for. Without --capture it is the sample's, without
--auto the options are those of fit=quick. Several devices share the rays of a step; `against_first`
divides the time by that of the first number of devices. With --room the scene is the generated
room, a tenth of which moves, with harmonics of degree 2, and the capture is 16 cameras in it.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import jax
import numpy as np

from benchmarks.kernels import kernel_seconds
from benchmarks.problem import SAMPLE, dynamic_room
from benchmarks.record import backend, begin, record, show
from benchmarks.room_capture import write_capture
from gaussray.tracer.options import TraceOptions


# Steps that are compiled and timed as one, as many as those of `fit.block`.
BLOCK = 25
# Pixels of a side, and cameras, of the capture of the generated room; pixels of a tile's side.
SIDE, CAMERAS, TILE = 256, 16, 32
_SHOWN = ("effect", "gaussians", "rays", "backend", "devices", "compile_s", "run_s_median", "loss",
          "dropped")  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--stages", nargs="+", default=["coarse", "fine"])
    parser.add_argument("--capture", help="another capture than the sample")
    parser.add_argument("--auto", action="store_true", help="options as fit=auto chooses them")
    parser.add_argument("--devices", type=int, nargs="+", help="default: all")
    parser.add_argument(
        "--kernels", type=int, default=0, help="so many of the longest CUDA kernels"
    )
    parser.add_argument("--room", type=int, help="Gaussians of the generated room")
    parser.add_argument("--rays", type=int, nargs="+", default=[32_768], help="with --room")
    chosen = parser.parse_args(argv)
    if chosen.room:
        show(_room_rows(chosen), *_SHOWN)
        return
    # They read pictures: not needed to know what the script is for.
    from gaussray.capture.open import open_capture
    from gaussray.reconstruct.auto.choice import auto_choice
    from gaussray.reconstruct.auto.machine import this_machine
    from gaussray.reconstruct.options import FitOptions, ReconstructOptions

    capture = open_capture(chosen.capture or SAMPLE)
    if chosen.auto:
        found = auto_choice(capture, ReconstructOptions(), this_machine(1))
        capture, options = found.capture, found.options
    else:
        options = ReconstructOptions(fit=FitOptions(auto=False))
    trace = replace(options.trace, backend=backend(chosen.backend))
    rows: list[dict] = []
    for devices in chosen.devices or [None]:
        own = _rows(capture, replace(options, trace=trace), devices, chosen)
        for row, first in zip(own, rows[: len(own)] or own, strict=True):
            row["against_first"] = row["run_s_median"] / first["run_s_median"]
        rows += own
    show(rows, *_SHOWN, "against_first")


def _rows(capture, options, devices: int | None, chosen) -> list[dict]:
    """The stages of a capture on so many devices (None: all), a line each."""
    from gaussray.reconstruct.log import RunLog
    from gaussray.reconstruct.motion import with_motion
    from gaussray.reconstruct.run_progress import RunProgress
    from gaussray.reconstruct.session import Session
    from gaussray.reconstruct.start import initial_state

    rows, name = [], Path(chosen.capture).name if chosen.capture else "quickstart"
    with tempfile.TemporaryDirectory() as out:
        log = RunLog(Path(out), resume=False, interval=60.0)
        session = Session(capture, log, options, True, devices)
        state, progress = initial_state(session, RunProgress())
        for stage in chosen.stages:
            if stage == "fine":
                state, progress = with_motion(session, state, progress)
            state, row = _stepped(session, state, stage, name, chosen)
            rows.append(row)
    return rows


def _room_rows(chosen) -> list[dict]:
    """Steps of the fine stage over the generated room, for each number of rays and devices."""
    from gaussray.capture.open import open_capture
    from gaussray.reconstruct.log import RunLog
    from gaussray.reconstruct.optimize.loss import LossOptions
    from gaussray.reconstruct.optimize.optimizer import Parameters
    from gaussray.reconstruct.optimize.state import begin_state
    from gaussray.reconstruct.options import FitOptions, ReconstructOptions
    from gaussray.reconstruct.session import Session
    from gaussray.scene.gaussians import unconstrain

    scene, rows = dynamic_room(chosen.room, degree=2), []
    options = ReconstructOptions(
        fit=FitOptions(auto=False, motion="deformation", tile_side=TILE, degree=2),
        loss=LossOptions(l1=0.8, dssim=0.2),
        trace=TraceOptions(k=32, levels=0, transmittance_min=1e-3, backend=backend(chosen.backend)),
    )
    with tempfile.TemporaryDirectory() as folder:
        write_capture(Path(folder) / "capture", scene, SIDE, CAMERAS)
        capture = open_capture(Path(folder) / "capture")
        for rays, devices in product(chosen.rays, chosen.devices or [None]):
            fit = replace(options.fit, tiles=rays // TILE**2)
            log = RunLog(Path(folder) / f"{rays}_{devices}", resume=False, interval=60.0)
            session = Session(capture, log, replace(options, fit=fit), True, devices)
            parts = unconstrain(scene.static), unconstrain(scene.moving)
            state = begin_state(Parameters(*parts, scene.deformation))
            rows.append(_stepped(session, state, "fine", "dynamic_room", chosen)[1])
    return rows


def _stepped(session, state, stage: str, name: str, chosen):
    """Some steps of a stage: the state after them, and a line of figures."""
    from gaussray.reconstruct.run_progress import StageSchedule
    from gaussray.reconstruct.step import step_schedule, train_block
    from gaussray.reconstruct.step_setup import first_sizes, step_options
    from gaussray.runtime.devices import replicate

    loader, mesh, seconds, lost = session.loader, session.mesh, [], 0
    sizes = first_sizes(session, state, loader.batches(stage, 0, BLOCK))
    cameras, course = replicate(
        (session.footage.camera, step_schedule(StageSchedule(10_000), 0)), mesh
    )
    run = partial(train_block, options=step_options(session, stage), schedule=course, sizes=sizes)
    for block in range(chosen.steps // BLOCK + 1):
        state = replicate(state, mesh)
        batches = replicate(loader.batches(stage, BLOCK * block, BLOCK), mesh)
        began = time.perf_counter()
        state, terms, _, _, dropped = jax.block_until_ready(
            run(state, cameras, batches, session.cameras)
        )
        seconds.append((time.perf_counter() - began) / BLOCK)
        lost += int(dropped)
    if chosen.kernels:
        state = replicate(state, mesh)
        taken = kernel_seconds(partial(run, state, cameras, batches, session.cameras))
        print(f"{stage}: kernels take {1e3 * sum(taken.values()) / BLOCK:.2f} ms a step")
        for name, total in list(taken.items())[: chosen.kernels]:
            print(f"  {1e3 * total / BLOCK:7.3f} ms  {name}")
    options = session.options
    side = max(options.fit.tile_side, options.trace.bundle)
    return state, record(
        "reconstruct_step",
        effect=stage,
        scene=name,
        gaussians=sum(len(kind.mean) for kind in state.parameters.kinds.values()),
        rays=options.fit.tiles * side**2,
        samples=1,
        k=options.trace.k,
        backend=options.trace.backend,
        direction="forward_backward",
        devices=mesh.size,
        compile_s=round(BLOCK * (seconds[0] - min(seconds)), 2),
        run_s_median=float(np.median(seconds[1:])),
        run_s_min=float(min(seconds[1:])),
        loss=float(terms["l1"]),
        dropped=lost,
    )


if __name__ == "__main__":
    main()
