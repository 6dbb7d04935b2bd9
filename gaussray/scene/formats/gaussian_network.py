"""Reads the deformation network of a model of 4DGaussians (Wu et al. 2024), `deformation.pth`.

All names begin with deformation_net. The planes grid.grids.<scale>.<0..5> (xy xz xt yz yt zt) have
the shape [1, channels, second axis, first axis]. They are sampled with aligned corners and repeated
borders at (p - max) 2 / (min - max) - 1, where max and min are the rows of grid.aabb; hence every
spatial axis is flipped. The time axis is sampled at the time itself, so that times 0 to 1 use only
the upper half of the rows. feature_out.0, .2, ... are the layers of the trunk, <head>.1 and
<head>.3 those of a head, with a ReLU between layers.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.scene.deformation import Layer
from gaussray.scene.formats.pth import read_tensors
from gaussray.scene.planes import Planes
from gaussray.scene.residual_field import Head, ResidualField


# Name and number of outputs of each head.
NETWORK_HEADS = {
    "mean": ("pos_deform", 3),
    "rotation": ("rotations_deform", 4),
    "scale": ("scales_deform", 3),
    "opacity": ("opacity_deform", 1),
    "harmonics": ("shs_deform", 48),
}


def read_field(
    path: Path, heads: list[str], logit_opacity: Float[Array, " gaussians"] | None
) -> ResidualField:
    """Read a deformation network.

    Args:
        path: the file.
        heads: names of the heads that are in use, of `NETWORK_HEADS`.
        logit_opacity: of the undeformed Gaussians; None without the head opacity.

    Raises:
        ValueError: a tensor is missing, has a wrong shape or is not finite; the message names file
            and tensor.
    """
    return _Network(path).field(heads, logit_opacity)


class _Network:
    """The tensors of the file, each checked when it is used."""

    def __init__(self, path: Path):
        self.path = path
        self.tensors = read_tensors(path)

    def field(self, heads: list[str], logit_opacity: Array | None) -> ResidualField:
        planes = self._planes()
        trunk = [self._layer("feature_out.0", planes.width, None)]
        width = trunk[0].bias.shape[0]
        while f"deformation_net.feature_out.{2 * len(trunk)}.weight" in self.tensors:
            trunk.append(self._layer(f"feature_out.{2 * len(trunk)}", width, width))

        def head(name: str) -> Head | None:
            if name not in heads:
                return None
            layers, outputs = NETWORK_HEADS[name]
            first = self._layer(f"{layers}.1", width, width)
            return first, self._layer(f"{layers}.3", width, outputs)

        return ResidualField(
            planes, tuple(trunk), *map(head, NETWORK_HEADS), logit_opacity=logit_opacity
        )

    def _planes(self) -> Planes:
        upper, lower = self._tensor("grid.aabb", 2, 3)
        if not (lower < upper).all():
            raise ValueError(
                f"{self.path}: 'deformation_net.grid.aabb' must hold the largest corner first, got "
                f"{upper} and {lower}. Copy the file again."
            )
        space, time, scale = [], [], 0
        while f"deformation_net.grid.grids.{scale}.0" in self.tensors or not scale:
            grids = [self._grid(scale, pair) for pair in range(6)]
            space.append(self._stack(scale, [grids[i][::-1, ::-1] for i in (0, 1, 3)]))
            time.append(self._stack(scale, [grids[i][:, ::-1] for i in (2, 4, 5)]))
            scale += 1
        rows = {x.shape[1] for x in time}
        if len(rows) > 1:
            raise ValueError(
                f"{self.path}: the time planes must have as many rows at every scale, got "
                f"{sorted(rows)}. Such a network is not understood."
            )
        # Rows are at times -1 ... 1; the lower half is never sampled.
        last = rows.pop() - 1
        first = last // 2
        return Planes(
            space=tuple(jnp.asarray(x) for x in space),
            time=tuple(jnp.asarray(x[:, first:]) for x in time),
            lower=jnp.asarray(lower),
            upper=jnp.asarray(upper),
            begin=jnp.asarray(2 * first / last - 1, jnp.float32),
            end=jnp.ones((), jnp.float32),
        )

    def _grid(self, scale: int, pair: int) -> np.ndarray:
        """A plane, indexed [second axis, first axis, channel]."""
        grid = self._tensor(f"grid.grids.{scale}.{pair}", 1, None, None, None)[0]
        if min(grid.shape[1:]) < 2:
            raise self._shape_error(
                f"grid.grids.{scale}.{pair}", "at least 2 x 2", (1, *grid.shape)
            )
        return np.moveaxis(grid, 0, -1)

    def _stack(self, scale: int, grids: list[np.ndarray]) -> np.ndarray:
        shapes = {grid.shape for grid in grids}
        if len(shapes) > 1:
            raise ValueError(
                f"{self.path}: the planes of scale {scale} must be equally fine along x, y and z, "
                f"got {sorted(shapes)}. Such a network is not understood."
            )
        return np.stack(grids)

    def _layer(self, name: str, inputs: int, outputs: int | None) -> Layer:
        weight = self._tensor(f"{name}.weight", outputs, inputs)
        bias = self._tensor(f"{name}.bias", weight.shape[0])
        return Layer(jnp.asarray(weight.T), jnp.asarray(bias))

    def _tensor(self, name: str, *shape: int | None) -> np.ndarray:
        """A tensor of this shape (None: any length) in single precision."""
        full = f"deformation_net.{name}"
        if full not in self.tensors:
            raise ValueError(
                f"{self.path}: the tensor '{full}' is missing. A model of 4DGaussians has it: copy "
                "the file again."
            )
        tensor = self.tensors[full]
        fits = len(tensor.shape) == len(shape) and all(
            wanted in (None, got) for wanted, got in zip(shape, tensor.shape, strict=True)
        )
        if not fits or 0 in tensor.shape:
            wanted = " x ".join("any" if n is None else str(n) for n in shape)
            raise self._shape_error(name, wanted, tensor.shape)
        if not np.isfinite(tensor).all():
            raise ValueError(f"{self.path}: '{full}' must be finite, got NaN or infinity.")
        return tensor.astype(np.float32)

    def _shape_error(self, name: str, wanted: str, got: tuple[int, ...]) -> ValueError:
        return ValueError(
            f"{self.path}: the tensor 'deformation_net.{name}' must be {wanted}, got "
            f"{' x '.join(str(n) for n in got)}. Such a network is not understood."
        )
