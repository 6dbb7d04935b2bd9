"""One training step on the sample capture: time by part of the course.

python benchmarks/bench_reconstruct.py [--steps 50]
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import jax


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50)
    chosen = parser.parse_args()
    import numpy as np

    from benchmarks.problem import record, show, use_all_cores
    from gaussray.capture.calibration import read_capture
    from gaussray.demo import SAMPLE
    from gaussray.fit.journal import Journal
    from gaussray.reconstruct import Fit, ReconstructOptions
    from gaussray.training import train_block

    use_all_cores()
    capture, options = read_capture(SAMPLE), ReconstructOptions()
    rows = []
    with tempfile.TemporaryDirectory() as out:
        journal = Journal(Path(out), resume=False, interval=60)
        fit = Fit(capture, journal, options, True)
        state = fit.begin()
        for stage in ("coarse", "fine"):
            if stage == "fine":
                state = fit.with_deformation(state)
            batches = fit.batches(stage, 0, 10)
            trial = fit.trial(state, batches)
            seconds = []
            for block in range(chosen.steps // 10 + 1):
                state = fit.placed(state)
                batches = fit.batches(stage, 10 * block, 10)
                began = time.perf_counter()
                state, terms, _, dropped = jax.block_until_ready(
                    train_block(
                        state,
                        fit.footage,
                        batches,
                        fit.extent,
                        options=fit.step,
                        steps=10_000,
                        trial=trial,
                    )
                )
                seconds.append((time.perf_counter() - began) / 10)
            parameters = state.parameters
            count = sum(x.logit_opacity.shape[0] for x in (parameters.static, parameters.moving))
            rows.append(
                record(
                    "reconstruct_step",
                    effect=stage,
                    scene="quickstart",
                    gaussians=count,
                    rays=options.fit.tiles * options.trace.bundle**2,
                    k=options.trace.k,
                    backend="array",
                    direction="forward_backward",
                    compile_s=round(10 * seconds[0], 2),
                    run_s_median=float(np.median(seconds[1:])),
                    run_s_min=float(min(seconds[1:])),
                    loss=float(terms["l1"]),
                    dropped=int(dropped),
                )
            )
    show(rows, ("effect", "gaussians", "rays", "run_s_median", "run_s_min", "loss", "dropped"))


if __name__ == "__main__":
    main()
