"""The learning rate of every kind of parameter, and how it falls."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from gaussray.camera.corrections import REFINABLE, Corrections, refined_kinds
from gaussray.reconstruct.optimize.optimizer import Parameters
from gaussray.reconstruct.optimize.rows import Kind
from gaussray.scene.deformation import Deformation
from gaussray.scene.gaussians import Unconstrained
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
    degree_interval: int = 0,
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
        degree_interval: harmonics of degree n have rate 0 for the first n x this steps.
    """
    fall = jnp.asarray(options.decay**share)

    def color_rates(
        free: Unconstrained | UnconstrainedTransients,
    ) -> Float[Array, "1 coefficients 1"]:
        degree = np.floor(np.sqrt(np.arange(free.harmonics.shape[1])))[None, :, None]
        # The constant harmonic is the colour; the others learn more slowly.
        color = jnp.where(degree == 0, options.color, options.harmonics)
        return jnp.where(degree * degree_interval <= step, color, 0)

    def gaussians(kind: str, free: Kind, fall: Array) -> Kind:
        return _gaussian_rates(
            free, fall, options=options, scale=scale, kind=kind, color=color_rates(free)
        )

    still = jnp.full_like(fall, options.decay) if formed else fall
    static = gaussians("static", parameters.static, still)
    moving = gaussians("moving", parameters.moving, fall)
    transient = None
    if parameters.transient is not None:
        transient = gaussians("transient", parameters.transient, fall)
    deformation = None
    if parameters.deformation is not None:
        deformation = _deformation_rates(parameters.deformation, fall, options, scale)
    corrections = _correction_rates(parameters.corrections, options, share, refine)
    # It was measured.
    shading = jax.tree.map(lambda _: jnp.zeros_like(fall), parameters.shading)
    return Parameters(static, moving, deformation, corrections, transient, shading)


def _gaussian_rates(
    free: Kind,
    fall: Float[Array, ""],
    *,
    options: OptimizerOptions,
    scale: CaptureScale,
    kind: str,
    color: Float[Array, "1 coefficients 1"],
) -> Kind:
    """The rates of Gaussians of one kind; `color`: those of their harmonics at the start."""
    transient = isinstance(free, UnconstrainedTransients)
    own = options.transient * fall if transient else fall
    rate = {
        "mean": options.mean * scale.spacing[kind][:, None] * own,
        "quat": options.quat * own,
        "log_scale": options.scale * own,
        "logit_opacity": options.opacity * own,
        "harmonics": color * own,
    }
    if transient:
        rate |= {
            "velocity": options.velocity * scale.extent / scale.interval * fall,
            "instant": options.instant * scale.interval * fall,
            "log_lifetime": options.lifetime * fall,
            "plateau": jnp.zeros_like(fall),
        }
    # Not the constructor: one number stands for a whole array.
    return eqx.tree_at(lambda f: tuple(getattr(f, n) for n in rate), free, tuple(rate.values()))


def _deformation_rates(
    field: Deformation, fall: Float[Array, ""], options: OptimizerOptions, scale: CaptureScale
) -> Deformation:
    """The rates of planes, network, light, bodies and control points."""
    rate = jax.tree.map(lambda _: options.network * fall, field)
    planes = jax.tree.map(lambda _: options.planes * fall, field.planes)
    fixed = (jnp.zeros_like(fall),) * 4
    planes = eqx.tree_at(lambda p: (p.lower, p.upper, p.begin, p.end), planes, fixed)
    rate = eqx.tree_at(lambda d: (d.planes, d.light), rate, (planes, options.light * fall))
    poses: dict[str, tuple[float | Array, float | Array]] = {
        "bodies": (options.path * scale.extent, options.turn)
    }
    if field.control is not None:
        poses["control"] = options.control_path * scale.extent, options.control_turn
        if scale.at_rest is not None:
            path = options.from_rest * scale.at_rest[:, None, None]
            poses["control"] = path, _TURN_SHARE * path / field.control.radius[:, None, None]
    for part, (path, turn) in poses.items():
        rate = eqx.tree_at(
            lambda d, part=part: tuple(getattr(getattr(d, part), n) for n in _POSE_FIELDS),
            rate,
            (*fixed[:3], path * fall, turn * fall),
        )
    if field.mean is not None:
        last = options.mean_head * scale.extent * fall
        rate = eqx.tree_at(lambda d: (d.mean[1].weight, d.mean[1].bias), rate, (last, last))
    return rate


def _correction_rates(
    corrections: Corrections | None,
    options: OptimizerOptions,
    share: float | Float[Array, ""],
    refine: tuple[str, ...],
) -> Corrections | None:
    """The rates of corrections of cameras, largest in the middle of a stage: a scene that is not
    formed yet gives wrong gradients of cameras."""
    refined = refined_kinds(corrections)
    if not refined:
        return corrections
    half = 2 * share
    late = jnp.minimum(half, 1) * options.decay ** jnp.maximum(half - 1, 0)
    kinds = {kind: getattr(options, kind) * late * (kind in refine) for kind in refined}
    return eqx.tree_at(
        lambda c: tuple(getattr(c, kind) for kind in kinds), corrections, tuple(kinds.values())
    )
