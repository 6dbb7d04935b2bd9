"""Which damaged files end in anything but a scene or a clear refusal.

Each reader works in a process of its own, with little memory and time; input i of a seed is always
the same file. `--only i` shows what becomes of one.
"""

import argparse
import json
import mmap
import multiprocessing
import os
import resource
import signal
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import numpy as np


# Seconds for one input, bytes beyond what the process has when it begins, inputs of a process
# (what is compiled for odd shapes is kept, and takes memory).
SECONDS, ROOM, TERM = 60.0, 3 << 30, 50_000
# Where the files lie: no disk is waited for.
SHELF = "/dev/shm"
GOOD = ("accepted", "refused")
KINDS = (*GOOD, "unclear", "crashed", "killed", "hung", "memory", "escaped")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reader", default="all", help="names, with commas, or all")
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="where to go on")
    parser.add_argument("--minutes", type=float, default=1e9, help="most of them for one reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, help="one input, with its traceback")
    parser.add_argument("--out", default="runs/hostile", help="folder for the inputs that fail")
    told = parser.parse_args()
    from experiments.hostile.readers import READERS

    names = list(READERS) if told.reader == "all" else told.reader.split(",")
    if told.only is not None:
        with tempfile.TemporaryDirectory(prefix="hostile", dir=SHELF) as folder:
            inputs = range(told.only, told.only + 1)
            _work(names[0], told.seed, inputs, None, Path(folder), told.out, show=True)
        return
    print(f"| reader | inputs | {' | '.join(KINDS)} | seconds |")
    print("|---" * (len(KINDS) + 3) + "|", flush=True)
    for name in names:
        began = time.monotonic()
        inputs = range(told.first, told.inputs)
        count = _campaign(name, told.seed, inputs, began + 60 * told.minutes, Path(told.out))
        row = [name, sum(count.values()), *(count[kind] for kind in KINDS)]
        row.append(f"{time.monotonic() - began:.0f}")
        print(f"| {' | '.join(str(x) for x in row)} |", flush=True)


def _campaign(name, seed, inputs, ends, out):
    """How often each outcome came: of all inputs, or of those tried when the clock `ends`."""
    board = mmap.mmap(-1, 8 * (2 + len(KINDS)))
    told = np.frombuffer(board, np.int64)
    told[0] = inputs.start
    while told[0] < inputs.stop and time.monotonic() < ends:
        term = range(int(told[0]), min(inputs.stop, int(told[0]) + TERM))
        with tempfile.TemporaryDirectory(prefix="hostile", dir=SHELF) as folder:
            work = name, seed, term, board, Path(folder), out
            child = multiprocessing.get_context("fork").Process(target=_work, args=work)
            child.start()
            fate = watched(child, told, ends)
        if fate:
            told[2 + KINDS.index(fate)] += 1
            _note(out, name, seed, int(told[0]), fate, "")
            told[0] += 1
    return dict(zip(KINDS, told[2:].tolist(), strict=True))


def watched(child, told, ends):
    """Wait for a process; what became of it, nothing if it ended as it should or the clock did."""
    last, since = -1, time.monotonic()
    while child.is_alive():
        child.join(0.5)
        if told[0] != last:
            last, since = int(told[0]), time.monotonic()
            if since > ends:
                child.kill()
                child.join()
                return ""
        elif time.monotonic() - since > SECONDS:
            child.kill()
            child.join()
            return "hung"
    return "killed" if child.exitcode else ""


def _work(name, seed, inputs, board, folder, out, show=False):
    """Read inputs in a folder, and count on the board what became of them."""
    from experiments.hostile.mutate import damaged
    from experiments.hostile.readers import READERS
    from experiments.hostile.trap import Trap

    warnings.simplefilter("ignore")
    reader = READERS[name]
    told = None if board is None else np.frombuffer(board, np.int64)
    os.chdir(folder)
    samples, lying = reader.samples(), {}
    _silence(show)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    outcome(reader, samples[0], folder, lying)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + ROOM, size + ROOM))
    trap = Trap(folder)
    for i in inputs:
        if told is not None:
            told[0] = i
        dice = np.random.default_rng([seed, i, *name.encode()])
        files = dict(samples[int(dice.integers(len(samples)))])
        chosen = [x for x in files if x in reader.kinds]
        victim = chosen[int(dice.integers(len(chosen)))]
        files[victim] = damaged(dice, files[victim], reader.kinds[victim])
        with trap:
            kind, why = outcome(reader, files, folder, lying)
        if trap.sprung:
            kind, why = "escaped", f"{trap.sprung} ({kind})"
        if told is not None:
            told[2 + KINDS.index(kind)] += 1
        if kind not in GOOD:
            _note(out, name, seed, i, kind, why)
        if show:
            print(kind, why, victim, files[victim][:2000], sep="\n")
    if told is not None:
        told[0] = inputs.stop


def outcome(reader, files, folder, lying):
    """What becomes of a set of files, and the traceback of what should not be; `lying` are those of
    the folder as they are."""
    for name, content in files.items():
        if name not in lying:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if lying.get(name) is not content:
            (folder / name).write_bytes(content)
            lying[name] = content
    try:
        reader.read(folder)
        return "accepted", ""
    except MemoryError:
        return "memory", traceback.format_exc()
    except (ValueError, OSError) as error:
        clear = type(error).__module__.split(".")[0] in ("gaussray", "builtins")
        named = str(folder) in str(error) or any(word in str(error) for word in reader.said)
        short = len(str(error)) < 6000
        good = clear and named and short
        return ("refused", str(error)) if good else ("unclear", traceback.format_exc())
    except Exception:
        return "crashed", traceback.format_exc()


def _note(out, name, seed, index, kind, why):
    out = Path(__file__).resolve().parents[2] / out
    out.mkdir(parents=True, exist_ok=True)
    told = {"reader": name, "seed": seed, "input": index, "outcome": kind, "why": why[-3000:]}
    with (out / "failures.jsonl").open("a") as file:
        file.write(json.dumps(told) + "\n")


def _silence(show):
    """Libraries of other languages print what they think of a file."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if not show:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)


if __name__ == "__main__":
    main()
