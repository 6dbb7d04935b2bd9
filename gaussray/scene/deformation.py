"""How Gaussians move: features of place and time become residuals of mean, rotation and scale."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from gaussray.geometry import multiply, normalize_quaternion, rotation_matrix
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.planes import Planes, features


class FieldOptions(eqx.Module):
    """Size of the deformation field (4D-GRT: planes 128 times 1, 2, 4, 8, width 128).

    `sides` are the resolutions of the spatial planes, one per scale; `instants` the rows of the
    time planes (0 = one per instant of the capture), `channels` the features per scale, `width`
    that of the network's layers.
    """

    sides: tuple[int, ...] = eqx.field(static=True, default=(16, 32))
    instants: int = eqx.field(static=True, default=0)
    channels: int = eqx.field(static=True, default=16)
    width: int = eqx.field(static=True, default=64)

    def __check_init__(self):
        if not self.sides or min(self.sides) < 2:
            raise ValueError(f"field.sides must hold resolutions of at least 2, got {self.sides}.")
        if self.instants < 0 or self.instants == 1:
            raise ValueError(f"field.instants must be 0 or at least 2, got {self.instants}.")
        for name in ("channels", "width"):
            if getattr(self, name) < 1:
                raise ValueError(f"field.{name} must be at least 1, got {getattr(self, name)}.")


class Layer(eqx.Module):
    """An affine map of features: x W + b."""

    weight: Float[Array, "inputs outputs"]
    bias: Float[Array, " outputs"]

    def __call__(self, x: Float[Array, "gaussians inputs"]) -> Float[Array, "gaussians outputs"]:
        return x @ self.weight + self.bias[None]


class Deformation(eqx.Module):
    """Planes, one hidden layer, and a two-layer head per residual (4DGaussians, 4D-GRT).

    `pivot` are centres of bodies: a Gaussian turns about the one nearest to it.
    """

    planes: Planes
    pivot: Float[Array, "bodies 3"]
    trunk: Layer
    mean: tuple[Layer, Layer]
    rotation: tuple[Layer, Layer]
    scale: tuple[Layer, Layer]


def initial_deformation(
    key: PRNGKeyArray, planes: Planes, pivot: Float[Array, "bodies 3"], *, width: int
) -> Deformation:
    """Weights uniform as Xavier's, last layers zero: the identity at every time."""
    keys = iter(jax.random.split(key, 4))
    dtype = planes.lower.dtype

    def layer(inputs: int, outputs: int) -> Layer:
        bound = (6 / (inputs + outputs)) ** 0.5
        weight = jax.random.uniform(next(keys), (inputs, outputs), dtype, -bound, bound)
        return Layer(weight, jnp.zeros(outputs, dtype))

    def head(outputs: int) -> tuple[Layer, Layer]:
        last = Layer(jnp.zeros((width, outputs), dtype), jnp.zeros(outputs, dtype))
        return layer(width, width), last

    trunk = layer(planes.width, width)
    return Deformation(planes, pivot, trunk, head(3), head(4), head(3))


def deform(gaussians: Gaussians, deformation: Deformation, time: Float[Array, ""]) -> Gaussians:
    """The Gaussians at a time.

    The rotation head turns each Gaussian, with quaternion (1, 0, 0, 0) + residual, about its
    nearest pivot; the mean head then moves it; the scale head adds to its log scale. A field that
    is constant over a body thus moves it rigidly (as the SE(3) field of Nerfies): residuals of the
    mean alone would have to grow linearly across every body that turns.
    """
    hidden = deformation.trunk(features(deformation.planes, gaussians.mean, time))

    def residual(head: tuple[Layer, Layer]) -> Array:
        first, last = head
        return last(jax.nn.relu(first(jax.nn.relu(hidden))))

    identity = jnp.zeros(4, gaussians.quat.dtype).at[0].set(1)
    turn = normalize_quaternion(identity[None] + residual(deformation.rotation))
    pivot = _nearest(gaussians.mean, deformation.pivot)
    arm = jnp.einsum("nij,nj->ni", rotation_matrix(turn), gaussians.mean - pivot)
    return Gaussians(
        mean=pivot + arm + residual(deformation.mean),
        quat=multiply(turn, normalize_quaternion(gaussians.quat)),
        scale=gaussians.scale * jnp.exp(residual(deformation.scale)),
        opacity=gaussians.opacity,
        harmonics=gaussians.harmonics,
    )


def _nearest(point: Array, pivot: Array) -> Array:
    difference = jax.lax.stop_gradient(point)[:, None] - pivot[None]
    return pivot[jnp.argmin(jnp.sum(difference * difference, axis=-1), axis=1)]
