"""Fits of captures with variants of options, and their scores: what still and moving ones share."""

import argparse
import ast
import dataclasses
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from gaussray.capture.capture import Capture
from gaussray.reconstruct import reconstruct
from gaussray.reconstruct.options import ReconstructOptions
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


# A change of the options of a fit.
Variant = Callable[[ReconstructOptions], ReconstructOptions]


class Fit(NamedTuple):
    """A scene, the seconds that it took with compilation, its steps over all stages and the
    Gaussians of the last one."""

    scene: Scene | Clip
    seconds: float
    steps: int
    gaussians: int


def replaced(options: ReconstructOptions, **changes) -> ReconstructOptions:
    """The options with `group__key` changed, e.g. loss__dssim=0.0."""
    for name, value in changes.items():
        group, key = name.split("__")
        part = dataclasses.replace(getattr(options, group), **{key: value})
        options = dataclasses.replace(options, **{group: part})
    return options


def varied(
    options: ReconstructOptions, name: str, variants: Mapping[str, Variant], settings: list[str]
) -> ReconstructOptions:
    """The options after the variants that `name` joins by +, then after `group.key=value` ones,
    which fit=auto leaves as they are, also where a value is the default."""
    for part in name.split("+"):
        options = variants[part](options)
    for setting in settings:
        key, value = setting.split("=", 1)
        try:
            literal = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            literal = value
        options = replaced(options, **{key.replace(".", "__"): literal})
        options = dataclasses.replace(options, explicit_keys=(*options.explicit_keys, key))
    return options


def fitted(capture: Capture, options: ReconstructOptions, devices: int | None, quiet: bool) -> Fit:
    """Reconstruct a capture; nothing of the run is kept but its scene and figures."""
    with tempfile.TemporaryDirectory() as out:
        begin = time.perf_counter()
        run = Path(out) / "run"
        scene = reconstruct(capture, run, options=options, devices=devices, quiet=quiet)
        seconds = time.perf_counter() - begin
        lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    last = {(line.get("segment"), line["stage"]): line["step"] for line in lines}
    return Fit(scene, seconds, sum(last.values()), lines[-1]["gaussians"])


def fit_arguments(command: argparse.ArgumentParser, variants: Mapping[str, Variant], first: str):
    """Arguments of `fit`: folders, variants and limits."""

    def known(name: str) -> str:
        if unknown := set(name.split("+")) - set(variants):
            raise argparse.ArgumentTypeError(
                f"{unknown.pop()!r} is none of the variants {', '.join(variants)}"
            )
        return name

    command.add_argument("folders", type=Path, nargs="+")
    command.add_argument("--variants", nargs="+", type=known, default=[first], metavar="NAME")
    command.add_argument(
        "--set", nargs="+", default=[], metavar="GROUP.KEY=VALUE", help="options of all fits"
    )
    command.add_argument("--scale", type=float, default=1.0)
    command.add_argument("--limit", type=float, default=1e9, help="no fit begins after so many s")
    command.add_argument("--quiet", action="store_true")


def pairs(chosen: argparse.Namespace) -> Iterator[tuple[Path, str]]:
    """Every folder with every variant, until the limit has passed."""
    begin = time.perf_counter()
    for folder in chosen.folders:
        for name in chosen.variants:
            if time.perf_counter() - begin > chosen.limit:
                return
            yield folder, name
