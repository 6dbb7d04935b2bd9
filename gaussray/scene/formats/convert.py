"""Imports models of other programs as scenes, and exports scenes as files of other programs."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.runtime.devices import barrier, is_primary
from gaussray.scene.formats.color_space import (
    check_color,
    color_error_text,
    convert_harmonics,
    with_harmonics,
)
from gaussray.scene.formats.ftgs import is_ftgs, read_ftgs
from gaussray.scene.formats.gaussian_folder import read_model, stated_color
from gaussray.scene.formats.gaussian_ply import write_gaussians
from gaussray.scene.formats.gltf import write_gltf
from gaussray.scene.formats.spz import write_spz
from gaussray.scene.formats.usd import write_usd
from gaussray.scene.gaussians import Gaussians, fold_tint
from gaussray.scene.residual_field import ResidualField
from gaussray.scene.scene import Scene, at, transient_count
from gaussray.scene.segmented import Clip, segment_at
from gaussray.scene.store import save_scene


# Writers of Gaussians at one time, whose colours are in the colour space of the last argument.
WRITERS: dict[str, Callable[[Path | str, Gaussians, str], None]] = {
    "ply": lambda path, gaussians, color: write_gaussians(path, gaussians),
    "spz": lambda path, gaussians, color: write_spz(path, gaussians),
    "spz4": lambda path, gaussians, color: write_spz(path, gaussians, version=4),
    "glb": write_gltf,
    "usd": lambda path, gaussians, color: write_usd(path, [gaussians], color),
}
# Transient Gaussians of smaller opacity are not exported: rasterisers do not show them.
LEAST_OPACITY = 1 / 255


def import_model(
    source: Path | str, out: Path | str, *, color: str = "srgb", iteration: int | None = None
) -> tuple[Scene, str]:
    """Import a trained model of another program, and save it as `out`/scene.npz.

    Args:
        source: a PLY, SPZ, SOG, .splat, .ksplat, GLB or USD file (a static scene), a .ftgs.ply
            file (a moving one), or the folder of a model of 4DGaussians or of one of its iterations
            (`read_model`).
        out: folder of the scene.
        color: colours of the model: `srgb`, values of 8-bit pictures that it was fitted to,
            which are converted to linear light (`convert_harmonics`; at every time if they
            change), or `linear`, taken as they are. GLB and USD files state their colour space, and
            `color` is ignored.
        iteration: iteration of a model's folder; None for the latest.

    Returns:
        The scene, whose time range is 0 to 1, and a text on what was assumed.

    Raises:
        ValueError: `out` already holds a scene, or the source is not a model.
        FileNotFoundError: the source does not exist.
    """
    out = Path(out)
    if (out / "scene.npz").exists():
        raise ValueError(f"out={out} holds a scene already. Choose another folder.")
    stated = stated_color(source)
    color = stated or color
    scene, file, error = model_scene(source, color=color, iteration=iteration)
    # No process shall find what another has just written.
    barrier("import")
    if is_primary():
        info = {"source": file.name, "color": color}
        save_scene(out / "scene.npz", scene, info=info)
    return scene, _import_report(
        file, _motion_text(scene), _color_text(color, error, stated is not None)
    )


def model_scene(
    source: Path | str, *, color: str = "srgb", iteration: int | None = None
) -> tuple[Scene, Path, float]:
    """Read a trained model of another program as a scene.

    Args:
        source: as for `import_model`.
        color: as for `import_model`.
        iteration: as for `import_model`.

    Returns:
        The scene, the file that it was read from, and the error of its colours
        (`convert_harmonics`).
    """
    check_color(color)
    color = stated_color(source) or color
    if iteration is None and is_ftgs(source):
        transients, error = read_ftgs(source), 0.0
        if color == "srgb":
            harmonics, error = convert_harmonics(transients.harmonics, encode=False)
            transients = replace(transients, harmonics=harmonics)
        none = jax.tree.map(lambda x: x[:0], transients.gaussians)
        return Scene(none, none, transient=transients), Path(source), error
    gaussians, field, file = read_model(source, iteration)
    error = 0.0
    if color == "srgb":
        gaussians, field, error = _to_linear(gaussians, field)
    none = jax.tree.map(lambda x: x[:0], gaussians)
    static, moving = (gaussians, none) if field is None else (none, gaussians)
    return Scene(static, moving, field, jnp.asarray([0, 1], jnp.float32)), file, error


def _to_linear(
    gaussians: Gaussians, field: ResidualField | None
) -> tuple[Gaussians, ResidualField | None, float]:
    """The Gaussians in linear light, and the error of their harmonics, at time 0 if they change."""
    if field is None or field.harmonics is None:
        harmonics, error = convert_harmonics(gaussians.harmonics, encode=False)
        return with_harmonics(gaussians, harmonics), field, error
    zero = jnp.zeros((), gaussians.mean.dtype)
    first = jax.jit(lambda field, rest, time: field(rest, time))(field, gaussians, zero)
    _, error = convert_harmonics(first.harmonics, encode=False)
    return gaussians, replace(field, encoded=True), error


def export_model(
    scene: Scene | Clip,
    out: Path | str,
    time: float | None = None,
    *,
    color: str = "srgb",
    degree: int = 3,
    format: str = "ply",
) -> tuple[Gaussians, str]:
    """Export a scene's Gaussians at one time as a file of 3D Gaussian Splatting.

    Tints, which the format does not have, are folded into the harmonics (`fold_tint`, exact), and
    the windows of transient Gaussians into their opacity. Transient Gaussians that are not alive at
    that time are left out.

    Args:
        scene: the scene.
        out: the file.
        time: in the unit of the scene's time range; may be None for a static scene.
        color: `srgb`, which other viewers expect (`convert_harmonics`), or `linear`, as in the
            scene.
        degree: degree of the file's harmonics, at least the scene's; some viewers require 3.
        format: `ply`, `spz` (a tenth of the size, quantised; `spz4` is its version 4), `glb`
            (glTF with KHR_gaussian_splatting, which states the colour space) or `usd` (OpenUSD).

    Returns:
        The Gaussians that were written, and a line about them.

    Raises:
        ValueError: the time is outside of the range, or the degree is too low.
    """
    check_export(format)
    gaussians, colors = gaussians_at(scene, time, color=color, degree=degree)
    if is_primary():
        WRITERS[format](out, gaussians, color)
    return gaussians, f"{gaussians.count} Gaussians, {colors}."


def check_export(format: str) -> None:
    """Raise a ValueError unless there is a writer for the format."""
    if format not in WRITERS:
        raise ValueError(f"format must be one of {', '.join(WRITERS)}, ftgs, got {format!r}.")


def gaussians_at(
    scene: Scene | Clip, time: float | None, *, color: str, degree: int
) -> tuple[Gaussians, str]:
    """The Gaussians of a scene at one time, as files hold them.

    Args:
        scene: the scene.
        time: in the unit of the scene's time range; may be None for a static scene.
        color: as for `export_model`.
        degree: as for `export_model`.

    Returns:
        The Gaussians, and a text about their colours.

    Raises:
        ValueError: the degree is below the scene's, or above 3; there are no Gaussians; or the
            scene moves and has no time.
    """
    check_color(color)
    instant = _export_time(scene, time)
    scene = segment_at(scene, instant)
    gaussians = fold_tint(at(scene, jnp.asarray(instant, scene.time_range.dtype)))
    if transient_count(scene):
        gaussians = _drop_faint(gaussians, scene.static.count + scene.moving.count)
    if not gaussians.count:
        raise ValueError("scene must have Gaussians at this time to be exported, got none.")
    # As the tracer has it: a quaternion of zeros is no rotation.
    none = jnp.all(gaussians.quat == 0, axis=1, keepdims=True)
    quat = jnp.where(none, jnp.eye(4, dtype=gaussians.quat.dtype)[0], gaussians.quat)
    gaussians = dataclasses.replace(gaussians, quat=quat)
    coefficients = gaussians.harmonics.shape[1]
    scene_degree = math.isqrt(coefficients) - 1
    if not scene_degree <= degree <= 3:
        raise ValueError(f"degree must be in {scene_degree} ... 3 for this scene, got {degree}.")
    missing = (degree + 1) ** 2 - coefficients
    harmonics, error = jnp.pad(gaussians.harmonics, ((0, 0), (0, missing), (0, 0))), 0.0
    if color == "srgb":
        harmonics, error = convert_harmonics(harmonics, encode=True)
    space = f"sRGB values, {color_error_text(error)}" if color == "srgb" else "linear light"
    return with_harmonics(gaussians, harmonics), f"colours as {space}"


def _drop_faint(gaussians: Gaussians, persistent: int) -> Gaussians:
    """The Gaussians without the transient ones (all behind the first `persistent`) that are too
    faint to be shown."""
    opacity = np.asarray(gaussians.opacity)
    alive = (np.arange(len(opacity)) < persistent) | (opacity > LEAST_OPACITY)
    return jax.tree.map(lambda x: x[np.flatnonzero(alive)], gaussians)


def _changes(scene: Scene) -> bool:
    moves = scene.deformation is not None or transient_count(scene) > 0
    return moves or scene.light is not None or scene.shading is not None


def _export_time(scene: Scene | Clip, time: float | None) -> float:
    begin, end = (float(x) for x in scene.time_range)
    if time is None:
        if isinstance(scene, Clip) or _changes(scene):
            raise ValueError(
                f"time must be given for a scene that changes, in its range {begin:g} ... {end:g}."
            )
        return begin
    # The range is in single precision: 0.1 must not be outside of 0 ... 0.1.
    if not begin <= np.float32(time) <= end:
        raise ValueError(f"time must be in the scene's range {begin:g} ... {end:g}, got {time:g}.")
    return time


def _color_text(color: str, error: float, stated: bool) -> str:
    """The words on the colours of a model, which its file states or not."""
    light = (
        f"sRGB values, now linear light, {color_error_text(error)}"
        if color == "srgb"
        else "linear light"
    )
    said = "as the file says" if stated else "assumed, as the file does not say"
    return f"{said}: colours are {light}"


def _import_report(file: Path, motion: str, colors: str) -> str:
    return (
        f"{file}: {motion}\n"
        f"{colors}; light is blended linearly; "
        "scene units and world axes are the model's own.\nIts own rasteriser saw harmonics from "
        "the camera's center, added 0.3 square pixels on the screen and left out alpha below "
        "1/255: render.harmonics=center render.dilation=0.3 trace.alpha_min=0.00392 do so too; "
        "by default each ray sees its own colour, and nothing is added."
    )


def _motion_text(scene: Scene) -> str:
    field = scene.deformation
    if transient_count(scene):
        return "transient Gaussians over the times 0 to 1."
    if not isinstance(field, ResidualField):
        return "stands still."
    heads = {
        "place": field.mean,
        "rotation": field.rotation,
        "size": field.scale,
        "opacity": field.opacity,
        "colour": field.harmonics,
    }
    changing = [name for name, head in heads.items() if head is not None]
    text = f"what changes over the times 0 to 1: {', '.join(changing) or 'nothing'}."
    if field.opacity is not None or field.harmonics is not None:
        text += (
            " Opacity and colour are those in the middle of a frame's times; render.chunk_rows=1 "
            "takes them at every row's."
        )
    return text
