"""The aperture of a rig's cameras, from options."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.aperture import Aperture, Rim, no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.focus_pull import FocusPull
from gaussray.io.plain_values import to_device


class ApertureOptions(eqx.Module):
    """Aperture and focus of the cameras.

    Args:
        radius: in scene units; 0 is a pinhole, None the capture's own aperture.
        focus_distance: in scene units.
        focus: "plane" or "sphere".
        blades: number of blades; 0 is round.
        rotation: rotation of the blades, in radians.
        ratio: anamorphic ratio, which divides the horizontal radius.
        focus_times: times of a focus pull, in the capture's unit (`FocusPull`).
        focus_distances: focus distance at each of these times, in scene units.
        focus_ease: interpolation of the focus pull: "linear" or "smooth".
        rim_radius: radius of a second rim that clips oblique rays, in scene units (optical
            vignetting, `Rim`).
        rim_distance: distance of that rim from the aperture; both 0 is no rim.
    """

    radius: float | None = eqx.field(static=True, default=None)
    focus_distance: float = eqx.field(static=True, default=2.5)
    focus: str = eqx.field(static=True, default="plane")
    blades: int = eqx.field(static=True, default=0)
    rotation: float = eqx.field(static=True, default=0.0)
    ratio: float = eqx.field(static=True, default=1.0)
    focus_times: tuple[float, ...] = eqx.field(static=True, default=())
    focus_distances: tuple[float, ...] = eqx.field(static=True, default=())
    focus_ease: str = eqx.field(static=True, default="linear")
    rim_radius: float = eqx.field(static=True, default=0.0)
    rim_distance: float = eqx.field(static=True, default=0.0)


def build_aperture(camera: Camera, options: ApertureOptions) -> Aperture:
    """Build an aperture.

    Args:
        camera: the camera, whose own aperture stays if `options.radius` is None.
        options: the options.

    Raises:
        ValueError: A value breaks its rule.
    """
    if options.radius is None:
        return camera.aperture
    if options.radius == 0:
        return jax.tree.map(_float32, no_aperture())
    radius, rotation, ratio = map(_float32, (options.radius, options.rotation, options.ratio))
    return Aperture(
        radius,
        _focus(options),
        rotation,
        ratio,
        blades=options.blades,
        focus=options.focus,
        rim=_rim(options),
    )


def _focus(options: ApertureOptions) -> Float[Array, ""] | FocusPull:
    times, distances = options.focus_times, options.focus_distances
    if len(times) != len(distances):
        raise ValueError(
            "aperture.focus_distances must be as many as aperture.focus_times, got "
            f"{len(distances)} and {len(times)}."
        )
    if not times:
        return _float32(options.focus_distance)
    return FocusPull(_float32(times), _float32(distances), options.focus_ease)


def _rim(options: ApertureOptions) -> Rim | None:
    if options.rim_radius == 0 and options.rim_distance == 0:
        return None
    for key in ("rim_radius", "rim_distance"):
        if not 0 < getattr(options, key) < np.inf:
            raise ValueError(
                f"aperture.{key} must be above 0, got {getattr(options, key)}. Both 0 is no rim."
            )
    return Rim(_float32(options.rim_radius), _float32(options.rim_distance))


def _float32(value) -> Array:
    return to_device(value, jnp.float32)
