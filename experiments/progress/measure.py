"""How far the time that is said to be left is from the time that is.

`python -m experiments.progress.measure VERB [key=value ...]` runs `gaussray VERB` and compares, for
every piece of work that lasts `SECONDS` or more, all that was told after its first tenth with how
long the whole then took.
"""

import json
import subprocess
import sys
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np


# Work of less is over before anyone reads what is left of it.
SECONDS = 5.0
# How far an estimate may be off.
NEAR = 0.2


class Told(NamedTuple):
    """Seconds spent and, as it is said, left; and of how many units."""

    spent: float
    left: float | None
    total: int


def main(words: list[str]) -> None:
    command = [sys.executable, "-m", "gaussray", *words, "progress=json"]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert run.stdout is not None
    print("| work | units | seconds | estimates | within 20 % | median error | worst |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for name, told in works(json.loads(line) for line in run.stdout if line[:1] == "{"):
        if told[-1].spent >= SECONDS:
            print(row(name, told), flush=True)
    raise SystemExit(run.wait())


def works(events: Iterable[dict[str, Any]]) -> Iterator[tuple[str, list[Told]]]:
    """What was told of each piece of work that came to its end."""
    told: list[Told] = []
    for event in events:
        if event["event"] != "progress":
            continue
        told.append(Told(event["spent"], event["left"], event["total"]))
        if event["done"] >= event["total"]:
            yield event["work"], told
            told = []


def row(name: str, told: list[Told]) -> str:
    """A line of the table."""
    off = np.array(errors(told))
    cells = [name, str(told[-1].total), f"{told[-1].spent:.0f}", str(len(off))]
    if len(off):
        worst = off[np.argmax(np.abs(off))]
        near = np.mean(np.abs(off) <= NEAR)
        cells += [f"{near:.0%}", f"{np.median(np.abs(off)):.0%}", f"{worst:+.0%}"]
    else:
        cells += ["-"] * 3
    return f"| {' | '.join(cells)} |"


def errors(told: list[Told]) -> list[float]:
    """By how much of it the whole was thought to last too long, after its first tenth."""
    whole = told[-1].spent
    return [
        (one.spent + one.left) / whole - 1
        for one in told[:-1]
        if one.left is not None and one.spent >= whole / 10
    ]


if __name__ == "__main__":
    main(sys.argv[1:])
