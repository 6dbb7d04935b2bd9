"""Sweeps of how a camera makes its rays."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from experiments.extremes.matter import unit
from experiments.extremes.sweep import Sweep, decades
from gaussray.camera import lens as lenses
from gaussray.camera.aperture import (
    Aperture,
    Rim,
    focus_distance_at,
    thin_lens,
    transmitted,
)
from gaussray.camera.focus_pull import FocusPull
from gaussray.camera.shutter import Shutter, sample_time
from gaussray.camera.trajectory import Trajectory, pose_at


FOCAL, CENTER = np.array([100.0, 101.0]), np.array([256.0, 250.0])


def zoo():
    """Name -> lens and its half angle of view."""

    def radial(kind, half, *coefficients, **more):
        k = (np.array(coefficients),) if coefficients else ()
        return kind(*(jnp.asarray(x) for x in (FOCAL, CENTER, *k, half)), **more), half

    focal, center = jnp.asarray(FOCAL), jnp.asarray(CENTER)
    bent = jnp.asarray([-0.2, 0.05, 0.002, -0.001, -0.01, 0, 0, 0])
    prism = 0.05, -0.01, 0.003, -0.002, 0.001, -1e-4, 0.004, -0.003
    theta = jnp.asarray([0.0, 0.9, 0.02, -0.03, 0.004, 0.001])
    limit = lenses.limit_of_angle(theta.tolist(), 1.7, "")
    found = {
        "pinhole, 170 degrees": (lenses.pinhole(focal, center), np.deg2rad(85)),
        "opencv": (lenses.Pinhole(focal, center, bent), 0.7),
        "equidistant, 359 degrees": radial(lenses.Fisheye, np.deg2rad(179.5)),
        "equisolid, 359 degrees": radial(
            lenses.Fisheye, np.deg2rad(179.5), projection="equisolid"
        ),
        "stereographic, 340 degrees": radial(
            lenses.Fisheye, np.deg2rad(170), projection="stereographic"
        ),
        "orthographic, 180 degrees": radial(
            lenses.Fisheye, np.pi / 2, projection="orthographic"
        ),
        "kannala_brandt": radial(lenses.KannalaBrandt, 1.8, 0.02, -0.003, 1e-4, -1e-5),
        "thin_prism_fisheye": radial(lenses.ThinPrismFisheye, 1.6, *prism),
        "unified_sphere": radial(lenses.UnifiedSphere, 1.8, 0.6, 1.0),
        "double_sphere": radial(lenses.DoubleSphere, 1.9, -0.2, 0.6),
        "f_theta": (
            lenses.FTheta(focal, center, theta, jnp.asarray(limit)),
            1.7,
        ),
        "blender_polynomial": (
            lenses.FisheyePolynomial(
                jnp.asarray([0, -0.09, 0, -1e-4, 0]), jnp.asarray([36.0, 36.0]),
                jnp.asarray([512.0, 512.0]), jnp.zeros(2), jnp.asarray(np.pi),
            ),
            np.pi / 2,
        ),
        "equirectangular": (lenses.Equirectangular(focal, center), np.pi),
    }  # fmt: skip
    column, row = jnp.meshgrid(jnp.arange(0, 512, 16) + 8.0, jnp.arange(0, 512, 16) + 8.0)
    wide = found["thin_prism_fisheye"][0]
    rays = jax.vmap(jax.vmap(wide.direction))(jnp.stack([column, row], axis=-1))
    return found | {"table": (lenses.ray_table(rays, 512, 512), 1.4)}


def lens_sweeps():
    """Rays of pixels and pixels of points, from the axis to the rim."""
    shares = np.concatenate(
        [decades(1e-6, 0.1, 1), [0.3, 0.6, 0.9], 1 - decades(1e-6, 1e-2, 1)[::-1]]
    )
    for name, (lens, half) in zoo().items():
        numbers = jax.tree.map(lambda x: np.asarray(x, float), lens)

        def seen(place, dice, lens=numbers, half=half):
            return lens, 3 * _aside(place * half, dice)

        pixel_of = jax.jit(type(lens).project)

        def looked(place, dice, lens=numbers, half=half, pixel_of=pixel_of):
            return lens, np.asarray(pixel_of(lens, jnp.asarray(_aside(place * half, dice))))

        swept = "angle / half the field of view"
        kind = type(lens)
        yield Sweep("lens", f"{name}: direction", swept, shares, looked, kind.direction)
        yield Sweep("lens", f"{name}: project", swept, shares, seen, kind.project)
    distance = decades(1e-30, 1e30, 1)
    for name in ("pinhole, 170 degrees", "equidistant, 359 degrees", "equirectangular"):
        lens, half = zoo()[name]
        numbers = jax.tree.map(lambda x: np.asarray(x, float), lens)

        def away(place, dice, lens=numbers, half=half):
            return lens, place * _aside(0.5 * half, dice)

        yield Sweep("lens", f"{name}: project", "distance", distance, away, type(lens).project)


def _aside(angle, dice):
    """A direction so far from the optical axis."""
    around = dice.uniform(0, 2 * np.pi)
    return np.array([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)])


def _opening(focus, **more):
    def draw(place, dice):
        told = {k: v(place) if callable(v) else v for k, v in more.items()}
        rim = told.pop("rim", None)
        aperture = Aperture(np.ones(()), np.asarray(3.0), np.zeros(()), np.ones(()), focus=focus)
        changed = dataclasses.replace(aperture, **told, rim=rim)
        return changed, _aside(0.9 * dice.uniform(), dice), dice.uniform(0.05, 0.95, 2)

    return draw


def _pulled(place, dice):
    start = 5 + np.arange(3.0)
    pull = FocusPull(place + start, np.array([1.0, 1e3, np.inf]) * 2)
    aperture = Aperture(np.zeros(()), pull, np.zeros(()), np.ones(()))
    return aperture, np.asarray(place + start[0] + dice.uniform(0.1, 0.9))


def _row(place, dice):
    shutter = Shutter(*(np.asarray(x) for x in (-0.5, 1 / 512, 1e-3)))
    return shutter, dice.integers(512, size=2).astype(float), np.asarray(place), dice.uniform()


def _row_time(shutter, pixel, time, u):
    """Time from the frame's own, in readouts of the sensor."""
    return sample_time(shutter, pixel, (512, 512), time, u) - time


def _path(kind):
    def draw(place, dice):
        quat = np.stack([unit(dice, 4) * 0.3 + np.eye(4)[0] for _ in range(5)])
        time = place + np.arange(5.0)
        way = Trajectory(time, quat, dice.normal(size=(5, 3)), interpolation=kind)
        return way, np.asarray(place + 1 + dice.uniform(0.1, 1.9))

    return draw


def camera_sweeps():
    """Apertures, shutters and paths."""
    itself = lambda p: np.asarray(p)  # noqa: E731
    wide = decades(1e-3, 1e9, 1)
    for focus in ("plane", "sphere"):
        draw = _opening(focus, focus_distance=lambda p: np.asarray(3.0 * p))
        yield Sweep("camera", f"thin_lens, {focus}", "focus / radius", wide, draw, thin_lens)
    rim = lambda p: Rim(np.asarray(1.0), np.asarray(0.5))  # noqa: E731
    draw = _opening("plane", radius=itself, rim=rim)
    small = decades(1e-8, 1e2, 1)
    yield Sweep("camera", "transmitted", "radius / that of the rim", small, draw, transmitted)
    late = np.append(0, decades(1, 1e6, 1))
    swept = "time / interval"
    yield Sweep("camera", "focus_at", swept, late, _pulled, focus_distance_at)
    yield Sweep("camera", "sample_time", "time / readout", late, _row, _row_time)
    for kind in ("linear", "spline"):
        yield Sweep("camera", f"pose_at, {kind}", swept, late, _path(kind), pose_at)
