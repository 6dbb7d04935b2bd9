"""Models of others in, ours out: Gaussians that stand still, as other programs keep them."""

import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.color import srgb_decode, srgb_encode
from gaussray.devices import leads, wait
from gaussray.scene.gaussian_ply import read_gaussians, write_gaussians
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0, basis
from gaussray.scene.scene import Scene, at
from gaussray.scene.store import save_scene


# What a light can be kept as: codes of sRGB, which fits to 8-bit pictures hold, or linear.
COLORS = ("srgb", "linear")
# Rings of directions: with twice as many on each, polynomials of degree 11 are summed exactly.
RINGS = 6
# Gaussians whose colours are converted at a time: bounds the memory.
BLOCK = 1 << 16


def import_model(source: Path | str, out: Path | str, *, color: str = "srgb") -> tuple[Scene, str]:
    """A 3D Gaussian Splatting model (PLY) as a scene that stands still, left in `out`/scene.npz.

    `color` says what the model's colours are: srgb, the codes of the 8-bit pictures that it was
    fitted to, which are converted to linear light (`converted`), or linear, taken as they are. The
    time range is 0 to 1. Returns the scene and what had to be assumed. ValueError if `out` holds a
    scene already, or the file no model (`read_gaussians`).
    """
    _check_color(color)
    out = Path(out)
    if (out / "scene.npz").exists():
        raise ValueError(f"out={out} holds a scene already. Choose another folder.")
    gaussians, error = read_gaussians(source), 0.0
    if color == "srgb":
        harmonics, error = converted(gaussians.harmonics, encode=False)
        gaussians = _with_harmonics(gaussians, harmonics)
    none = jax.tree.map(lambda x: x[:0], gaussians)
    scene = Scene(gaussians, none, None, jnp.asarray([0, 1], jnp.float32))
    # No process shall find what another has just written.
    wait("import")
    if leads():
        info = {"source": Path(source).name, "color": color}
        save_scene(out / "scene.npz", scene, info=info)
    return scene, _assumed(color, error)


def export_model(
    scene: Scene,
    out: Path | str,
    time: float | None = None,
    *,
    color: str = "srgb",
    degree: int = 3,
) -> tuple[Gaussians, str]:
    """A scene's Gaussians at one `time` as a 3D Gaussian Splatting model, the PLY file `out`.

    `time` is in the unit of the scene's time range; None will do where nothing moves. Tints, which
    the layout has no place for, are folded into the harmonics (`folded`, exact). `color` says what
    the file shall hold: srgb, the codes that viewers show as they are (`converted`), or linear,
    ours. `degree` is that of the file's harmonics, at least the scene's; some viewers demand 3.
    Returns what was written and a line about it. ValueError if the time is outside of the range.
    """
    _check_color(color)
    gaussians = folded(at(scene, jnp.asarray(_instant(scene, time), scene.time_range.dtype)))
    coefficients = gaussians.harmonics.shape[1]
    own = math.isqrt(coefficients) - 1
    if not own <= degree <= 3:
        raise ValueError(f"degree must be in {own} ... 3 for this scene, got {degree}.")
    missing = (degree + 1) ** 2 - coefficients
    harmonics, error = jnp.pad(gaussians.harmonics, ((0, 0), (0, missing), (0, 0))), 0.0
    if color == "srgb":
        harmonics, error = converted(harmonics, encode=True)
    gaussians = _with_harmonics(gaussians, harmonics)
    if leads():
        write_gaussians(out, gaussians)
    kept = f"sRGB codes, {_off(error)}" if color == "srgb" else "linear light"
    return gaussians, f"{gaussians.count} Gaussians, colours as {kept}."


def folded(gaussians: Gaussians) -> Gaussians:
    """The same colours without a tint.

    (1/2 + sum c_i Y_i) tint is 1/2 + sum c'_i Y_i with c'_i = tint c_i, and in the constant one
    another (tint - 1) / (2 Y_0); a tint is positive, so the clamp at black stays where it was.
    """
    if gaussians.tint is None:
        return gaussians
    tint = gaussians.tint[:, None, :]
    harmonics = (gaussians.harmonics * tint).at[:, :1].add((tint - 1) * (0.5 / C0))
    parts = gaussians.mean, gaussians.quat, gaussians.scale, gaussians.opacity
    return Gaussians(*parts, harmonics)


def converted(
    harmonics: Float[Array, "gaussians coefficients 3"], *, encode: bool
) -> tuple[Float[Array, "gaussians coefficients 3"], float]:
    """Harmonics of the colours' sRGB codes (`encode`) or of the codes' linear light, and the error.

    The colour max(0, 1/2 + sum c_i Y_i) is taken through the sRGB curve in directions all around
    and projected on the same harmonics: c'_i is the mean over the sphere of 4 pi Y_i (f - 1/2).
    Exact for a colour that is the same from everywhere; the error is the root mean square of what
    the harmonics cannot follow, over directions, channels and Gaussians, in sRGB codes 0 to 1.
    """
    way, weight = _directions()
    count, coefficients, _ = harmonics.shape
    values = np.stack(basis(jnp.asarray(way.T), coefficients), axis=-1).astype(np.float32)
    projection = (4 * np.pi * weight[:, None] * values).astype(np.float32)
    result, square = np.empty(harmonics.shape, np.float32), 0.0
    for begin in range(0, count, BLOCK):
        part = np.asarray(harmonics[begin : begin + BLOCK], np.float32)
        seen = _seen(values, part)
        wanted = srgb_encode(seen) if encode else srgb_decode(seen)
        fitted = np.einsum("dc,dnk->nck", projection, wanted - 0.5, optimize=True)
        result[begin : begin + BLOCK] = fitted
        shown = _seen(values, fitted)
        off = shown - wanted if encode else srgb_encode(shown) - seen
        square += float(np.einsum("d,dnk->", weight, np.square(off, dtype=np.float64)))
    return jnp.asarray(result, harmonics.dtype), math.sqrt(square / max(3 * count, 1))


def _seen(
    values: Float[np.ndarray, "directions coefficients"],
    harmonics: Float[np.ndarray, "gaussians coefficients 3"],
) -> Float[np.ndarray, "directions gaussians 3"]:
    """The colours from all directions."""
    return np.maximum(np.einsum("dc,nck->dnk", values, harmonics, optimize=True) + 0.5, 0)


def _directions() -> tuple[Float[np.ndarray, "directions 3"], Float[np.ndarray, " directions"]]:
    """Directions all around and their shares of the sphere: Gauss-Legendre in z, even rings."""
    z, share = np.polynomial.legendre.leggauss(RINGS)
    angle = np.pi * np.arange(2 * RINGS) / RINGS
    across = np.sqrt(1 - z * z)[:, None]
    x, y = across * np.cos(angle), across * np.sin(angle)
    way = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1).reshape(-1, 3)
    return way, np.repeat(share / 2, 2 * RINGS) / (2 * RINGS)


def _with_harmonics(gaussians: Gaussians, harmonics: Array) -> Gaussians:
    return Gaussians(gaussians.mean, gaussians.quat, gaussians.scale, gaussians.opacity, harmonics)


def _instant(scene: Scene, time: float | None) -> float:
    begin, end = (float(x) for x in scene.time_range)
    if time is None:
        if scene.deformation is not None:
            raise ValueError(
                f"time must be given for a scene that moves, in its range {begin:g} ... {end:g}."
            )
        return begin
    # The range is kept in single precision: 0.1 shall not be outside of 0 ... 0.1.
    if not begin <= np.float32(time) <= end:
        raise ValueError(f"time must be in the scene's range {begin:g} ... {end:g}, got {time:g}.")
    return time


def _check_color(color: str) -> None:
    if color not in COLORS:
        raise ValueError(f"color must be one of {', '.join(COLORS)}, got {color!r}.")


def _off(error: float) -> str:
    return f"off by {255 * error:.2g} of 255 (root mean square) for the degree of the harmonics"


def _assumed(color: str, error: float) -> str:
    light = f"sRGB codes, now linear light, {_off(error)}" if color == "srgb" else "linear light"
    return (
        f"assumed, as the file does not say: colours are {light}; harmonics are seen along each "
        "ray, not from the camera's centre to the Gaussian's; light is blended linearly;\nno "
        "variance of 0.3 square pixels is added on the screen; alpha below trace.alpha_min counts "
        "as nothing; scene units and world axes are the model's own."
    )
