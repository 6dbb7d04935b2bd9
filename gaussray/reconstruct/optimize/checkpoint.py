"""The state of an unfinished fit on disk, enough to go on bit by bit as if nothing had happened."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from gaussray.camera.corrections import Corrections
from gaussray.reconstruct.optimize.density import Pull
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State
from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.gaussians import Unconstrained
from gaussray.scene.named_arrays import deformation_from, named_arrays


FORMAT, VERSION = "gaussray-checkpoint", 2
NOTE = "note."


def save_checkpoint(
    path: Path, state: State, *, info: dict[str, Any], notes: dict[str, np.ndarray]
) -> None:
    """Write the state, whole or not at all."""
    header = {"format": FORMAT, "version": VERSION, "info": info}
    write_arrays(path, header, named_arrays(state) | {NOTE + name: x for name, x in notes.items()})


def load_checkpoint(path: Path) -> tuple[State, dict[str, Any], dict[str, np.ndarray]]:
    """Read a state and what was noted with it."""
    header, found = read_arrays(path, FORMAT, VERSION)
    array = _Whole(path, found)

    def parameters(prefix: str) -> Parameters:
        return Parameters(
            _unconstrained(array, f"{prefix}.static"),
            _unconstrained(array, f"{prefix}.moving"),
            deformation_from(array, f"{prefix}.deformation", path),
            _corrections(array, f"{prefix}.corrections"),
        )

    def pull(name: str) -> Pull:
        return Pull(jnp.asarray(array[f"{name}.total"]), jnp.asarray(array[f"{name}.seen"]))

    adam = optax.ScaleByAdamState(
        count=jnp.asarray(array["adam.count"]),
        mu=parameters("adam.mu"),  # type: ignore[arg-type]
        nu=parameters("adam.nu"),  # type: ignore[arg-type]
    )
    known = parameters("parameters")
    shapes = [[x.shape for x in jax.tree.leaves(tree)] for tree in (known, adam.mu, adam.nu)]
    if shapes[0] != shapes[1] or shapes[0] != shapes[2]:
        raise ValueError(
            f"{path}: the state of the optimiser does not fit the parameters; the file is damaged. "
            "Start again without resume=true."
        )
    state = State(
        known,
        adam,
        pull("static_pull"),
        pull("moving_pull"),
        jnp.asarray(array["step"]),
    )
    notes = {name.removeprefix(NOTE): x for name, x in found.items() if name.startswith(NOTE)}
    return state, header.get("info", {}), notes


class _Whole(dict):
    """Arrays of numbers of a file, in which none may be missing."""

    def __init__(self, path: Path, array: dict[str, np.ndarray]):
        super().__init__(array)
        self.path = path

    def __getitem__(self, name: str) -> np.ndarray:
        found = super().__getitem__(name)
        if found.dtype.kind not in "fiub":
            raise ValueError(
                f"{self.path}: the array '{name}' must hold real numbers, got {found.dtype}; the "
                "file is damaged. Start again without resume=true."
            )
        return found

    def __missing__(self, name: str):
        raise ValueError(f"{self.path}: the array '{name}' is missing; the file is not whole.")


def _unconstrained(array: dict[str, np.ndarray], prefix: str) -> Unconstrained:
    names = ("mean", "quat", "log_scale", "logit_opacity", "harmonics")
    return Unconstrained(*(jnp.asarray(array[f"{prefix}.{name}"]) for name in names))


def _corrections(array: dict[str, np.ndarray], prefix: str) -> Corrections | None:
    """The corrections of cameras among named arrays, None if nothing is refined."""
    names = [name.removeprefix(f"{prefix}.") for name in array if name.startswith(f"{prefix}.")]
    held = {name: jnp.asarray(array[f"{prefix}.{name}"]) for name in names}
    return Corrections(**held) if held else None
