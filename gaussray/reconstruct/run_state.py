"""Whether the run in an output folder is unfinished or finished, by the files that it has written.

A run writes a checkpoint every `fit.checkpoint` seconds. At the end it writes the scene, then the
report of pruning, and removes the checkpoint.
"""

from pathlib import Path


CHECKPOINT_FILE = "checkpoint.npz"
# The report of pruning.
REQUIREMENT_FILE = "requirement.json"


def has_checkpoint(out: Path) -> bool:
    """Whether an output folder holds an unfinished run, which can be resumed."""
    return (out / CHECKPOINT_FILE).is_file()


def is_finished(out: Path) -> bool:
    """Whether an output folder holds a finished run."""
    written = all((out / name).is_file() for name in (REQUIREMENT_FILE, "scene.npz"))
    return written and not has_checkpoint(out)


def demand_resumable(out: Path, *, resume: bool) -> None:
    """Stop where an unfinished run would be overwritten, or one that is not there resumed.

    Args:
        out: the output folder of the run.
        resume: whether the run shall go on with the one in `out`.

    Raises:
        ValueError: `out` holds an unfinished run, and `resume` is False.
        FileNotFoundError: `out` holds none, and `resume` is True.
    """
    unfinished = has_checkpoint(out)
    if unfinished and not resume:
        raise ValueError(
            f"out={out} holds an unfinished reconstruction. Add resume=true to go on with it, "
            "or choose another folder."
        )
    if resume and not unfinished:
        raise FileNotFoundError(
            f"out={out}: holds no {CHECKPOINT_FILE} to go on with. Leave out resume=true."
        )
