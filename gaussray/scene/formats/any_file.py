"""Scenes from and to files of any known format, chosen by the name."""

from pathlib import Path

from gaussray.io.sample_data import WORD, sample
from gaussray.io.validate import check_kind
from gaussray.scene.formats.convert import WRITERS, export_model, model_scene
from gaussray.scene.formats.sog import META
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import SCENE_RULE, Clip
from gaussray.scene.store import load_scene, save_scene


# Endings of the files of other programs, which `read_model` reads or refuses with a remedy.
FOREIGN = (".ply", ".spz", ".splat", ".glb", ".gltf", ".ksplat", ".sog", ".usd", ".usda", ".usdc")
# Endings that `save` writes, besides .npz.
_WRITTEN = tuple(name for name in WRITERS if name != "spz4")


def load(path: Path | str) -> Scene | Clip:
    """Read a scene from a file or folder.

    Args:
        path: A scene file (.npz), the folder of a reconstruction, a trained model of 3D Gaussian
            Splatting (.ply, .spz, .sog, .splat, whose colours are read as sRGB values, or .glb,
            which says what they are), or "sample", the scene that comes with the package.

    Returns:
        The scene; a clip if the file holds several segments of time.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: The file is damaged, or its format is not supported.
    """
    if str(path) == WORD and not Path(path).exists():
        path = sample("scene")
    if is_foreign(path):
        return model_scene(path)[0]
    if not Path(path).exists():
        raise FileNotFoundError(
            f"scene={path}: no such file or folder. Give the output folder of `gaussray "
            "reconstruct`, a .ply file, or scene=sample."
        )
    return load_scene(path)


def is_foreign(path: Path | str) -> bool:
    """Whether a path is a model of another program."""
    path = Path(path)
    is_sog = path.name == META or (path / META).is_file()
    return is_sog or path.suffix.lower() in FOREIGN


def save(path: Path | str, scene: Scene | Clip) -> None:
    """Write a scene to a file.

    Args:
        path: A scene file (.npz), which keeps every bit, or a model of 3D Gaussian Splatting (.ply,
            .spz, .glb) of a scene that stands still.
        scene: The scene.

    Raises:
        ValueError: The ending is neither, there is no scene, or the format cannot hold the scene.
        OSError: The file cannot be written.
    """
    check_kind("save(path, scene): path", path, (str, Path), "the name of a file")
    check_kind("save(path, scene): scene", scene, (Scene, Clip), SCENE_RULE)
    ending = Path(path).suffix.lower()
    if ending[1:] in _WRITTEN:
        export_model(scene, path, file_format=ending[1:])
    elif ending == ".npz":
        save_scene(path, scene)
    else:
        known = ", ".join([".npz", *(f".{name}" for name in _WRITTEN)])
        raise ValueError(f"save: the file must end in one of {known}, got {str(path)!r}.")
