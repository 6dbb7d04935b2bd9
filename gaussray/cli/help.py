"""What `--help` says: the verbs, the keys of a verb that are used most, or all of them."""

import re
import textwrap

from gaussray.config.schema import Key, choices, conf_folder, groups, keys


VERBS = {
    "demo": "reconstruct the sample capture, film it through every effect, score it",
    "reconstruct": "multi-view video in, a scene out",
    "render": "a scene and cameras in, a paired capture and videos out; or a data set of many",
    "view": "a web page with the scene under the mouse and a camera's numbers as controls",
    "evaluate": "score a scene against a paired capture",
    "calibrate": "find cameras in pictures of a known scene, with standard errors",
    "import": "a model of 3D Gaussian Splatting or 4DGaussians in, a scene out",
    "export": "a scene at one instant as a 3D Gaussian Splatting model",
    "pack": "a produced data set as tar files that stream (WebDataset)",
}
# What a process ends with.
EXITS = {
    0: "all is well",
    1: "a fault of gaussray: the traceback says where",
    2: "something given or read is wrong: one line says what, and what to do",
    130: "interrupted; the line says how to go on",
}
# Beside what must be given, the keys that most commands have, in the order of their help.
MOST_USED = {
    "demo": "out capture.path fit.fine render.samples",
    "reconstruct": (
        "out resume capture.frames capture.scale capture.test fit.coarse fit.fine fit.tiles "
        "fit.refine fit.segment fit.memory fit.seed density.interval need.loss tensorboard"
    ),
    "render": (
        "out cameras format labels fps camera.split camera.names camera.times lens.fov "
        "aperture.radius aperture.focus_distance shutter.readout shutter.exposure "
        "trajectory.steps render.samples sensor.exposure factory.count"
    ),
    "view": (
        "cameras preset out view.port view.width view.rate lens.fov aperture.radius "
        "aperture.focus_distance shutter.readout shutter.exposure render.samples"
    ),
    "evaluate": "out evaluate.split evaluate.effects evaluate.frames evaluate.images",
    "calibrate": "out calibrate.parameters calibrate.effect calibrate.cameras calibrate.frames",
    "import": "iteration color",
    "export": "time color degree",
    "pack": "frames_per_tar",
}
SHARED = ("devices.count", "progress", "report")
WIDTH = 100
_NOW = re.compile(r"\$\{now:[^}]*\}")


def usage() -> str:
    """All verbs, where more is to be learnt, and exit codes."""
    lines = ["usage: gaussray <verb> [key=value ...] [group=choice ...]", ""]
    lines += [f"  {verb:<12} {text}" for verb, text in VERBS.items()]
    lines += ["", "  gaussray <verb> --help       the keys that are used most, groups and choices"]
    lines += ["  gaussray <verb> --help=all   every key, with its default and unit"]
    lines += ["  gaussray --completion SHELL  words of the command for bash or zsh to complete"]
    lines += ["  gaussray --version", ""]
    lines += ["progress=bar, lines, json (an object a line on stdout) or quiet; it ends with"]
    lines += [f"  {code:>3}  {text}" for code, text in EXITS.items()]
    return "\n".join(lines)


def short_help(verb: str) -> str:
    """What a verb must be given, its keys that are used most, its groups with their choices."""
    known = keys(verb)
    needed = [name for name, key in known.items() if key.default == "???"]
    words = " ".join(f"{name}=..." for name in needed)
    lines = [f"gaussray {verb}: {VERBS[verb]}", ""]
    lines += [f"usage: gaussray {verb} {words}".rstrip() + " [key=value ...] [group=choice ...]"]
    if needed:
        lines += ["", "must be given"]
        lines += [line for name in needed for line in _told(name, known[name])]
    lines += ["", "used most" + " " * 29 + "(default)"]
    for name in (*MOST_USED.get(verb, "").split(), *SHARED):
        if name in known and name not in needed:
            lines += _told(name, known[name])
    several = [group for group in groups(verb) if len(choices(group)) > 1]
    if several:
        lines += ["", "groups, choices: the default comes first"]
        lines += [line for group in several for line in _chosen(verb, group)]
    lines += ["", f"`gaussray {verb} --help=all` lists every key with its default and unit."]
    return "\n".join(lines)


def _told(name: str, key: Key) -> list[str]:
    """A key, its default, and what it means in the lines beside them."""
    default = "" if key.default == "???" else _NOW.sub("DATE_TIME", key.default)
    head = f"  {name:<24}  {default}"
    if len(head) > 40:
        return [head, *textwrap.wrap(key.meaning, WIDTH, initial_indent=" " * 42,
                                     subsequent_indent=" " * 42)]  # fmt: skip
    return textwrap.wrap(
        key.meaning or "-", WIDTH, initial_indent=f"{head:<40}  ", subsequent_indent=" " * 42
    )


def _chosen(verb: str, group: str) -> list[str]:
    first = groups(verb)[group]
    text = ", ".join([first, *(name for name in choices(group) if name != first)])
    return textwrap.wrap(text, WIDTH, initial_indent=f"  {group:<12}", subsequent_indent=" " * 14)


def full_help(verb: str) -> str:
    """The groups and keys of a verb, with defaults and comments, as the YAML files have them."""
    folder = conf_folder()
    lines = [f"gaussray {verb}: {VERBS[verb]}", ""]
    top = (folder / f"{verb}.yaml").read_text()
    for line in top.split("_self_", 1)[1].splitlines():
        lines += [f"  {line}"] if line.strip() else []
    for group, chosen in groups(verb).items():
        lines += ["", f"{group}={chosen}   (choices: {', '.join(choices(group))})"]
        for line in (folder / group / f"{chosen}.yaml").read_text().splitlines():
            if line.startswith(" "):
                lines.append(f"    {line}")
            elif line and not line.startswith("#"):
                lines.append(f"  {group}.{line}")
    return "\n".join(lines)
