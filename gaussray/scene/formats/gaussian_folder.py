"""Reads the folders of trained models of 4DGaussians (Wu et al. 2024) and 3D Gaussian Splatting.

`<model>/cfg_args` holds the training arguments as text. Each `iteration_<n>` in
`<model>/point_cloud` holds `point_cloud.ply`, the undeformed Gaussians, and `deformation.pth`, the
network (`gaussian_network`). A `coarse_iteration_<n>` and a model of 3D Gaussian Splatting, which
has the same folders, are static.
"""

import ast
import re
from pathlib import Path
from typing import Any

from gaussray.io.safe.files import read_text
from gaussray.runtime.output import listed_names
from gaussray.scene.formats.compressed_ply import is_compressed_ply, read_compressed_ply
from gaussray.scene.formats.gaussian_network import read_field
from gaussray.scene.formats.gaussian_ply import read_gaussians, read_unconstrained
from gaussray.scene.formats.gltf import read_gltf
from gaussray.scene.formats.ksplat import read_ksplat
from gaussray.scene.formats.sog import META, read_sog
from gaussray.scene.formats.splat_file import read_splat
from gaussray.scene.formats.spz import read_spz
from gaussray.scene.formats.usd import read_usd
from gaussray.scene.gaussians import Gaussians, constrain
from gaussray.scene.residual_field import ResidualField


# The argument that disables each head. The file holds all five heads, trained or not.
FLAGS = {
    "mean": "no_dx",
    "rotation": "no_dr",
    "scale": "no_ds",
    "opacity": "no_do",
    "harmonics": "no_dshs",
}
# Readers of other files that hold the Gaussians of a static model.
READERS = {
    ".spz": read_spz,
    ".splat": read_splat,
    ".ksplat": read_ksplat,
    ".sog": read_sog,
    ".glb": lambda path: read_gltf(path)[0],
    ".gltf": lambda path: read_gltf(path)[0],
    **dict.fromkeys((".usd", ".usda", ".usdc"), lambda path: read_usd(path)[0]),
}
# Readers of files that state the colour space of their Gaussians, the last of what they return.
_STATING = {
    **dict.fromkeys((".glb", ".gltf"), read_gltf),
    **dict.fromkeys((".usd", ".usda", ".usdc"), read_usd),
}
# Arguments of networks that are not supported.
UNKNOWN = ("no_grid", "grid_pe", "static_mlp", "empty_voxel", "apply_rotation")

# Files of a folder that a message names.
_SHOWN = 5
# Largest number of characters of the arguments; models have some two thousand.
_LONGEST = 100_000


def read_model(
    source: Path | str, iteration: int | None = None
) -> tuple[Gaussians, ResidualField | None, Path]:
    """Read a trained model.

    Args:
        source: a PLY (also compressed), SPZ, SOG, .splat, .ksplat, GLB or USD file, the folder or
            meta.json of a SOG scene, or the folder of an iteration or of a model.
        iteration: iteration of a model's folder; None for the latest.

    Returns:
        The undeformed Gaussians, in the model's own colours; their deformation, None for a static
        model; and the PLY file.

    Raises:
        ValueError: the folder is not a model, its network is not supported, or tensors have wrong
            shapes; the message names the file.
        FileNotFoundError: a file is missing.
    """
    reader = READERS.get(Path(source).suffix.lower())
    if reader is not None and not Path(source).is_dir():
        return reader(source), None, Path(source)
    if Path(source).name == META or (Path(source) / META).is_file():
        return read_sog(source), None, Path(source)
    folder = _iteration_folder(Path(source), iteration)
    if folder is None:
        packed = Path(source).is_file() and is_compressed_ply(source)
        read = read_compressed_ply if packed else read_gaussians
        return read(source), None, Path(source)
    ply, network = folder / "point_cloud.ply", folder / "deformation.pth"
    text = folder.parent.parent / "cfg_args"
    if folder.name.startswith("coarse_"):
        return read_gaussians(ply), None, ply
    if not network.is_file():
        if text.is_file() and "kplanes_config" in _arguments(text):
            raise FileNotFoundError(f"{network}: no such file. Copy it from the trained model.")
        return read_gaussians(ply), None, ply
    heads = _heads_in_use(_arguments(text), text)
    rest = read_unconstrained(ply)
    if "harmonics" in heads and rest.harmonics.shape[1] != 16:
        raise ValueError(
            f"{ply}: harmonics must be of degree 3, as their residuals are, got "
            f"{rest.harmonics.shape[1]} coefficients. Copy the file of the same model."
        )
    logit = rest.logit_opacity if "opacity" in heads else None
    return constrain(rest), read_field(network, heads, logit), ply


def stated_color(path: Path | str) -> str | None:
    """The colour space that a model's file states: `srgb` or `linear` of a GLB or USD file; None of
    files that do not say."""
    reader = _STATING.get(Path(path).suffix.lower())
    return reader(path)[1] if reader is not None and Path(path).is_file() else None


def _iteration_folder(source: Path, iteration: int | None) -> Path | None:
    """The folder with the Gaussians; None for a file."""
    clouds = source / "point_cloud"
    if clouds.is_dir():
        iterations = {
            int(m[1]): path
            for path in clouds.iterdir()
            if path.is_dir() and (m := re.fullmatch(r"iteration_(\d+)", path.name))
        }
        if iteration is None and iterations:
            return iterations[max(iterations)]
        if iteration not in iterations:
            available = ", ".join(str(n) for n in sorted(iterations)) or "none"
            raise ValueError(
                f"{source}: iteration must be one of those in {clouds.name}, got "
                f"{iteration} of {available}. To import a coarse stage, give its folder as source."
            )
        return iterations[iteration]
    if iteration is not None:
        raise ValueError(f"iteration must be null unless source is a model's folder, got {source}.")
    if source.is_dir():
        if not (source / "point_cloud.ply").is_file():
            raise FileNotFoundError(_no_model(source))
        return source.resolve()
    return None


def _no_model(source: Path) -> str:
    """What to name instead of a folder that is no model: its files that are, if there are some."""
    endings = (".ply", *READERS)
    files = sorted(x.name for x in source.iterdir() if x.suffix.lower() in endings)
    shown = listed_names(files, most=_SHOWN)
    which = f"a file in it ({shown})" if files else f"a file ({', '.join(endings)})"
    return (
        f"{source}: holds no point_cloud.ply and no {META}. Name {which}, the folder of a trained "
        "model, of one of its iterations, or of a SOG scene."
    )


def _arguments(path: Path) -> dict[str, Any]:
    """The arguments of a text Namespace(name=value, ...) of literals. The text is parsed, not
    executed."""
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file. It says which parts of the network are in use: copy it from "
            "the trained model."
        )
    try:
        text = read_text(path).decode("utf-8-sig").strip()
        if len(text) > _LONGEST:
            raise ValueError(f"{len(text)} characters")
        call = ast.parse(text, mode="eval").body
        if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") == "Namespace"):
            raise ValueError("no Namespace")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"{path}: must be a text Namespace(name=value, ...), got something else ({error}). "
            "Copy it again."
        ) from None
    values = {}
    for keyword in call.keywords:
        try:
            values[keyword.arg] = ast.literal_eval(keyword.value)
        except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
            values[keyword.arg] = None
    return values


def _heads_in_use(arguments: dict[str, Any], path: Path) -> list[str]:
    for name in UNKNOWN:
        if arguments.get(name):
            raise ValueError(
                f"{path}: {name} must be off, got {arguments[name]!r}: such a network is not "
                "understood. Export its frames as PLY files instead."
            )
    for flag in FLAGS.values():
        if not isinstance(arguments.get(flag), bool):
            raise ValueError(
                f"{path}: must hold {flag}=True or {flag}=False, got {arguments.get(flag)!r}. Add "
                "what the model was trained with."
            )
    return [name for name, flag in FLAGS.items() if not arguments[flag]]
