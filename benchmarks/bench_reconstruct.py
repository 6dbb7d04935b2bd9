"""One training step on the sample capture: time by part of the course.

python -m benchmarks.bench_reconstruct [--steps 50] [--stages coarse fine]

A step is rays of one instant, the scene at its time, trace, loss, gradients and Adam; ten of them
run as one program and are waited for.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from benchmarks.problem import SAMPLE
from benchmarks.record import backend, begin, record, show


# Steps that are compiled and timed as one.
BLOCK = 10


def main(argv: Sequence[str] | None = None) -> None:
    """Run it."""
    parser = begin(__doc__)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--stages", nargs="+", default=["coarse", "fine"])
    parser.add_argument("--capture", help="another capture than the sample")
    chosen = parser.parse_args(argv)
    # They read pictures: not needed to know what the script is for.
    from gaussray.capture.formats.paired import read_capture
    from gaussray.reconstruct.log import RunLog
    from gaussray.reconstruct.motion import with_motion
    from gaussray.reconstruct.options import FitOptions, ReconstructOptions
    from gaussray.reconstruct.run_progress import RunProgress
    from gaussray.reconstruct.session import Session
    from gaussray.reconstruct.start import initial_state

    capture = read_capture(chosen.capture or SAMPLE)
    trace = replace(ReconstructOptions().trace, backend=backend(chosen.backend))
    options = ReconstructOptions(fit=FitOptions(auto=False), trace=trace)
    rows = []
    with tempfile.TemporaryDirectory() as out:
        log = RunLog(Path(out), resume=False, interval=60.0)
        session = Session(capture, log, options, True)
        state, progress = initial_state(session, RunProgress())
        for stage in chosen.stages:
            if stage == "fine":
                state, progress = with_motion(session, state, progress)
            state, seconds, terms, dropped = _stepped(session, state, stage, chosen.steps)
            parameters = state.parameters
            count = sum(x.logit_opacity.shape[0] for x in (parameters.static, parameters.moving))
            rows.append(
                record(
                    "reconstruct_step",
                    effect=stage,
                    scene=chosen.capture or "quickstart",
                    gaussians=count,
                    rays=options.fit.tiles * trace.bundle**2,
                    samples=1,
                    k=trace.k,
                    backend=trace.backend,
                    direction="forward_backward",
                    compile_s=round(BLOCK * (seconds[0] - min(seconds)), 2),
                    run_s_median=float(np.median(seconds[1:])),
                    run_s_min=float(min(seconds[1:])),
                    loss=float(terms["l1"]),
                    dropped=dropped,
                )
            )
    show(rows, "effect", "gaussians", "rays", "backend", "compile_s", "run_s_median", "dropped")


def _stepped(session, state, stage: str, steps: int):
    """State, seconds a step of every block, the last one's terms, and entries dropped."""
    from gaussray.reconstruct.loop import first_sizes, step_options
    from gaussray.reconstruct.step import schedule, train_block
    from gaussray.runtime.devices import everywhere

    loader, mesh, seconds, lost = session.loader, session.mesh, [], 0
    sizes = first_sizes(session, state, loader.batches(stage, 0, BLOCK))
    cameras, course = everywhere((session.footage.camera, schedule(10_000, 0)), mesh)
    for block in range(steps // BLOCK + 1):
        state = everywhere(state, mesh)
        batches = everywhere(loader.batches(stage, BLOCK * block, BLOCK), mesh)
        began = time.perf_counter()
        state, terms, _, _, dropped = jax.block_until_ready(
            train_block(
                state,
                cameras,
                batches,
                session.cameras,
                options=step_options(session, stage),
                schedule=course,
                sizes=sizes,
            )
        )
        seconds.append((time.perf_counter() - began) / BLOCK)
        lost += int(dropped)
    return state, seconds, terms, lost


if __name__ == "__main__":
    main()
