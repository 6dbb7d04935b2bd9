"""The lens that a rig puts in front of a camera, from a few numbers of the user's."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gaussray.camera.film import Film
from gaussray.camera.lens import (
    POLYNOMIALS,
    PROJECTIONS,
    AbstractLens,
    DoubleSphere,
    Equirectangular,
    Fisheye,
    FisheyePolynomial,
    FTheta,
    KannalaBrandt,
    RadialLens,
    RayTable,
    ThinPrismFisheye,
    UnifiedSphere,
    check_lens,
    limit_of,
    pinhole,
    ray_table,
)
from gaussray.capture.ray_map import read_ray_map


class LensOptions(eqx.Module):
    """`model`: keep (the capture's), or a name of MODELS.

    `fov` is the field of view in degrees: across the width for pinhole (before distortion) and
    equirectangular, from rim to rim for all others, whose focal length makes it span the smaller
    side of the picture. `k` are the coefficients of the model, `sensor` the sensor's width and
    height in mm (fisheye_polynomial), `fov_y` the angle from top to bottom in degrees
    (equirectangular), `polynomial` which way f_theta's goes, and `file` the table of directions
    (table).
    """

    model: str = eqx.field(static=True, default="keep")
    fov: float = eqx.field(static=True, default=65.0)
    k: tuple[float, ...] = eqx.field(static=True, default=())
    sensor: tuple[float, float] = eqx.field(static=True, default=(36.0, 36.0))
    fov_y: float = eqx.field(static=True, default=180.0)
    polynomial: str = eqx.field(static=True, default="angle_of_radius")
    file: str = eqx.field(static=True, default="")


def lens_label(options: LensOptions) -> str:
    """Effect that frames through this lens show; none for a plain pinhole."""
    if options.model in ("keep", "pinhole"):
        return "distortion" if any(options.k) and options.model == "pinhole" else ""
    return {"equirectangular": "equirectangular", "table": "ray_table"}.get(
        options.model, "fisheye"
    )


def mounted(film: Film, options: LensOptions) -> AbstractLens:
    """The lens of these options for pictures of this size, its axis in their middle.

    ValueError, with key and rule, for what is no lens.
    """
    if options.model not in MODELS:
        raise ValueError(
            f"lens.model must be keep or one of {', '.join(MODELS)}, got {options.model!r}."
        )
    if not 0 < options.fov <= 360:
        raise ValueError(f"lens.fov must be in (0, 360] degrees, got {options.fov}.")
    lens = MODELS[options.model](film, options)
    check_lens(lens, film.width, film.height)
    return lens


def sees_aside(lens: AbstractLens) -> bool:
    """Whether the lens forms rays at 90 degrees from its axis and beyond."""
    match lens:
        case RadialLens() | ThinPrismFisheye():
            return float(lens.max_angle) >= np.pi / 2
        case FisheyePolynomial():
            return float(lens.fov) >= np.pi
        case RayTable():
            lit = jnp.any(lens.rays != 0, axis=-1)
            return bool(jnp.any(lit & (lens.rays[..., 2] <= 0)))
        case _:
            return isinstance(lens, Equirectangular)


def _size(film):
    return np.array([film.width, film.height], np.float32)


def _half(options, widest=180.0):
    """Half of the field of view in radians."""
    if options.fov > 2 * widest:
        raise ValueError(
            f"lens.fov must be in (0, {2 * widest:g}] for {options.model}, got {options.fov}."
        )
    return np.deg2rad(options.fov) / 2


def _k(options, *counts):
    if len(options.k) not in counts:
        rule = " or ".join(str(count) for count in counts)
        raise ValueError(
            f"lens.k must hold {rule} coefficients for {options.model}, got {len(options.k)}."
        )
    return np.array(options.k, np.float32)


def _spanning(film, kind, half, *more):
    """The radial lens whose rim touches the longer sides of the picture."""
    center, half = jnp.asarray(_size(film) / 2), jnp.asarray(half, jnp.float32)

    def built(focal):
        return kind(jnp.full(2, focal, jnp.float32), center, *more, half)

    return built(float(_size(film).min() / 2 / built(1.0).radius(half)))


def _pinhole(film, options):
    if not options.fov < 180:
        raise ValueError(f"lens.fov must be in (0, 180) for a pinhole, got {options.fov}.")
    k = _k(options, 0, 4, 5, 8, 12, 14)
    k = np.pad(k, (0, max(8 - len(k), 0)))
    focal = _size(film)[0] / 2 / np.tan(_half(options))
    center = jnp.asarray(_size(film) / 2)
    return pinhole(jnp.full(2, focal, jnp.float32), center, jnp.asarray(k) if any(k) else None)


def _polynomial(film, options):
    return FisheyePolynomial(
        jnp.asarray(_k(options, 5)),
        jnp.asarray(options.sensor, jnp.float32),
        jnp.asarray(_size(film)),
        jnp.zeros(2, jnp.float32),
        jnp.asarray(2 * _half(options), jnp.float32),
    )


def _kannala_brandt(film, options):
    return _spanning(film, KannalaBrandt, _half(options), jnp.asarray(_k(options, 4)))


def _projection(film, options):
    _k(options, 0)
    half = _half(options, np.rad2deg(PROJECTIONS[options.model]))

    def kind(focal, center, half):
        return Fisheye(focal, center, half, options.model)

    return _spanning(film, kind, half)


def _f_theta(film, options):
    if options.polynomial not in POLYNOMIALS:
        raise ValueError(
            f"lens.polynomial must be one of {', '.join(POLYNOMIALS)}, got {options.polynomial!r}."
        )
    k = _k(options, *range(2, 8))
    kind = options.polynomial
    limit = jnp.asarray(limit_of(k.tolist(), _half(options), kind), jnp.float32)
    return FTheta(
        focal=jnp.ones(2, jnp.float32),
        center=jnp.asarray(_size(film) / 2),
        coefficients=jnp.asarray(k),
        limit=limit,
        polynomial=kind,
    )  # type: ignore[call-arg]  # max_angle is a property


def _unified(film, options):
    k = np.append(_k(options, 1), 1) if options.model == "unified_sphere" else _k(options, 2)
    return _spanning(film, UnifiedSphere, _half(options), jnp.asarray(k, jnp.float32))


def _double_sphere(film, options):
    return _spanning(film, DoubleSphere, _half(options), jnp.asarray(_k(options, 2)))


def _equirectangular(film, options):
    _k(options, 0)
    if not 0 < options.fov_y <= 180:
        raise ValueError(f"lens.fov_y must be in (0, 180] degrees, got {options.fov_y}.")
    focal = _size(film) * 180 / np.array([options.fov, options.fov_y], np.float32)
    return Equirectangular(jnp.asarray(focal, jnp.float32), jnp.asarray(_size(film) / 2))


def _table(film, options):
    if not options.file:
        raise ValueError("lens.file must name a table of directions (.npz or .exr), got ''.")
    rays = jnp.asarray(read_ray_map(options.file), jnp.float32)
    return ray_table(rays, film.width, film.height)


MODELS: dict[str, Callable[[Film, LensOptions], AbstractLens]] = {
    "pinhole": _pinhole,
    "fisheye_polynomial": _polynomial,
    "kannala_brandt": _kannala_brandt,
    **dict.fromkeys(PROJECTIONS, _projection),
    "f_theta": _f_theta,
    "unified_sphere": _unified,
    "enhanced_unified_sphere": _unified,
    "double_sphere": _double_sphere,
    "equirectangular": _equirectangular,
    "table": _table,
}
