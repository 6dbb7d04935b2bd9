"""The learning rate of every kind of parameter, and how it falls."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.corrections import REFINABLE, refined_kinds
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import Kind
from gaussray.scene.transient import UnconstrainedTransients


# A smaller rate of means would move nothing: it was meant in other units.
_LEAST_PIXELS = 0.002
# Rotations of control points that began at rest move what is one width away by this share of the
# rate of their paths.
_TURN_SHARE = 0.25
_POSE_FIELDS = ("pivot", "radius", "time", "path", "turn")


class OptimizerOptions(eqx.Module):
    """Learning rates of Adam at the start of a stage.

    They fall exponentially to a share `decay` at the end of the stage. Means learn in pixels of the
    camera that sees them most finely, however large things and pictures are; rates of other lengths
    are multiplied by the scene's extent. Rates of cameras apply to what fit.refine names; they rise
    from 0 to the middle of the stage and fall after it.

    Args:
        mean: means of Gaussians, in pixels (3DGS: 1.6e-4 extents, for 30,000 steps).
        quat: rotations of Gaussians (3DGS: 1e-3).
        scale: logarithms of scales (3DGS: 5e-3).
        opacity: logits of opacities (3DGS: 0.05).
        color: the constant harmonic (3DGS: 2.5e-3).
        harmonics: all other harmonics (3DGS: 1.25e-4).
        transient: factor of all these rates for transient Gaussians, of which a step sees few:
            those of the times of its pictures.
        velocity: velocities of transient Gaussians, in extents per interval between two pictures
            (FreeTimeGS: 1.6e-3 per clip).
        instant: instants of transient Gaussians, in intervals.
        lifetime: logarithms of lifetimes of transient Gaussians.
        path: paths of rigid bodies, in extents.
        turn: rotations of rigid bodies, as quaternions.
        control_path: paths of control points that were tracked, in extents.
        control_turn: rotations of control points that were tracked, as quaternions.
        from_rest: paths of control points that began at rest, in pixels; their rotations learn so
            fast that what is one width away moves by a quarter of that.
        light: light on surfaces by the direction of their normals.
        planes: feature planes of the deformation (4DGaussians: 1.6e-3).
        network: network of the deformation (4DGaussians: 1.6e-4).
        mean_head: the last layer of the network's head for means, in extents.
        pose: poses of cameras, in radians and extents.
        lens: logarithms of focal lengths, and principal points in focal lengths.
        shutter: logarithm of the readout time.
        exposure: logarithms of the gains of the colour channels.
        color_matrix: entries of the colour matrices of cameras.
        offset: delays of cameras, in intervals between two times.
        decay: share of every rate that is left at the end of a stage.

    Raises:
        ValueError: a rate is negative, `mean` is too small for pixels, or `decay` is not in (0, 1].
    """

    mean: float = eqx.field(static=True, default=0.25)
    quat: float = eqx.field(static=True, default=1e-2)
    scale: float = eqx.field(static=True, default=2e-2)
    opacity: float = eqx.field(static=True, default=0.05)
    color: float = eqx.field(static=True, default=2e-2)
    harmonics: float = eqx.field(static=True, default=5e-4)
    transient: float = eqx.field(static=True, default=1.0)
    velocity: float = eqx.field(static=True, default=5e-4)
    instant: float = eqx.field(static=True, default=1e-2)
    lifetime: float = eqx.field(static=True, default=2e-2)
    path: float = eqx.field(static=True, default=6e-3)
    turn: float = eqx.field(static=True, default=3e-2)
    control_path: float = eqx.field(static=True, default=2e-4)
    control_turn: float = eqx.field(static=True, default=1e-3)
    from_rest: float = eqx.field(static=True, default=0.4)
    light: float = eqx.field(static=True, default=2e-2)
    planes: float = eqx.field(static=True, default=1e-2)
    network: float = eqx.field(static=True, default=1e-3)
    mean_head: float = eqx.field(static=True, default=2.5e-4)
    pose: float = eqx.field(static=True, default=3e-4)
    lens: float = eqx.field(static=True, default=3e-4)
    shutter: float = eqx.field(static=True, default=3e-2)
    exposure: float = eqx.field(static=True, default=5e-3)
    color_matrix: float = eqx.field(static=True, default=2e-3)
    offset: float = eqx.field(static=True, default=2e-2)
    decay: float = eqx.field(static=True, default=0.03)

    def __check_init__(self):
        for name in (
            *("mean", "quat", "scale", "opacity", "color", "harmonics"),
            *("transient", "velocity", "instant", "lifetime"),
            *("path", "turn", "control_path", "control_turn", "from_rest"),
            *("light", "planes", "network", "mean_head"),
            *REFINABLE,
        ):
            if getattr(self, name) < 0:
                raise ValueError(f"optimizer.{name} must be at least 0, got {getattr(self, name)}.")
        if 0 < self.mean < _LEAST_PIXELS:
            raise ValueError(
                f"optimizer.mean must be 0 or at least {_LEAST_PIXELS}, got {self.mean}. It is in "
                "pixels; earlier versions and 3DGS count in extents of the cameras."
            )
        if not 0 < self.decay <= 1:
            raise ValueError(f"optimizer.decay must be in (0, 1], got {self.decay}.")


class CaptureScale(NamedTuple):
    """Units in which Gaussians learn: the distance of neighbouring pixels at each of them, by kind
    (`pixel_spacing`), the extent of the cameras, the time from one frame to the next, and the
    distance of neighbouring pixels at each control point, if these began at rest."""

    spacing: Mapping[str, Float[Array, " gaussians"]]
    extent: float | Float[Array, ""]
    interval: float | Float[Array, ""] = 1.0
    at_rest: Float[Array, " points"] | None = None


def rates(
    parameters: Parameters,
    step: Int[Array, ""],
    *,
    options: OptimizerOptions,
    scale: CaptureScale,
    share: float | Float[Array, ""],
    refine: tuple[str, ...] = (),
    formed: bool = False,
    rise: int = 0,
) -> Parameters:
    """The learning rate of every array at a step, as a tree of the parameters' structure.

    Args:
        parameters: what is learnt.
        step: steps of the stage before this one.
        options: the rates at the start of the stage.
        scale: the units of lengths and times.
        share: share of the stage that is done, in [0, 1], with which the rates fall.
        refine: corrections of cameras that are learnt; others have rate 0.
        formed: whether static Gaussians were fitted in an earlier segment; they learn at the rate
            with which its stage ended.
        rise: harmonics of degree n have rate 0 for the first n x `rise` steps.
    """
    spacing, extent, interval, at_rest = scale
    fall = jnp.asarray(options.decay**share)

    def gaussians(kind: str, free: Kind, fall: Array) -> Kind:
        brief = isinstance(free, UnconstrainedTransients)
        own = options.transient * fall if brief else fall
        # The constant harmonic is the colour; the others learn more slowly.
        degree = np.floor(np.sqrt(np.arange(free.harmonics.shape[1])))[None, :, None]
        color = jnp.where(degree == 0, options.color, options.harmonics) * own
        color = jnp.where(degree * rise <= step, color, 0)
        rate = {
            "mean": options.mean * spacing[kind][:, None] * own,
            "quat": options.quat * own,
            "log_scale": options.scale * own,
            "logit_opacity": options.opacity * own,
            "harmonics": color,
        }
        if brief:
            rate |= {
                "velocity": options.velocity * extent / interval * fall,
                "instant": options.instant * interval * fall,
                "log_lifetime": options.lifetime * fall,
                "plateau": jnp.zeros_like(fall),
            }
        # Not the constructor: one number stands for a whole array.
        return eqx.tree_at(lambda f: tuple(getattr(f, n) for n in rate), free, tuple(rate.values()))

    deformation = None
    if parameters.deformation is not None:
        deformation = jax.tree.map(lambda _: options.network * fall, parameters.deformation)
        planes = jax.tree.map(lambda _: options.planes * fall, parameters.deformation.planes)
        fixed = (jnp.zeros_like(fall),) * 4
        planes = eqx.tree_at(lambda p: (p.lower, p.upper, p.begin, p.end), planes, fixed)
        deformation = eqx.tree_at(
            lambda d: (d.planes, d.light), deformation, (planes, options.light * fall)
        )
        poses: dict[str, tuple[float | Array, float | Array]] = {
            "bodies": (options.path * extent, options.turn)
        }
        control = parameters.deformation.control
        if control is not None:
            poses["control"] = options.control_path * extent, options.control_turn
        if control is not None and at_rest is not None:
            path = options.from_rest * at_rest[:, None, None]
            poses["control"] = path, _TURN_SHARE * path / control.radius[:, None, None]
        for part, (path, turn) in poses.items():
            deformation = eqx.tree_at(
                lambda d, part=part: tuple(getattr(getattr(d, part), n) for n in _POSE_FIELDS),
                deformation,
                (*fixed[:3], path * fall, turn * fall),
            )
        if parameters.deformation.mean is not None:
            motion = options.mean_head * extent * fall
            deformation = eqx.tree_at(
                lambda d: (d.mean[1].weight, d.mean[1].bias), deformation, (motion, motion)
            )
    still = jnp.full_like(fall, options.decay) if formed else fall
    static = gaussians("static", parameters.static, still)
    moving = gaussians("moving", parameters.moving, fall)
    transient = None
    if parameters.transient is not None:
        transient = gaussians("transient", parameters.transient, fall)
    corrections, refined = parameters.corrections, refined_kinds(parameters.corrections)
    if refined:
        # A scene that is not formed yet gives wrong gradients of cameras.
        half = 2 * share
        late = jnp.minimum(half, 1) * options.decay ** jnp.maximum(half - 1, 0)
        kinds = {kind: getattr(options, kind) * late * (kind in refine) for kind in refined}
        corrections = eqx.tree_at(
            lambda c: tuple(getattr(c, kind) for kind in kinds), corrections, tuple(kinds.values())
        )
    shading = parameters.shading
    if shading is not None:
        none = jnp.zeros_like(fall)
        # It was measured.
        shading = jax.tree.map(lambda _: none, shading)
    return Parameters(static, moving, deformation, corrections, transient, shading)
