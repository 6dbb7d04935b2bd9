"""Training cameras after a fit: as corrected, their gains, and a summary of the corrections."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from gaussray.camera.array import CameraSet, lens_key
from gaussray.camera.camera import Camera
from gaussray.camera.corrections import Corrections, apply_corrections, fix_gauge
from gaussray.camera.shutter import Shutter


_apply_corrections = jax.jit(apply_corrections)


def refined_frames(
    corrections: Corrections | None,
    cameras: CameraSet,
    names: Sequence[str],
    frames: Sequence[tuple[str, Camera]],
) -> list[Camera]:
    """The cameras of frames with their corrections.

    Args:
        corrections: the corrections; None for none.
        cameras: the set of training cameras.
        names: names of the cameras of the set, in the order of the corrections.
        frames: name of the camera, and recorded camera, of each frame. Of cameras that are not in
            `names` only what they share with others is corrected: the readout, and equal lenses.
    """
    if corrections is None:
        return [camera for _, camera in frames]
    table = fix_gauge(corrections, cameras)
    rows = {name: jax.tree.map(lambda x, i=i: x[i], table) for i, name in enumerate(names)}
    lenses, shutter = {}, None if table.shutter is None else table.shutter[0]
    if table.lens is not None:
        lenses = {lens_key(own.lens): rows[name].lens for name, own in frames if name in rows}

    def corrected(name: str, camera: Camera) -> Camera:
        lens = lenses.get(lens_key(camera.lens)) if lenses and name not in rows else None
        if name not in rows and lens is None and shutter is None:
            return camera
        row = rows.get(name, Corrections(lens=lens, shutter=shutter))
        return _apply_corrections(camera, row, cameras)

    return [corrected(name, camera) for name, camera in frames]


def gains(
    corrections: Corrections | None, cameras: CameraSet, names: Sequence[str]
) -> dict[str, list[float]]:
    """Gains of red, green and blue in linear light.

    Args:
        corrections: the corrections; None for none.
        cameras: the set of training cameras.
        names: names of the cameras, in the order of the corrections.

    Returns:
        The gains by camera name; empty if exposures are not refined.
    """
    exposure = None if corrections is None else fix_gauge(corrections, cameras).exposure
    return _by_name(names, None if exposure is None else np.exp(np.asarray(exposure, np.float64)))


def color_matrices(
    corrections: Corrections | None, cameras: CameraSet, names: Sequence[str]
) -> dict[str, list[list[float]]]:
    """Matrices of linear red, green and blue, rows are output channels.

    Args:
        corrections: the corrections; None for none.
        cameras: the set of training cameras.
        names: names of the cameras, in the order of the corrections.

    Returns:
        The matrices by camera name; empty if they are not refined.
    """
    matrix = None if corrections is None else fix_gauge(corrections, cameras).color_matrix
    return _by_name(names, None if matrix is None else np.eye(3) + np.asarray(matrix, np.float64))


def _by_name(names: Sequence[str], values: Float[np.ndarray, "cameras ..."] | None) -> dict:
    """Rounded values by camera name; empty if there are none."""
    return {} if values is None else dict(zip(names, values.round(6).tolist(), strict=True))


def corrections_summary(
    corrections: Corrections, cameras: CameraSet, shutter: Shutter, unit: str
) -> str:
    """One line that sums up the corrections, for the log.

    Args:
        corrections: the corrections.
        cameras: the set of training cameras.
        shutter: the stacked shutters of the training frames.
        unit: the capture's unit of time.
    """
    c, parts = jax.tree.map(np.asarray, fix_gauge(corrections, cameras)), []
    if c.pose is not None:
        turn, shift = (np.linalg.norm(x, axis=1).max() for x in (c.pose[:, :3], c.pose[:, 3:]))
        distance = float(cameras.extent) * shift
        angle = np.degrees(turn)
        parts.append(f"poses turned by up to {angle:.3g} degrees, moved by {distance:.3g}")
    if c.lens is not None:
        factor = np.exp(c.lens[:, 0])
        several = f" to {factor.max():.4f}" if factor.max() - factor.min() > 5e-5 else ""
        parts.append(f"focal lengths x {factor.min():.4f}{several}")
    if c.shutter is not None:
        step = np.asarray(shutter.row_step, np.float64)
        step = step[np.argmax(np.abs(step))]
        factor = np.exp(c.shutter[0])
        even = f"time of a row {step:.4g} -> {step * factor:.4g} ({unit})"
        parts.append(even if shutter.row_times is None else f"times of rows x {factor:.4f}")
    if c.exposure is not None:
        gain = np.exp(c.exposure)
        parts.append(f"exposures x {gain.min():.3f} to {gain.max():.3f}")
    if c.color_matrix is not None:
        parts.append(
            f"colour matrices off the identity by up to {np.abs(c.color_matrix).max():.3f}"
        )
    if c.offset is not None:
        delay = float(cameras.interval) * c.offset
        parts.append(f"offsets {delay.min():.4g} to {delay.max():.4g} ({unit})")
    return f"refined cameras: {'; '.join(parts)}"
