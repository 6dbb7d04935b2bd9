"""Scenes from and to files of any known format, chosen by the name."""

import os
from pathlib import Path

from gaussray.io.sample_data import WORD, sample
from gaussray.io.validate import check_kind
from gaussray.scene.formats.convert import export_model, model_scene
from gaussray.scene.formats.export_transients import export_transients
from gaussray.scene.formats.sog import META
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import SCENE_RULE, Clip
from gaussray.scene.store import load_scene, save_scene


# Endings of the files of other programs, which `read_model` reads or refuses with a remedy.
FOREIGN = (".ply", ".spz", ".splat", ".glb", ".gltf", ".ksplat", ".sog", ".usd", ".usda", ".usdc")
# Formats of files by their endings, the longest first.
SCENE_FORMATS = {
    ".ftgs.ply": "ftgs",
    ".ply": "ply",
    ".spz": "spz",
    ".glb": "glb",
    ".usd": "usd",
    ".usda": "usd",
    ".usdc": "usd",
}


def load(path: Path | str) -> Scene | Clip:
    """Read a scene from a file or folder.

    Args:
        path: a scene file (.npz), the folder of a reconstruction, a trained model of 3D Gaussian
            Splatting (.ply, .spz, .sog, .splat, .ksplat, whose colours are read as sRGB values,
            or .glb, which says what they are), or "sample", the scene that comes with the package.

    Returns:
        The scene; a clip if the file holds several segments of time.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged, its format is not supported, or the path is no name.
    """
    check_kind("load(path): path", path, (str, os.PathLike), "the name of a file or folder")
    if str(path) == WORD and not Path(path).exists():
        path = sample("scene")
    if not Path(path).exists():
        raise FileNotFoundError(
            f"scene={path}: no such file or folder. Give the output folder of `gaussray "
            f"reconstruct`, a scene file (.npz, {', '.join(FOREIGN)}), or scene=sample."
        )
    return model_scene(path)[0] if is_foreign(path) else load_scene(path)


def is_foreign(path: Path | str) -> bool:
    """Whether a path is a model of another program."""
    path = Path(path)
    is_sog = path.name == META or (path / META).is_file()
    return is_sog or path.suffix.lower() in FOREIGN


def save(
    path: Path | str,
    scene: Scene | Clip,
    *,
    time: float | None = None,
    color: str = "srgb",
    degree: int = 3,
) -> None:
    """Write a scene to a file.

    Args:
        path: a scene file (.npz), which keeps every bit; a model of 3D Gaussian Splatting (.ply,
            .spz, .glb, .usd, .usda, .usdc) of the scene at one time; or .ftgs.ply, of one with
            transient Gaussians.
        scene: the scene.
        time: of a model: its time, in the scene's unit; None for a scene that stands still.
        color: of a model: `srgb`, as viewers expect it, or `linear`.
        degree: of a model: degree of the harmonics, at least the scene's; some viewers need 3.

    Raises:
        ValueError: The ending is neither, there is no scene, the format cannot hold the scene, or
            a file of all times gets a time.
        OSError: The file cannot be written.
    """
    check_kind("save(path, scene): path", path, (str, Path), "the name of a file")
    check_kind("save(path, scene): scene", scene, (Scene, Clip), SCENE_RULE)
    kind = "npz" if str(path).lower().endswith(".npz") else named_format(path)
    if kind in ("npz", "ftgs") and time is not None:
        raise ValueError(f"save: time must be None for a file of all times, got {time!r}.")
    if kind == "npz":
        save_scene(path, scene)
        return
    if kind is None:
        known = ", ".join([".npz", *SCENE_FORMATS])
        raise ValueError(f"save: the file must end in one of {known}, got {str(path)!r}.")
    if kind == "ftgs":
        export_transients(scene, path, color=color, degree=degree)
    else:
        export_model(scene, path, time, color=color, degree=degree, format=kind)


def named_format(path: Path | str) -> str | None:
    """The format that the ending of a file's name stands for, None if it stands for none."""
    name = Path(path).name.lower()
    return next((kind for ending, kind in SCENE_FORMATS.items() if name.endswith(ending)), None)


def export_format(out: Path | str, chosen: str | None, *, sequence: bool) -> str:
    """The format of an exported file: the chosen one, or that of the file's name.

    Args:
        out: the file; of a sequence the folder of its files, or one file of OpenUSD.
        chosen: `format` of the command; None leaves it to the name.
        sequence: whether several timestamps are exported.

    Raises:
        ValueError: The name stands for no format or for another one than the chosen one.
    """
    named = named_format(out)
    if chosen is None:
        if named is None and not (sequence and not Path(out).suffix):
            raise ValueError(
                f"out must end in one of {', '.join(SCENE_FORMATS)}, or format be given, got {out}."
            )
        return named or "ply"
    if named is not None and named != chosen.removesuffix("4"):
        raise ValueError(
            f"out={out} names the format {named}, got format={chosen}. Leave out format, or change "
            "the name."
        )
    return chosen
