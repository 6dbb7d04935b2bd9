"""What a run writes as it goes: a line of metrics.jsonl per block of steps, and checkpoint.npz."""

import json
import os
import time as clock
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from gaussray.color import LEAST_MSE, psnr_from_mse
from gaussray.reconstruct.optimize.checkpoint import load_checkpoint, save_checkpoint
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.reconstruct.run_state import CHECKPOINT_FILE, demand_resumable
from gaussray.runtime.errors import FitError


class NonFiniteLoss(FitError):
    """A term of the loss was not a finite number; the last good state has been written."""


class RunLog:
    """metrics.jsonl and checkpoint.npz in the output folder of a run.

    Args:
        out: the output folder, which is made.
        resume: go on with the unfinished run in `out`; False: `out` may hold none.
        interval: seconds between two checkpoints (`save_in_time`).
        writes: whether this process writes the files; of several, one does.
        listener: called with every line of metrics.jsonl.

    Raises:
        ValueError: `out` holds an unfinished run, and `resume` is False.
        FileNotFoundError: `out` holds none, and `resume` is True.
        OSError: `out` cannot be written.
    """

    def __init__(
        self,
        out: Path,
        *,
        resume: bool,
        interval: float,
        writes: bool = True,
        listener: Callable[[dict[str, Any]], None] | None = None,
    ):
        self.out, self.interval, self.writes, self.listener = out, interval, writes, listener
        self.began = self.saved = clock.monotonic()
        self.checkpoint, self.metrics = out / CHECKPOINT_FILE, out / "metrics.jsonl"
        demand_resumable(out, resume=resume)
        if not writes:
            return
        try:
            out.mkdir(parents=True, exist_ok=True)
            self.metrics.open("a" if resume else "w").close()
        except OSError as error:
            raise OSError(f"out={out}: cannot be written: {error.strerror}") from error

    def resumed(self) -> tuple[State, RunProgress]:
        """State and progress of the interrupted run.

        Lines of metrics.jsonl about later steps go, for these steps are done again; the last line
        may be half a line.
        """
        state, progress = load_checkpoint(self.checkpoint)
        length = progress.metrics_bytes
        if self.writes and length is not None and 0 <= length < self.metrics.stat().st_size:
            os.truncate(self.metrics, length)
        return state, progress

    def record(
        self, progress: RunProgress, step: int, terms: dict[str, Array], gaussians: int
    ) -> None:
        """Write one line of metrics.jsonl about a block of steps.

        Args:
            progress: the segment and stage of the block.
            step: steps of the stage that are done with the block.
            terms: the terms of the loss, unweighted, as means over the block, with `mse`.
            gaussians: the number of Gaussians after the block.

        Raises:
            OSError: the file cannot be written.
        """
        if not self.writes:
            return
        line: dict[str, Any] = {"segment": progress.segment} if progress.segments > 1 else {}
        line |= {"stage": progress.stage, "step": step}
        line["seconds"] = round(clock.monotonic() - self.began, 3)
        line |= {name: float(value) for name, value in terms.items()}
        line |= {"psnr": psnr_from_mse(terms["mse"], least=LEAST_MSE), "gaussians": gaussians}
        try:
            with self.metrics.open("a") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise OSError(f"{self.metrics}: cannot be written: {error.strerror}") from error
        if self.listener:
            self.listener(line)

    def save(self, state: State, progress: RunProgress) -> None:
        """Write a checkpoint, whole or not at all.

        Args:
            state: the state to go on from.
            progress: the rest of what a run goes on with.
        """
        if not self.writes:
            return
        length = self.metrics.stat().st_size if self.metrics.exists() else 0
        save_checkpoint(self.checkpoint, state, replace(progress, metrics_bytes=length))
        self.saved = clock.monotonic()

    def save_in_time(self, state: State, progress: RunProgress) -> None:
        """Write a checkpoint if the last one is older than the interval.

        Args:
            state: the state to go on from.
            progress: the rest of what a run goes on with.
        """
        if clock.monotonic() - self.saved > self.interval:
            self.save(state, progress)

    def demand_finite(
        self, terms: dict[str, Array], before: State, after: State, progress: RunProgress
    ) -> None:
        """Stop at the first value that is not finite, with the state before the block on disk.

        Args:
            terms: the terms of the loss, as means over the block.
            before: the state before the block.
            after: the state after the block.
            progress: the progress before the block.

        Raises:
            NonFiniteLoss: a term of the loss or a parameter after the block is not finite.
        """
        wrong = [_term_key(name) for name, value in terms.items() if not np.isfinite(float(value))]
        # The tracer passes over Gaussians that are not finite, so the loss alone would not tell.
        if not wrong and bool(_all_finite(after.parameters)):
            return
        lost = _not_finite(after.parameters)
        names = " and ".join([*wrong[:1], *lost[:1]])
        rates = list(dict.fromkeys(_rate_of(name) for name in lost)) or ["optimizer.mean"]
        self.save(before, progress)
        where = f" of segment {progress.segment}" if progress.segments > 1 else ""
        first, last = int(before.step), int(after.step)
        raise NonFiniteLoss(
            f"{names} became infinite or not a number between steps {first} and {last} of the "
            f"{progress.stage} stage{where}. The state at step {first} is in {self.checkpoint}; go "
            f"on from it with resume=true and a smaller {' or '.join(rates[:3])} (a third, say)."
        )


@eqx.filter_jit
def _all_finite(tree) -> Array:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))


def _not_finite(parameters: Parameters) -> list[str]:
    """Names of the arrays that hold something else than finite numbers: static.mean and so on."""
    leaves = jax.tree.flatten_with_path(parameters)[0]
    return [
        jax.tree_util.keystr(path).lstrip(".") for path, x in leaves if not np.isfinite(x).all()
    ]


def _term_key(name: str) -> str:
    """The key of the weight of a term of the loss."""
    return f"{'density' if name.endswith('_cost') else 'loss'}.{name}"


def _rate_of(name: str) -> str:
    """The key of the learning rate of a parameter."""
    kind, _, rest = name.partition(".")
    part = name.rpartition(".")[2]
    if kind in ("static", "moving", "transient"):
        rates = {"log_scale": "scale", "logit_opacity": "opacity", "harmonics": "color"}
        rates["log_lifetime"] = "lifetime"
        return f"optimizer.{rates.get(part, part)}"
    if rest.startswith("control."):
        return f"optimizer.control_{part}"
    if kind == "corrections" or part in ("path", "turn", "light"):
        return f"optimizer.{part}"
    shared = {"planes": "planes", "mean[1]": "mean_head"}
    return f"optimizer.{shared.get(rest.partition('.')[0], 'network')}"
