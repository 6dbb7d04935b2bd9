"""Exports a scene with its motion as transient Gaussians, a `.ftgs.ply` file."""

import dataclasses
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.runtime.devices import is_primary
from gaussray.scene.formats.color_space import check_color, convert_harmonics
from gaussray.scene.formats.ftgs import write_ftgs
from gaussray.scene.gaussians import Gaussians, fold_tint
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.scene.transient import Transients


# The area under a window of standard deviation 1.
_AREA = math.sqrt(2 * math.pi)


def export_transients(scene: Scene | Clip, out: Path | str, *, color: str, degree: int) -> str:
    """Write the static and transient Gaussians of a scene, with all of their motion.

    Times become 0 to 1 over the scene's time range. What stands still has no velocity and a window
    that is longer than the sequence. A window with a plateau, for which the format has no place,
    becomes the Gaussian of the same area: its deviation grows by 2 plateau / sqrt(2 pi).

    Args:
        scene: the scene.
        out: the file, `.ply`; programs expect `.ftgs.ply`.
        color: `srgb` or `linear`, as for `export_model`.
        degree: degree of the harmonics, at least the scene's.

    Returns:
        A line about what was written.

    Raises:
        ValueError: Gaussians move by a deformation, or the degree is too low.
        OSError: The file cannot be written.
    """
    check_color(color)
    if isinstance(scene, Clip) or scene.moving.count:
        raise ValueError(
            "format=ftgs holds static and transient Gaussians only, and this scene moves by a "
            "deformation. Export a sequence with count=N, or reconstruct with fit.motion=transient."
        )
    begin, end = (float(x) for x in scene.time_range)
    span = (end - begin) or 1.0
    parts = [_static_transients(fold_tint(scene.static))]
    approximated = 0
    if scene.transient is not None:
        parts.append(_to_file_time(scene.transient, begin, span))
        approximated = int(np.count_nonzero(np.asarray(scene.transient.plateau)))
    most = max(part.harmonics.shape[1] for part in parts)
    if not math.isqrt(most) - 1 <= degree <= 3:
        raise ValueError(f"degree must be in {math.isqrt(most) - 1} ... 3 for this scene.")
    parts = [_pad_harmonics(part, (degree + 1) ** 2) for part in parts]
    whole = jax.tree.map(lambda *x: jnp.concatenate(x), *parts)
    if color == "srgb":
        harmonics, _ = convert_harmonics(whole.harmonics, encode=True)
        whole = dataclasses.replace(whole, harmonics=harmonics)
    if is_primary():
        write_ftgs(out, whole)
    words = f"{whole.count} Gaussians, {parts[0].count} of which stand still"
    notes = [f"{approximated} plateaus became Gaussian windows"] if approximated else []
    notes += ["the change of light over time is left out"] if scene.light is not None else []
    notes += ["shadows that pass are left out"] if scene.shading is not None else []
    return "; ".join([words, *notes]) + "."


def _static_transients(gaussians: Gaussians) -> Transients:
    """Gaussians that stand still, as transient ones in the middle of the sequence."""
    count, like = gaussians.count, gaussians.mean.dtype
    return Transients(
        mean=gaussians.mean,
        velocity=jnp.zeros((count, 3), like),
        quat=gaussians.quat,
        scale=gaussians.scale,
        opacity=gaussians.opacity,
        harmonics=gaussians.harmonics,
        instant=jnp.full(count, 0.5, like),
        lifetime=jnp.full(count, jnp.inf, like),
        plateau=jnp.zeros(count, like),
    )


def _to_file_time(transients: Transients, begin: float, span: float) -> Transients:
    """The Gaussians in the time of the file, without plateaus."""
    wider = transients.lifetime + 2 * transients.plateau / _AREA
    return dataclasses.replace(
        transients,
        velocity=transients.velocity * span,
        instant=(transients.instant - begin) / span,
        lifetime=wider / span,
        plateau=jnp.zeros_like(transients.plateau),
    )


def _pad_harmonics(transients: Transients, coefficients: int) -> Transients:
    missing = coefficients - transients.harmonics.shape[1]
    harmonics = jnp.pad(transients.harmonics, ((0, 0), (0, missing), (0, 0)))
    return dataclasses.replace(transients, harmonics=harmonics)
