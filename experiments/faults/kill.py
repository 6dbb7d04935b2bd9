"""Kills runs at random moments; in the end they must have left the bytes of an undisturbed run.

`python -m experiments.faults.kill --times 50 --seed 0 [--out DIR] [--works reconstruct,...]`
"""

import argparse
import importlib
import importlib.metadata
import json
import os
import random
import signal
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.datasets.kill import changed
from experiments.faults.toy import BLOCK, INTERVAL, Forked, words_of, write_capture
from gaussray.cli import main as command
from gaussray.runtime.lock import LOCK_FILE as LOCK


WORKS = ("reconstruct", "render", "samples", "evaluate")
# What a file says of when and how fast, which is never the same twice.
TIMED = ("seconds", "fps", "began", "compile", "versions", "git", "changed")


class Work:
    """One command, its undisturbed run, and what kills did to another."""

    def __init__(self, name: str, folder: Path, capture: Path):
        self.name, self.folder = name, folder / name
        self.folder.mkdir(parents=True)
        self.out, self.log = self.folder / "run", self.folder / "log.txt"
        self.words = words_of(name, capture, self.out)
        self.kills = self.writing = self.anew = 0
        self.lost: list[float] = []
        self.steps: list[int] = []

    def run(self) -> float:
        """The command to its end; seconds from the moment at which it holds its folder."""
        run = self._begun()
        began = time.monotonic()
        if run.wait():
            raise SystemExit(f"{self.name}: ended with {run.returncode}, see {self.log}")
        return time.monotonic() - began

    def kill(self, seconds: float, at_a_file: bool) -> bool:
        """Kill the command so long after it began, or, `at_a_file`, while the next file is being
        written; whether it was still at work."""
        run = self._begun()
        end, patience = time.monotonic() + seconds, time.monotonic() + seconds + 20
        while run.poll() is None and time.monotonic() < end:
            time.sleep(0.001)
        while at_a_file and run.poll() is None and not self._half():
            if time.monotonic() > patience:
                break
        half = bool(self._half())
        run.kill()
        code = run.wait()
        if code not in (0, -signal.SIGKILL):
            raise SystemExit(f"{self.name}: ended with {code}, see {self.log}")
        self.kills += code != 0
        self.writing += code != 0 and half
        return code != 0

    def _begun(self) -> Forked:
        self._lock = self.out / (".gaussray.0-1.lock" if self.name == "samples" else LOCK)
        self._lock.unlink(missing_ok=True)
        run = Forked(lambda: command(self.words), self.log)
        while run.poll() is None and not self._lock.exists():
            time.sleep(0.005)
        return run

    def _half(self) -> list[Path]:
        return list(self.out.rglob(".*.part*"))

    def look(self) -> None:
        """Note the steps, and the seconds of them, that will have to be done again."""
        checkpoint, metrics = self.out / "checkpoint.npz", self.out / "metrics.jsonl"
        if not metrics.exists():
            return
        told = 0
        if checkpoint.exists():
            with np.load(checkpoint) as file:
                told = json.loads(str(file["header"]))["info"]["metrics"]
        data = metrics.read_bytes()
        before, after = (whole_lines(part) for part in (data[:told], data[told:]))
        if after:
            # Of work: between two stages, and before the first, programs are loaded.
            since = after[0]["seconds"]
            if before and before[-1]["stage"] == after[0]["stage"]:
                since = min(since, before[-1]["seconds"])
            self.lost.append(after[-1]["seconds"] - since)
            self.steps.append(BLOCK * len(after))
        else:
            self.lost.append(0.0)
            self.steps.append(0)


def whole_lines(data: bytes) -> list[dict[str, Any]]:
    """The lines that are complete."""
    return [json.loads(line) for line in data.split(b"\n")[:-1]]


def untimed(value: Any) -> Any:
    """A document without what says when and how fast."""
    if isinstance(value, dict):
        return {k: untimed(v) for k, v in value.items() if k not in TIMED}
    return [untimed(v) for v in value] if isinstance(value, list) else value


def contents(out: Path) -> dict[str, Any]:
    """What is in every file, but for times."""
    found: dict[str, Any] = {}
    for path in sorted(p for p in out.rglob("*") if p.is_file()):
        name = str(path.relative_to(out))
        if path.name in ("metrics.jsonl", "scores.jsonl"):
            found[name] = untimed(whole_lines(path.read_bytes()))
        elif path.name in ("run.json", "report.json"):
            found[name] = untimed(json.loads(path.read_text()))
        else:
            found[name] = path.read_bytes()
    return found


def finished(out: Path) -> dict[Path, Any]:
    """Pictures that are there."""
    return {path: path.stat() for path in out.rglob("images/**/*.*") if path.name[0] != "."}


def tried(work: Work, times: int, chance: random.Random) -> int:
    """Kill a work so many times, let it end, compare; the number of files that differ."""
    work.run()
    work.out.rename(work.folder / "compiling")
    seconds = work.run()
    work.out.rename(work.folder / "whole")
    attempt = 0
    while work.kills < times:
        attempt += 1
        before = finished(work.out) if work.out.exists() else {}
        # What is gone on with takes less than the whole.
        if not work.kill(chance.uniform(0, 0.7 * seconds), attempt % 3 == 0):
            # It came to its end: the next one begins anew.
            compare(work)
            work.out.rename(work.folder / f"whole_{attempt}")
            continue
        work.anew += sum(changed(path, old) for path, old in before.items() if path.exists())
        work.look()
    work.run()
    wrong = compare(work)
    lost = f"{max(work.steps)} steps, {max(work.lost):.2f} s" if work.steps else "-"
    if work.name in ("render", "samples"):
        lost = f"{work.anew} pictures made twice"
    print(
        f"| {work.name} | {work.kills} | {work.writing} | {seconds:.1f} | {lost} | "
        f"{len(contents(work.out))} | {wrong} |",
        flush=True,
    )
    return wrong


def compare(work: Work) -> int:
    """The number of files that differ from those of the undisturbed run, which are named."""
    one, two = contents(work.folder / "whole"), contents(work.out)
    wrong = [name for name in sorted(one.keys() | two.keys()) if one.get(name) != two.get(name)]
    if wrong:
        print(f"{work.name}: {len(wrong)} files differ: {wrong[:5]}", flush=True)
    return len(wrong)


def prepare(folder: Path) -> None:
    """Import what the works need, for them all; none of it may bring a device up. Programs are
    compiled in little time rather than well, once, and kept."""
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder / "compiled")
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "1"
    jax.config.update("jax_compilation_cache_dir", str(folder / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_disable_most_optimizations", True)
    if importlib.metadata.version("jaxlib").startswith("0.10."):
        # Its older way to emit code compiles in half the time; XLA ends over flags it has not.
        flags = os.environ.get("XLA_FLAGS", "")
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_use_fusion_emitters=false"
    # JAX is not at work in this process.
    warnings.filterwarnings("ignore", message=r"os\\.fork\\(\\) was called")
    for name in ("reconstruct.pipeline", "evaluate.pipeline", "render.dataset", "config.samples"):
        importlib.import_module(f"gaussray.{name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=50, help="kills, of all works together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="an empty folder; else a temporary one")
    parser.add_argument("--works", default=",".join(WORKS))
    chosen = parser.parse_args()
    folder = (chosen.out or Path(tempfile.mkdtemp(prefix="faults_"))).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    prepare(folder)
    if Forked(lambda: write_capture(folder / "capture"), folder / "log.txt").wait():
        raise SystemExit(f"the capture cannot be written, see {folder / 'log.txt'}")
    works, chance = chosen.works.split(","), random.Random(chosen.seed)
    print(f"states are saved every {INTERVAL} s; seed {chosen.seed}; {folder}")
    print("| work | kills | while writing | seconds undisturbed | lost at most | files | differ |")
    print("|---|---|---|---|---|---|---|", flush=True)
    wrong, unknown = 0, set(works) - set(WORKS)
    if unknown:
        raise SystemExit(f"--works has no {', '.join(sorted(unknown))}; it has {', '.join(WORKS)}")
    for i, name in enumerate(works):
        share = chosen.times // len(works) + (i < chosen.times % len(works))
        wrong += tried(Work(name, folder, folder / "capture"), share, chance)
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
