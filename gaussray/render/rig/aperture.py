"""The aperture of a rig's cameras, from options."""

import dataclasses
import functools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.camera.aperture import Aperture, Rim, no_aperture
from gaussray.camera.camera import Camera
from gaussray.camera.focus_pull import FocusPull
from gaussray.io.plain_values import to_device


AUTO = "auto"
# Lengths that may be shares of the focus distance.
_SHARES = ("radius", "rim_radius", "rim_distance")


class ApertureOptions(eqx.Module):
    """Aperture and focus of the cameras.

    Scenes have any unit. Lengths may therefore be shares, such as "3.6%" (`resolve_aperture`).

    Args:
        radius: in scene units, or a share of the focus distance; 0 is a pinhole, None the capture's
            own aperture.
        focus_distance: in scene units; "auto" is the distance of what the middle of the first
            picture shows, and "150%" is 1.5 times that.
        focus: "plane" or "sphere".
        blades: number of blades; 0 is round.
        rotation: rotation of the blades, in radians.
        ratio: anamorphic ratio, which divides the horizontal radius.
        focus_times: times of a focus pull, in the capture's unit (`FocusPull`).
        focus_distances: focus distance at each of these times, in scene units.
        focus_ease: interpolation of the focus pull: "linear" or "smooth".
        rim_radius: radius of a second rim that clips oblique rays (optical vignetting, `Rim`), in
            scene units or a share of the focus distance.
        rim_distance: distance of that rim from the aperture, likewise; both 0 is no rim.

    Raises:
        ValueError: A text is no share, the radius is below 0, or the focus distance not above it.
    """

    radius: float | str | None = eqx.field(static=True, default=None)
    focus_distance: float | str = eqx.field(static=True, default=AUTO)
    focus: str = eqx.field(static=True, default="plane")
    blades: int = eqx.field(static=True, default=0)
    rotation: float = eqx.field(static=True, default=0.0)
    ratio: float = eqx.field(static=True, default=1.0)
    focus_times: tuple[float, ...] = eqx.field(static=True, default=())
    focus_distances: tuple[float, ...] = eqx.field(static=True, default=())
    focus_ease: str = eqx.field(static=True, default="linear")
    rim_radius: float | str = eqx.field(static=True, default=0.0)
    rim_distance: float | str = eqx.field(static=True, default=0.0)

    def __check_init__(self):
        for name in _SHARES:
            _check_length(name, getattr(self, name), "a share of the focus distance such as 3.6%")
        radius, focus = self.radius, self.focus_distance
        if isinstance(radius, int | float) and not radius >= 0:
            raise ValueError(f"aperture.radius must be at least 0, got {radius}.")
        _check_length("focus_distance", focus, "auto, or a share of that such as 150%")
        if not isinstance(focus, str) and not focus > 0:
            raise ValueError(f"aperture.focus_distance must be above 0, got {focus}.")

    @property
    def has_shares(self) -> bool:
        """Whether an open aperture has lengths that `resolve_aperture` must turn to numbers."""
        lengths = [getattr(self, name) for name in _SHARES]
        lengths += [] if self.focus_times else [self.focus_distance]
        return bool(self.radius) and any(isinstance(length, str) for length in lengths)


def resolve_aperture(options: ApertureOptions, measure: Callable[[], float]) -> ApertureOptions:
    """The options with all lengths in scene units, of three digits where they were shares.

    Shares are of the focus distance; of a focus pull, of the nearest one. Of a focus at infinity
    they are shares of the distance that "auto" stands for.

    Args:
        options: the options. A pinhole, or the capture's own aperture, stays as it is.
        measure: measures the distance that "auto" stands for; called only if it is needed.
    """
    if not options.has_shares:
        return options
    subject, focus = functools.cache(measure), options.focus_distance
    if options.focus_times:
        focus = min(options.focus_distances, default=math.inf)
    elif isinstance(focus, str):
        focus = _rounded(_factor(focus) * subject())
    reference = focus if math.isfinite(focus) else _rounded(subject())
    lengths = {name: getattr(options, name) for name in _SHARES}
    shares = {name: value for name, value in lengths.items() if isinstance(value, str)}
    numbers = {name: _rounded(_factor(value) * reference) for name, value in shares.items()}
    return dataclasses.replace(options, focus_distance=focus, **numbers)


def _check_length(name: str, value: float | str | None, rule: str) -> None:
    """Check a length that is a text: a share in percent, or the focus `auto`."""
    if not isinstance(value, str) or (name == "focus_distance" and value == AUTO):
        return
    try:
        is_share = value.endswith("%") and 0 < float(value[:-1]) < math.inf
    except ValueError:
        is_share = False
    if not is_share:
        raise ValueError(f"aperture.{name} must be a number or {rule}, got {value!r}.")


def _factor(share: str) -> float:
    return 1.0 if share == AUTO else float(share[:-1]) / 100


def _rounded(length: float) -> float:
    """To three significant digits, so that the number that is told gives the same picture."""
    return float(f"{length:.3g}")


def build_aperture(camera: Camera, options: ApertureOptions) -> Aperture:
    """Build an aperture.

    Args:
        camera: the camera, whose own aperture stays if `options.radius` is None.
        options: the options, without shares (`resolve_aperture`).

    Raises:
        ValueError: A value breaks its rule.
    """
    if options.has_shares:
        raise ValueError(
            f"aperture.radius = {options.radius} and aperture.focus_distance = "
            f"{options.focus_distance} must be numbers where no picture is measured."
        )
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
