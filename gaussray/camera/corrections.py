"""Corrections of the training cameras, which are learnt together with the scene."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.array import CameraSet
from gaussray.camera.camera import Camera
from gaussray.camera.lens import AbstractLens
from gaussray.camera.lens.correctable import CorrectableLens
from gaussray.camera.mixed_lens import MixedLens
from gaussray.geometry import multiply, product, turning


# The values of fit.refine: the fields of `Corrections`.
REFINABLE = ("pose", "lens", "shutter", "exposure", "color_matrix", "offset")


class Corrections(eqx.Module):
    """Corrections of every training camera: 0 leaves a camera as recorded, None is not refined.

    Args:
        pose: rotation vector about the camera's position, in radians, and translation, in extents;
            both along the world's axes.
        lens: logarithm of a factor of both focal lengths; shift of the principal point, in focal
            lengths; changes of the lens's coefficients that are not zero. Cameras that were
            recorded with equal lenses share their mean: photographs by one camera have one lens,
            and a single picture determines it poorly.
        shutter: logarithm of a factor of row step and row offset, one for all cameras: cameras of
            one kind have one readout, and a single camera determines it poorly.
        exposure: logarithm of exposure times white balance, per channel of linear light.
        color_matrix: difference of a colour matrix from the identity; it acts on linear red, green
            and blue, before the exposure.
        offset: delay of a camera, in intervals between timestamps.
    """

    pose: Float[Array, "*cameras 6"] | None = None
    lens: Float[Array, "*cameras parameters"] | None = None
    shutter: Float[Array, "..."] | None = None
    exposure: Float[Array, "*cameras 3"] | None = None
    color_matrix: Float[Array, "*cameras 3 3"] | None = None
    offset: Float[Array, "*cameras"] | None = None


def no_corrections(refine: Sequence[str], count: int, camera: Camera) -> Corrections | None:
    """Corrections of zero.

    Args:
        refine: what is refined, of `REFINABLE`.
        count: number of cameras.
        camera: the stacked cameras of the frames.

    Returns:
        The corrections; None if nothing is refined.

    Raises:
        ValueError: the readout or the lens cannot be refined.
    """
    if not refine:
        return None
    shutter = camera.shutter
    if "shutter" in refine and not (np.any(shutter.row_step) or shutter.row_times is not None):
        raise ValueError(
            "fit.refine=[shutter] scales the recorded readout, but every shutter.row_step of the "
            "capture is 0. Write an estimate into transforms.json, or leave shutter out."
        )
    lens = 0
    if "lens" in refine:
        lens = 3 + require_correctable(camera.lens).coefficient_values.shape[-1]
    shape = {
        "pose": (count, 6),
        "lens": (count, lens),
        "shutter": (),
        "exposure": (count, 3),
        "color_matrix": (count, 3, 3),
        "offset": (count,),
    }
    return Corrections(**{kind: jnp.zeros(shape[kind], camera.time.dtype) for kind in refine})


def refined_kinds(corrections: Corrections | None) -> tuple[str, ...]:
    """The fields of the corrections that are refined."""
    return tuple(kind for kind in REFINABLE if getattr(corrections, kind, None) is not None)


def require_correctable(lens: AbstractLens, key: str = "fit.refine") -> CorrectableLens:
    """Check that a lens is a `CorrectableLens`, and return it.

    Args:
        lens: the lens of a capture's camera.
        key: the option that asks for corrections of the lens, for the message.

    Raises:
        ValueError: the lens is not correctable.
    """
    if isinstance(lens, MixedLens):
        raise ValueError(
            f"{key}=[lens] must be for cameras of one lens model, got several. Leave lens out."
        )
    if not isinstance(lens, CorrectableLens):
        raise ValueError(
            f"{key}=[lens] must be for lenses with a focal length of their own, got "
            f"{type(lens).__name__}, whose rays are given with its pictures. Leave lens out."
        )
    return lens


def fix_gauge(corrections: Corrections, cameras: CameraSet) -> Corrections:
    """Remove the gauge freedom of the corrections.

    A scene that is moved, turned, scaled, brightened or delayed together with all its cameras gives
    the same pictures. So the similarity transform common to all poses is projected out, and the
    mean of exposures, colour matrices and offsets is subtracted: the mean matrix is the identity.
    Of cameras with equal lenses each gets the mean correction of these.
    Held-out cameras then keep their recorded values. Subtracting the mean over all cameras, rather
    than fixing one camera, averages the errors of the recording.

    Args:
        corrections: the corrections.
        cameras: the set of training cameras.

    Returns:
        The corrections, with a leading axis of cameras.
    """
    pose, shutter = corrections.pose, corrections.shutter
    if pose is not None:
        pose = product("ij,j->i", cameras.pose_projector, pose.reshape(-1)).reshape(pose.shape)
    if shutter is not None:
        shutter = jnp.broadcast_to(shutter, (cameras.count,))

    def centred(values: Array | None) -> Array | None:
        return None if values is None else values - jnp.mean(values, axis=0, keepdims=True)

    return Corrections(
        pose,
        _shared(corrections.lens, cameras.lens),
        shutter,
        centred(corrections.exposure),
        centred(corrections.color_matrix),
        centred(corrections.offset),
    )


def _shared(
    values: Float[Array, "cameras parameters"] | None, lens: Int[Array, " cameras"]
) -> Float[Array, "cameras parameters"] | None:
    """The mean over the cameras with the same lens, for each camera."""
    if values is None:
        return None
    total = jnp.zeros_like(values).at[lens].add(values)
    count = jnp.zeros_like(values[:, :1]).at[lens].add(1)
    return (total / jnp.maximum(count, 1))[lens]


def apply_corrections(camera: Camera, row: Corrections, cameras: CameraSet) -> Camera:
    """Apply corrections to a camera.

    A camera has neither gain nor colour matrix; the caller applies `row.exposure` and
    `row.color_matrix` (`color_response`).

    Args:
        camera: the recorded camera.
        row: its row of the corrections, after `fix_gauge`.
        cameras: the set of training cameras, whose extent and interval scale the corrections.
    """
    trajectory, shutter, lens = camera.trajectory, camera.shutter, camera.lens
    if row.pose is not None:
        turn = turning(row.pose[:3])
        quat = jax.vmap(multiply, in_axes=(None, 0))(turn, trajectory.quat)
        place = trajectory.translation + cameras.extent * row.pose[None, 3:]
        trajectory = dataclasses.replace(trajectory, quat=quat, translation=place)
    if row.lens is not None:
        # Coefficients that the capture leaves out stay zero.
        lens = require_correctable(lens)
        change = jnp.where(lens.coefficient_values != 0, row.lens[3:], 0)
        lens = lens.corrected(jnp.exp(row.lens[0]), row.lens[1:3], change)
    if row.shutter is not None:
        factor = jnp.exp(row.shutter)
        readout = "row_offset", "row_step", "row_times"
        times = {key: getattr(shutter, key) for key in readout}
        scaled = jax.tree.map(lambda x: factor * x, times)
        shutter = dataclasses.replace(shutter, **scaled)
    if row.offset is not None:
        row_offset = shutter.row_offset + cameras.interval * row.offset
        shutter = dataclasses.replace(shutter, row_offset=row_offset)
    return dataclasses.replace(camera, lens=lens, shutter=shutter, trajectory=trajectory)


def refined_views(
    corrections: Corrections | None,
    cameras: CameraSet,
    views: Camera,
    owner: Int[Array, " frames"],
) -> tuple[Camera, Float[Array, "frames 3 ..."] | None]:
    """The stacked cameras of frames with their corrections.

    Args:
        corrections: the corrections; None for none.
        cameras: the set of training cameras.
        views: the recorded cameras of the frames, stacked.
        owner: number of the camera of each frame.

    Returns:
        The corrected cameras, and the `color_response` of each; None if neither exposures nor
        colour matrices are refined.
    """
    if corrections is None:
        return views, None
    rows = jax.tree.map(lambda x: x[owner], fix_gauge(corrections, cameras))
    views = jax.vmap(apply_corrections, in_axes=(0, 0, None))(views, rows, cameras)
    return views, color_response(rows)


def color_response(corrections: Corrections) -> Float[Array, "cameras 3 ..."] | None:
    """The colour response of cameras to linear light, of corrections after `fix_gauge`.

    Returns:
        A gain for each channel, or a matrix (output channel, input channel) where colour matrices
        are refined; None where neither is.
    """
    gain = None if corrections.exposure is None else jnp.exp(corrections.exposure)
    if corrections.color_matrix is None:
        return gain
    matrix = jnp.eye(3, dtype=corrections.color_matrix.dtype)[None] + corrections.color_matrix
    return matrix if gain is None else gain[..., None] * matrix


def apply_color_response(
    gain: Float[Array, "..."], light: Float[Array, "*pixels 3"]
) -> Float[Array, "*pixels 3"]:
    """Linear light as cameras record it.

    Args:
        gain: gains or colour matrices of `color_response`.
        light: linear red, green and blue.
    """
    return gain * light if gain.ndim == light.ndim else product("...ij,...j->...i", gain, light)
