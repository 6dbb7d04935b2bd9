"""checkpoint.npz: state and progress of an unfinished run, enough to resume with the same bits."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import optax

from gaussray.camera.corrections import Corrections
from gaussray.reconstruct.data.sampler import TileErrorState
from gaussray.reconstruct.optimize.free_space import FreeBalls
from gaussray.reconstruct.optimize.gradient_statistic import GradientStatistic
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.state import State
from gaussray.reconstruct.run_progress import RunProgress, progress_from_json, progress_to_json
from gaussray.scene.array_file import read_arrays, write_arrays
from gaussray.scene.gaussians import Unconstrained
from gaussray.scene.named_arrays import deformation_from, named_arrays
from gaussray.scene.shading import Shading
from gaussray.scene.transient import UnconstrainedTransients


PartT = TypeVar("PartT")


_FORMAT, _VERSION = "gaussray-checkpoint", 2
# Names in the file of the fields of TileErrorState, in their order, and of the gradient statistics
# in files of earlier versions.
TILE_ERRORS = {
    "mean": "note.errors.mean",
    "place": "note.errors.place",
    "error": "note.errors.told",
}
# Names of RunProgress.moved, and of the fields of RunProgress.free_space.
_MOVED = "note.moved"
_FREE_SPACE = {"center": "note.free_space.center", "radius": "note.free_space.radius"}
EARLIER = {"static_statistic": "static_pull", "moving_statistic": "moving_pull"}


def save_checkpoint(path: Path, state: State, progress: RunProgress) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        path: the file, checkpoint.npz.
        state: parameters, moments, statistics and step.
        progress: the rest of what a run goes on with.
    """
    header = {"format": _FORMAT, "version": _VERSION, "info": progress_to_json(progress)}
    arrays = named_arrays(state)
    if progress.tile_errors is not None:
        arrays |= {key: getattr(progress.tile_errors, name) for name, key in TILE_ERRORS.items()}
    if progress.moved is not None:
        arrays[_MOVED] = progress.moved
    if progress.free_space is not None:
        arrays |= {key: getattr(progress.free_space, name) for name, key in _FREE_SPACE.items()}
    write_arrays(path, header, arrays)


def load_checkpoint(path: Path) -> tuple[State, RunProgress]:
    """Read a checkpoint. ValueError if the file is damaged."""
    header, found = read_arrays(path, _FORMAT, _VERSION)
    array = _Whole(path, found)

    def parameters(prefix: str) -> Parameters:
        return Parameters(
            _unconstrained(array, f"{prefix}.static"),
            _unconstrained(array, f"{prefix}.moving"),
            deformation_from(array, f"{prefix}.deformation", path),
            _corrections(array, f"{prefix}.corrections"),
            _part(UnconstrainedTransients, array, f"{prefix}.transient"),
            _part(Shading, array, f"{prefix}.shading"),
        )

    def statistic(name: str) -> GradientStatistic:
        name = name if f"{name}.total" in array else EARLIER[name]
        total, seen = (jnp.asarray(array[f"{name}.{part}"]) for part in ("total", "seen"))
        return GradientStatistic(total, seen)

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
        statistic("static_statistic"),
        statistic("moving_statistic"),
        jnp.asarray(array["step"]),
        None if known.transient is None else statistic("transient_statistic"),
    )
    errors = None
    if TILE_ERRORS["mean"] in array:
        errors = TileErrorState(*(array[key] for key in TILE_ERRORS.values()))
    try:
        progress = progress_from_json(header.get("info", {}), errors)
    except ValueError as error:
        raise ValueError(
            f"{path}: {error}; the file is damaged. Start again without resume=true."
        ) from error
    moved = array[_MOVED] if _MOVED in array else None
    return state, replace(progress, moved=moved, free_space=_free_balls(array))


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


def _free_balls(array: _Whole) -> FreeBalls | None:
    """The free space of a run; None where there is none."""
    if not any(key in array for key in _FREE_SPACE.values()):
        return None
    center, radius = (array[key] for key in _FREE_SPACE.values())
    if radius.ndim != 1 or center.shape != (len(radius), 3):
        raise ValueError(
            f"{array.path}: the free space must have three coordinates for each radius; the file "
            "is damaged. Start again without resume=true."
        )
    return FreeBalls(center, radius)


def _unconstrained(array: dict[str, np.ndarray], prefix: str) -> Unconstrained:
    names = ("mean", "quat", "log_scale", "logit_opacity", "harmonics")
    return Unconstrained(*(jnp.asarray(array[f"{prefix}.{name}"]) for name in names))


def _part(kind: type[PartT], array: dict[str, np.ndarray], prefix: str) -> PartT | None:
    """The part of the parameters whose fields are named arrays, None if the fit has none."""
    names = kind.__dataclass_fields__  # type: ignore[attr-defined]
    if not any(f"{prefix}.{name}" in array for name in names):
        return None
    return kind(*(jnp.asarray(array[f"{prefix}.{name}"]) for name in names))


def _corrections(array: dict[str, np.ndarray], prefix: str) -> Corrections | None:
    """The corrections of cameras among named arrays, None if nothing is refined."""
    keys = [f"{prefix}.{name}" for name in Corrections.__dataclass_fields__]
    if not any(key in array for key in keys):
        return None
    return Corrections(*(jnp.asarray(array[key]) if key in array else None for key in keys))
