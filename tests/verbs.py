"""What `test_devices.py` runs in processes of their own, for a process has its devices for life.

`verbs.py TRUTH OUT VERBS [override ...]`: verbs (joined by commas) on the toy's capture:
reconstruct (`break`: until it is interrupted; `resume`: on from there), render, evaluate.
"""

import sys

import jax
import toy

from gaussray.cli.main import main
from gaussray.reconstruct.log import RunLog


FIT = [*toy.overrides(toy.SHORT), "fit.checkpoint=0"]


def run(truth: str, out: str, verbs: str, devices: list[str]) -> None:
    seen, broken = [f"capture.path={truth}", *FIT], f"out={out}/broken"
    words = {
        "reconstruct": ["reconstruct", f"out={out}/scene", *seen],
        "break": ["reconstruct", broken, *seen],
        "resume": ["reconstruct", broken, "resume=true", *seen],
        "render": ["render", f"scene={truth}/run", f"out={out}/film", "render.samples=1"],
        "evaluate": ["evaluate", f"scene={truth}/run", f"truth={truth}", f"out={out}/scores"],
    }
    for verb in verbs.split(","):
        line = [*words[verb], "quiet=true", "report=false", *devices]
        if verb == "break":
            interrupted(line)
        else:
            main(line)


def interrupted(words: list[str]) -> None:
    """Stops after the first block of the fine stage, with the state before it on disk."""
    record = RunLog.record

    def stop(self, progress, *arguments):
        if progress.stage == "fine":
            raise KeyboardInterrupt
        record(self, progress, *arguments)

    RunLog.record = stop
    try:
        main(words)
    except SystemExit as error:
        assert error.code == 130
    RunLog.record = record


if __name__ == "__main__":
    jax.config.update("jax_disable_most_optimizations", True)
    run(*sys.argv[1:4], sys.argv[4:])
