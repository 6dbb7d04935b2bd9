"""Runs a command several times through a launcher of Hydra: here, on all cores, on a cluster."""

from collections.abc import Callable, Sequence
from typing import Any

from hydra import compose
from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.types import HydraContext

from gaussray.config.compose import hydra_session, hydra_words


# Defaults of Hydra's own keys for jobs; the user's words win. Hydra writes no files of its own, and
# a cluster's files go to the output folder.
LAUNCH = {
    "hydra.sweep.dir": "${out}/jobs",
    "hydra.sweep.subdir": ".",
    "hydra.output_subdir": "null",
    "hydra/hydra_logging": "none",
    "hydra/job_logging": "none",
}


def launch_jobs(
    command: str, overrides: Sequence[str], jobs: Sequence[Sequence[str]], task: Callable[..., Any]
) -> list[Any]:
    """Run a task once for each job and return the results, in the order of the jobs.

    The word `hydra/launcher=` chooses the launcher: one job after another (basic, the default), or
    by a plugin on the cores of a host (joblib) or on a cluster (submitit_local, submitit_slurm).

    Args:
        command: a subcommand of `gaussray`.
        overrides: words of its command line, also Hydra's own, that hold for all jobs.
        jobs: the words that each job adds to these.
        task: called with the configuration of a job, perhaps in another process.
    """
    names = {word.split("=")[0] for word in overrides}
    defaults = [f"{key}={value}" for key, value in LAUNCH.items() if key not in names]
    with hydra_session(command, overrides):
        words = [*hydra_words(overrides), *defaults]
        cfg = compose(command, words, return_hydra_config=True)
        context = HydraContext(GlobalHydra.instance().config_loader(), Callbacks())
        launcher = Plugins.instance().instantiate_launcher(
            hydra_context=context, task_function=task, config=cfg
        )
        task_words = list(cfg.hydra.overrides.task)
        returns = launcher.launch([[*task_words, *job] for job in jobs], initial_job_idx=0)
    return [job.return_value for job in returns]
