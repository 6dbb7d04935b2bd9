"""Help texts: the list of commands, the most used keys of a command, and all of its keys."""

import re
import textwrap
from collections.abc import Sequence

from gaussray.config.schema import Key, choice_keys, choices, conf_folder, groups, keys


COMMANDS = {
    "demo": "run everything on the sample capture: reconstruct, render effects, evaluate",
    "prepare": "make a capture of videos: frames, synchronisation, poses, checks",
    "reconstruct": "reconstruct a dynamic scene from multi-view video",
    "render": "render a scene through cameras, to pictures, labels and videos",
    "view": "explore a scene in the web browser, with every camera setting as a control",
    "evaluate": "score a scene against the pictures of a capture",
    "calibrate": "find the cameras of pictures of a known scene, with standard errors",
    "import": "convert a 3D Gaussian Splatting or 4DGaussians model to a scene",
    "export": "write a scene for other programs: PLY, SPZ, glTF, OpenUSD, FreeTimeGS",
    "pack": "copy a rendered dataset into tar files (WebDataset) or the layout of other tools",
}
# Meaning of the exit codes.
EXITS = {
    0: "success",
    1: "a bug in gaussray; a traceback is printed",
    2: "a wrong argument or input; one line says what is wrong and how to fix it",
    130: "interrupted; one line says how to continue",
}
# The keys of each command that short help shows, in this order, after the mandatory ones.
MOST_USED = {
    "demo": "out capture.path fit.fine render.samples",
    "prepare": (
        "sync.method sync.offsets frames.rate frames.span frames.readout frames.instants "
        "poses.calibration poses.lens poses.model poses.intrinsics poses.fov poses.rig"
    ),
    "reconstruct": (
        "out resume capture.frames capture.scale capture.test fit.minutes fit.motion fit.start "
        "fit.refine fit.segment fit.memory fit.seed prune.loss tensorboard"
    ),
    "render": (
        "out cameras format labels fps camera.split camera.names camera.times lens.fov "
        "aperture.radius aperture.focus_distance shutter.readout shutter.exposure "
        "trajectory.steps render.samples sensor.exposure dataset.count dataset.layout"
    ),
    "view": (
        "cameras preset out view.port view.width view.rate lens.fov aperture.radius "
        "aperture.focus_distance shutter.readout shutter.exposure render.samples"
    ),
    "evaluate": "out evaluate.split evaluate.effects evaluate.frames evaluate.images",
    "calibrate": "out calibrate.parameters calibrate.effect calibrate.cameras calibrate.frames",
    "import": "iteration color",
    "export": "time count format color degree",
    "pack": "layout frames_per_tar imu.rate imu.gravity",
}
_ALL_COMMANDS = ("devices.count", "progress", "report")
# Commands that work on one device.
_ONE_DEVICE = ("prepare", "calibrate", "import", "export", "pack")
_WIDTH = 100
_NOW = re.compile(r"\$\{now:[^}]*\}")


def usage() -> str:
    """The help of `gaussray` itself: all commands, where to read on, and exit codes."""
    lines = ["usage: gaussray COMMAND [key=value ...] [group=choice ...]", "", "commands"]
    lines += [f"  {command:<12} {text}" for command, text in COMMANDS.items()]
    lines += ["", "help"]
    lines += ["  gaussray COMMAND --help       the most used keys of a command, and its groups"]
    lines += ["  gaussray COMMAND --help=all   all keys, with defaults and units"]
    lines += ["  gaussray --completion SHELL   a script for tab completion in bash or zsh"]
    lines += ["  gaussray --version            the installed version"]
    lines += ["", "first steps"]
    lines += ["  gaussray demo"]
    lines += ["  gaussray render scene=sample lens=fisheye out=pictures"]
    lines += ["", "exit codes"]
    lines += [f"  {code:>3}  {text}" for code, text in EXITS.items()]
    return "\n".join(lines)


def short_help(command: str) -> str:
    """The mandatory keys of a command, the most used ones, and its groups with their choices."""
    by_name = keys(command)
    mandatory = [name for name, key in by_name.items() if key.default == "???"]
    arguments = " ".join(f"{name}=..." for name in mandatory)
    lines = [f"gaussray {command}: {COMMANDS[command]}", ""]
    lines += [f"usage: gaussray {command} {arguments}".rstrip()]
    lines[-1] += " [key=value ...] [group=choice ...]"
    if mandatory:
        lines += ["", "mandatory keys"]
        lines += [line for name in mandatory for line in _key_lines(name, by_name[name])]
    lines += ["", f"{'most used keys':<28}(default)"]
    for name in (*MOST_USED.get(command, "").split(), *_ALL_COMMANDS):
        unused = name == "devices.count" and command in _ONE_DEVICE
        if name in by_name and name not in mandatory and not unused:
            lines += _key_lines(name, by_name[name])
    several = [group for group in groups(command) if len(choices(group)) > 1]
    if several:
        lines += ["", "groups (the first choice is the default)"]
        lines += [line for group in several for line in _group_lines(command, group)]
    lines += ["", f"`gaussray {command} --help=all` lists every key with its default and unit."]
    return "\n".join(lines)


def _key_lines(name: str, key: Key) -> list[str]:
    """A key and its default, with its meaning in a column beside them."""
    default = "" if key.default == "???" else _NOW.sub("DATE_TIME", key.default)
    head = f"  {name:<24}  {default}"
    column = " " * 42
    # A default that is too long for its column gets a line of its own.
    first = column if len(head) > 40 else f"{head:<40}  "
    meaning = textwrap.wrap(
        key.meaning or "-", _WIDTH, initial_indent=first, subsequent_indent=column
    )
    return [head, *meaning] if len(head) > 40 else meaning


def _group_lines(command: str, group: str) -> list[str]:
    """A group and its choices, the default first."""
    default = groups(command)[group]
    text = ", ".join([default, *(name for name in choices(group) if name != default)])
    return textwrap.wrap(text, _WIDTH, initial_indent=f"  {group:<12}", subsequent_indent=" " * 14)


def full_help(command: str, words: Sequence[str] = ()) -> str:
    """The groups and keys of a command, with defaults and meanings, as the YAML files have them.

    Args:
        command: a subcommand of `gaussray`.
        words: words of its command line; of groups that they choose (`lens=opencv`), the keys are
            those of that choice.
    """
    lines = [f"gaussray {command}: {COMMANDS[command]}", ""]
    top_level = (conf_folder() / f"{command}.yaml").read_text()
    for line in top_level.split("_self_", 1)[1].splitlines():
        lines += [f"  {line}"] if line.strip() else []
    chosen = dict(word.split("=", 1) for word in words if "=" in word)
    for group, default in groups(command).items():
        choice = chosen.get(group, default)
        choice = choice if choice in choices(group) else default
        lines += ["", f"{group}={choice}   (choices: {', '.join(choices(group))})"]
        for name, key in choice_keys(group, choice).items():
            lines += _key_lines(f"{group}.{name}", key)
    return "\n".join(lines)
