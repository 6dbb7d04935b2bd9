"""Corrections of recorded training cameras, which a reconstruction learns along with the scene."""

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
from gaussray.camera.shutter import Shutter
from gaussray.geometry import multiply, product, turning


# What fit.refine can name: the fields of `Corrections`.
REFINABLE = ("pose", "lens", "shutter", "exposure", "offset")


class Corrections(eqx.Module):
    """Corrections of every training camera: all zero is the cameras as recorded, None is not
    refined.

    `pose` is a rotation vector about the camera's own place and a shift, along the world's axes, in
    radians and extents. `lens` is the logarithm of a factor of both focal lengths, a shift of the
    principal point in focal lengths (those on the axis), and what is added to the lens's
    coefficients (those that are not zero). `shutter` is the logarithm of a factor of row step and
    row offset: a single one, for cameras of one make read alike, and what one of them sees says
    little. `exposure` is the logarithm of exposure times white balance, by channel of linear light.
    `offset` is how much later than recorded a camera looks, in intervals between the capture's
    instants.
    """

    pose: Float[Array, "*cameras 6"] | None = None
    lens: Float[Array, "*cameras parameters"] | None = None
    shutter: Float[Array, "..."] | None = None
    exposure: Float[Array, "*cameras 3"] | None = None
    offset: Float[Array, "*cameras"] | None = None


def no_corrections(refine: Sequence[str], count: int, camera: Camera) -> Corrections | None:
    """Zeros for what is refined of so many cameras like these; None if nothing is."""
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
        lens = 3 + correctable(camera.lens).coefficient_values.shape[-1]
    shape = {
        "pose": (count, 6),
        "lens": (count, lens),
        "shutter": (),
        "exposure": (count, 3),
        "offset": (count,),
    }
    return Corrections(**{kind: jnp.zeros(shape[kind], camera.time.dtype) for kind in refine})


def refined_kinds(corrections: Corrections | None) -> tuple[str, ...]:
    """What of `REFINABLE` the corrections hold."""
    return tuple(kind for kind in REFINABLE if getattr(corrections, kind, None) is not None)


def correctable(lens: AbstractLens, key: str = "fit.refine") -> CorrectableLens:
    """The lens, if its parameters may be corrected; `key` names the option that asks for it.

    Raises:
        ValueError: If the lens is no `CorrectableLens`.
    """
    if not isinstance(lens, CorrectableLens):
        raise ValueError(
            f"{key}=[lens] must be for lenses with a focal length of their own, got "
            f"{type(lens).__name__}, whose rays are given with its pictures. Leave lens out."
        )
    return lens


def gauge_fixed(corrections: Corrections, cameras: CameraSet) -> Corrections:
    """The corrections with the gauge freedom removed, a row for every camera.

    A scene that is moved, turned, scaled, brightened or delayed together with all its cameras gives
    the same pictures. So the similarity common to all poses is projected out, and the mean of
    exposures and offsets is subtracted. Held-out cameras then keep their recorded values. The mean
    over all cameras is subtracted, rather than fixing one camera, because it averages the errors of
    the recording.
    """
    pose, shutter, exposure, offset = (
        corrections.pose,
        corrections.shutter,
        corrections.exposure,
        corrections.offset,
    )
    if pose is not None:
        pose = product("ij,j->i", cameras.free, pose.reshape(-1)).reshape(pose.shape)
    if shutter is not None:
        shutter = jnp.broadcast_to(shutter, (cameras.count,))
    if exposure is not None:
        exposure = exposure - jnp.mean(exposure, axis=0, keepdims=True)
    if offset is not None:
        offset = offset - jnp.mean(offset)
    return Corrections(pose, corrections.lens, shutter, exposure, offset)


def refined(camera: Camera, own: Corrections, cameras: CameraSet) -> Camera:
    """One camera with its row of the `gauge_fixed` corrections.

    Its exposure is no part of the camera and is left to the caller.
    """
    trajectory, shutter, lens = camera.trajectory, camera.shutter, camera.lens
    if own.pose is not None:
        turn = turning(own.pose[:3])
        quat = jax.vmap(multiply, in_axes=(None, 0))(turn, trajectory.quat)
        place = trajectory.translation + cameras.extent * own.pose[None, 3:]
        trajectory = dataclasses.replace(trajectory, quat=quat, translation=place)
    if own.lens is not None:
        # Coefficients that the capture leaves out stay zero.
        lens = correctable(lens)
        change = jnp.where(lens.coefficient_values != 0, own.lens[3:], 0)
        lens = lens.corrected(jnp.exp(own.lens[0]), own.lens[1:3], change)
    if own.shutter is not None:
        factor = jnp.exp(own.shutter)
        readout = "row_offset", "row_step", "row_times"
        told = {key: getattr(shutter, key) for key in readout}
        scaled = jax.tree.map(lambda x: factor * x, told)
        shutter = dataclasses.replace(shutter, **scaled)
    if own.offset is not None:
        late = shutter.row_offset + cameras.interval * own.offset
        shutter = dataclasses.replace(shutter, row_offset=late)
    return dataclasses.replace(camera, lens=lens, shutter=shutter, trajectory=trajectory)


def refined_views(
    corrections: Corrections | None,
    cameras: CameraSet,
    views: Camera,
    owner: Int[Array, " frames"],
) -> tuple[Camera, Float[Array, "frames 3"] | None]:
    """Stacked views as they are refined, and what their linear light is multiplied by, None if
    exposures are not; `owner` is the number of each view's camera."""
    if corrections is None:
        return views, None
    own = jax.tree.map(lambda x: x[owner], gauge_fixed(corrections, cameras))
    views = jax.vmap(refined, in_axes=(0, 0, None))(views, own, cameras)
    return views, None if own.exposure is None else jnp.exp(own.exposure)


_refined = jax.jit(refined)


def refined_frames(
    corrections: Corrections | None,
    cameras: CameraSet,
    names: Sequence[str],
    frames: Sequence[tuple[str, Camera]],
) -> list[Camera]:
    """The cameras of frames, each with the name of its camera: those in `names`, the set's, as
    they are refined, all others as they are."""
    if corrections is None:
        return [camera for _, camera in frames]
    rows = gauge_fixed(corrections, cameras)
    own = {name: jax.tree.map(lambda x, i=i: x[i], rows) for i, name in enumerate(names)}
    return [
        _refined(camera, own[name], cameras) if name in own else camera for name, camera in frames
    ]


def gains(
    corrections: Corrections | None, cameras: CameraSet, names: Sequence[str]
) -> dict[str, list[float]]:
    """Red, green and blue of every camera over the scene's, in linear light; empty if exposures are
    not refined."""
    exposure = None if corrections is None else gauge_fixed(corrections, cameras).exposure
    if exposure is None:
        return {}
    gain = np.exp(np.asarray(exposure, np.float64)).round(6)
    return dict(zip(names, gain.tolist(), strict=True))


def corrections_summary(
    corrections: Corrections, cameras: CameraSet, shutter: Shutter, unit: str
) -> str:
    """One line that sums up the corrections, for the log.

    `shutter` is that of the training frames, stacked, and `unit` the capture's unit of time.
    """
    c, said = jax.tree.map(np.asarray, gauge_fixed(corrections, cameras)), []
    if c.pose is not None:
        turn, shift = (np.linalg.norm(x, axis=1).max() for x in (c.pose[:, :3], c.pose[:, 3:]))
        way = float(cameras.extent) * shift
        said.append(f"poses turned by up to {np.degrees(turn):.3g} degrees, moved by {way:.3g}")
    if c.lens is not None:
        factor = np.exp(c.lens[:, 0])
        said.append(f"focal lengths x {factor.min():.4f} to {factor.max():.4f}")
    if c.shutter is not None:
        step = np.asarray(shutter.row_step, np.float64)
        step = step[np.argmax(np.abs(step))]
        factor = np.exp(c.shutter[0])
        even = f"time of a row {step:.4g} -> {step * factor:.4g} ({unit})"
        said.append(even if shutter.row_times is None else f"times of rows x {factor:.4f}")
    if c.exposure is not None:
        gain = np.exp(c.exposure)
        said.append(f"exposures x {gain.min():.3f} to {gain.max():.3f}")
    if c.offset is not None:
        late = float(cameras.interval) * c.offset
        said.append(f"offsets {late.min():.4g} to {late.max():.4g} ({unit})")
    return f"refined cameras: {'; '.join(said)}"
