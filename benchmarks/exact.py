"""Exact pictures in some pixels: every Gaussian on every ray, fully sorted, in double precision.

The brute force of `tests/reference.py`; every ray sees the scene deformed for its own time. Rays
themselves are those of the camera in single precision, because they define what is looked at.
"""

import importlib.util
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.camera.camera import Camera, camera_rays
from gaussray.camera.rays import Rays
from gaussray.camera.sampling import sobol_samples
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene, at
from gaussray.tracer.motion import Motion, still


def _reference():
    """tests/reference.py, which is not in a package."""
    path = Path(__file__).resolve().parents[1] / "tests" / "reference.py"
    found = importlib.util.spec_from_file_location("reference", path)
    assert found and found.loader
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


reference = _reference()
# (ray, Gaussian) pairs that may be looked at for one picture.
_PAIRS = {"cpu": 2e7, "gpu": 5e8}


def checked(rays: int, gaussians: int, samples: int = 1, most: int = 256) -> np.ndarray:
    """Random ones of so many pixels, as many as brute force may take (at least four)."""
    pairs = _PAIRS.get(jax.default_backend(), 2e7)
    count = int(np.clip(pairs / gaussians / samples, 4, min(most, rays)))
    return np.random.default_rng(0).choice(rays, count, replace=False)


def color(motion: Motion, rays: Rays, *, alpha_min: float = reference.ALPHA_MIN) -> np.ndarray:
    """What rays see of a scene whose motion is known."""
    with jax.enable_x64(True):
        return np.asarray(_traced(_double(motion), _double(rays), alpha_min))


def picture(
    scene: Scene,
    camera: Camera,
    chosen: np.ndarray,
    *,
    samples: int,
    alpha_min: float = reference.ALPHA_MIN,
) -> np.ndarray:
    """Colours of chosen pixels (row-major numbers), the mean over their samples."""
    width = camera.film.width
    pixel = jnp.asarray(np.stack([chosen % width, chosen // width], axis=-1), jnp.float32)
    rays = _rays(camera, pixel, sobol_samples(samples).astype(jnp.float32))
    moving = bool(np.ptp(np.asarray(rays.time)) > 0) and scene.deformation is not None
    with jax.enable_x64(True):
        scene, rays = _double(scene), _double(rays)
        if moving:
            seen = _deformed(scene, rays, alpha_min)
        else:
            seen = _traced(still(_state(scene, rays.time[0])), rays, alpha_min)
        return np.asarray(seen).reshape(samples, -1, 3).mean(axis=0)


def errors(color: np.ndarray, truth: np.ndarray) -> dict[str, float | int]:
    """Decibels and largest difference, in linear light."""
    difference = np.abs(np.asarray(color, np.float64) - truth)
    return {
        "psnr_vs_exact": psnr(color, truth),
        "max_error": float(difference.max()),
        "checked": len(truth),
    }


def psnr(color: np.ndarray, truth: np.ndarray) -> float:
    """Decibels below 1."""
    return float(-10 * np.log10(max(np.mean((color - truth) ** 2), 1e-15)))


def _double(tree):
    def cast(x):
        return (
            jnp.asarray(np.asarray(x), jnp.float64) if jnp.issubdtype(x.dtype, jnp.floating) else x
        )

    return jax.tree.map(cast, tree)


@jax.jit
def _rays(camera: Camera, pixel, u) -> Rays:
    def sample(one):
        return camera_rays(camera, pixel, jnp.broadcast_to(one, (pixel.shape[0], 5)))

    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), jax.vmap(sample)(u))


_state = jax.jit(at)


def _traced(motion: Motion, rays: Rays, alpha_min):
    # What no ray meets counts for nothing: it need not be sorted. The number is rounded up, that
    # few programs have to be compiled.
    some = np.asarray(_met(motion, rays, alpha_min))
    count = -(-max(int(some.sum()), 1) // 1024) * 1024
    chosen = np.argsort(~some, kind="stable")[:count]
    g = motion.gaussians
    keyed = (None if x is None else x[:, chosen] for x in (g.mean, g.quat, g.scale, g.tint))
    mean, quat, scale, tint = keyed
    few = Gaussians(mean, quat, scale, g.opacity[chosen], g.harmonics[chosen], tint)
    return _dense(Motion(motion.time, few), rays, alpha_min)


_met = jax.jit(reference.met)


@jax.jit
def _dense(motion: Motion, rays: Rays, alpha_min):
    return reference.dense(motion, rays, alpha_min)[0]


@jax.jit
def _deformed(scene: Scene, rays: Rays, alpha_min):
    def one(ray: Rays):
        alone = jax.tree.map(lambda x: x[None], ray)
        return reference.dense(still(at(scene, ray.time)), alone, alpha_min)[0][0]

    return jax.lax.map(one, rays)
