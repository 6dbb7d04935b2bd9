"""A plain backdrop in the scene: a shell of Gaussians of its colour around everything."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from gaussray.color import srgb_decode
from gaussray.geometry import even_directions
from gaussray.reconstruct.data.backdrop import BackdropColor
from gaussray.reconstruct.initialize.from_points import on_points
from gaussray.scene.scene import Scene


# A backdrop whose channels are below this is black: where nothing is, a picture is black.
_BLACK = 0.02
# Gaussians of the shell: rays through any place of it keep less than a thousandth of their light.
_COUNT = 300
# Radius of the shell, in distances of the farthest camera or Gaussian from its middle; the share of
# Gaussians that are taken for strays.
_RADIUS, _STRAYS = 5.0, 0.02


def with_backdrop_shell(
    scene: Scene,
    unmet: Bool[np.ndarray, " gaussians"],
    plain: BackdropColor,
    eye: Float[np.ndarray, "cameras 3"],
) -> tuple[Scene, Bool[np.ndarray, " with_shell"]]:
    """A scene with a shell of its backdrop's colour, which no pruning takes away; none of black.

    Args:
        scene: what a fit ended with, before this backdrop.
        unmet: Gaussians that no training ray meets; static ones first.
        plain: sRGB-encoded colour of the backdrop.
        eye: positions of the training cameras, which are inside the shell.

    Returns:
        The scene, and which of its Gaussians must stay.
    """
    if max(plain) < _BLACK:
        return scene, unmet
    middle = eye.mean(axis=0)
    around = np.linalg.norm(np.asarray(scene.static.mean) - middle, axis=1)
    farthest = np.linalg.norm(eye - middle, axis=1).max()
    if len(around):
        farthest = max(farthest, float(np.quantile(around, 1 - _STRAYS)))
    place = (middle + _RADIUS * farthest * even_directions(_COUNT)).astype(np.float32)
    light = np.broadcast_to(srgb_decode(np.array(plain)), place.shape)
    degree = int(np.sqrt(scene.static.harmonics.shape[1])) - 1
    shell = on_points(place, light.astype(np.float32), degree=degree, opacity=0.99)
    static = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), scene.static, shell)
    count = scene.static.count
    stays = np.concatenate([unmet[:count], np.ones(_COUNT, bool), unmet[count:]])
    return replace(scene, static=static), stays
