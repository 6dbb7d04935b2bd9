"""What a fit leaves on disk as it goes: a line of figures per block, and a state to go on from."""

import json
import os
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from gaussray.reconstruct.optimize.checkpoint import load_checkpoint, save_checkpoint
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State


# Of a fit, and of the hand-over from one segment to the next.
STAGES = ("coarse", "begin", "fine")


class NonFiniteLoss(RuntimeError):
    """A term of the loss was not a finite number; the last good state has been written."""


def refuse(out: Path, *, resume: bool) -> None:
    """Stop where an unfinished run would be overwritten, or one that is not there resumed."""
    unfinished = (out / "checkpoint.npz").is_file()
    if unfinished and not resume:
        raise ValueError(
            f"out={out} holds an unfinished reconstruction. Add resume=true to go on with it, "
            "or choose another folder."
        )
    if resume and not unfinished:
        raise FileNotFoundError(
            f"out={out}: holds no checkpoint.npz to go on with. Leave out resume=true."
        )


class Journal:
    """metrics.jsonl and checkpoint.npz in the folder `out`; `info` and the arrays `notes` are saved
    with every state.

    A folder with an unfinished run is open to `resume` alone, and `resume` to no other folder; what
    does not fit is refused before anything is written. Of several processes one `writes`. Every
    line of figures is also `told` to whoever wants to know.
    """

    def __init__(
        self,
        out: Path,
        *,
        resume: bool,
        interval: float,
        writes: bool = True,
        told: Callable[[dict[str, Any]], None] | None = None,
    ):
        self.out, self.interval, self.writes, self.told = out, interval, writes, told
        self.info: dict[str, Any] = {}
        self.notes: dict[str, np.ndarray] = {}
        self.began = self.saved = clock.monotonic()
        self.checkpoint = out / "checkpoint.npz"
        refuse(out, resume=resume)
        if not writes:
            return
        try:
            out.mkdir(parents=True, exist_ok=True)
            (out / "metrics.jsonl").open("a" if resume else "w").close()
        except OSError as error:
            raise OSError(f"out={out}: cannot be written: {error.strerror}") from error

    def resumed(self) -> tuple[State, str]:
        """The state of an interrupted run, and its stage."""
        state, self.info, self.notes = load_checkpoint(self.checkpoint)
        stage, told = self.info.pop("stage", None), self.info.pop("metrics", None)
        parts = [self.info.get(key, 1) for key in ("segment", "segments")]
        if stage not in STAGES or any(type(part) is not int or part < 1 for part in parts):
            raise ValueError(
                f"{self.checkpoint}: does not say where the fit stopped; the file is damaged. "
                "Start again without resume=true."
            )
        if self.writes and type(told) is int:
            self._forget(told)
        return state, stage

    def _forget(self, told: int) -> None:
        """Take the lines of steps after the saved state away, for they come again; the last of
        them may be half a line."""
        metrics = self.out / "metrics.jsonl"
        if 0 <= told < metrics.stat().st_size:
            os.truncate(metrics, told)

    def record(self, stage: str, step: int, terms: dict[str, Array], gaussians: int) -> None:
        """One line of figures, of so many Gaussians."""
        if not self.writes:
            return
        line: dict[str, Any] = {"segment": self.info["segment"]} if "segment" in self.info else {}
        line |= {"stage": stage, "step": step}
        line["seconds"] = round(clock.monotonic() - self.began, 3)
        line |= {name: float(value) for name, value in terms.items()}
        line |= {"psnr": decibel(terms["mse"]), "gaussians": gaussians}
        metrics = self.out / "metrics.jsonl"
        try:
            with metrics.open("a") as file:
                file.write(json.dumps(line) + "\n")
        except OSError as error:
            raise OSError(f"{metrics}: cannot be written: {error.strerror}") from error
        if self.told:
            self.told(line)

    def save(self, state: State, stage: str) -> None:
        """Write the state, whole or not at all."""
        if not self.writes:
            return
        metrics = self.out / "metrics.jsonl"
        told = metrics.stat().st_size if metrics.exists() else 0
        info = self.info | {"stage": stage, "metrics": told}
        save_checkpoint(self.checkpoint, state, info=info, notes=self.notes)
        self.saved = clock.monotonic()

    def save_in_time(self, state: State, stage: str) -> None:
        """Write the state if the last one is older than the interval."""
        if clock.monotonic() - self.saved > self.interval:
            self.save(state, stage)

    def demand_finite(self, terms: dict[str, Array], before: State, after: State, stage: str):
        """Stop at the first value that is not a number, with the state before it on disk."""
        wrong = [f"loss.{name}" for name, value in terms.items() if not np.isfinite(float(value))]
        # The tracer passes over Gaussians that are not finite, so the loss alone would not tell.
        if not wrong and bool(_all_finite(after.parameters)):
            return
        lost = _not_finite(after.parameters)
        told = " and ".join([*wrong[:1], *lost[:1]])
        rates = list(dict.fromkeys(_rate_of(name) for name in lost)) or ["optimizer.mean"]
        self.save(before, stage)
        where = f" of segment {self.info['segment']}" if "segment" in self.info else ""
        first, last = int(before.step), int(after.step)
        raise NonFiniteLoss(
            f"{told} became infinite or not a number between steps {first} and {last} of the "
            f"{stage} stage{where}. The state at step {first} is in {self.checkpoint}; go on from "
            f"it with resume=true and a smaller {' or '.join(rates[:3])} (a third, say)."
        )


def decibel(mse: Array | float) -> float:
    """PSNR of a mean squared error of values in [0, 1]."""
    return -10 * float(np.log10(max(float(mse), 1e-12)))


@eqx.filter_jit
def _all_finite(tree) -> Array:
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves(tree)]))


def _not_finite(parameters: Parameters) -> list[str]:
    """Names of the arrays that hold something else than finite numbers: static.mean and so on."""
    leaves = jax.tree.flatten_with_path(parameters)[0]
    return [
        jax.tree_util.keystr(path).lstrip(".") for path, x in leaves if not np.isfinite(x).all()
    ]


def _rate_of(name: str) -> str:
    """The key of the learning rate of a parameter."""
    kind, _, rest = name.partition(".")
    part = name.rpartition(".")[2]
    if kind in ("static", "moving"):
        rates = {"log_scale": "scale", "logit_opacity": "opacity", "harmonics": "color"}
        return f"optimizer.{rates.get(part, part)}"
    if kind == "corrections" or part in ("path", "turn", "light"):
        return f"optimizer.{part}"
    shared = {"planes": "planes", "mean[1]": "motion"}
    return f"optimizer.{shared.get(rest.partition('.')[0], 'network')}"
