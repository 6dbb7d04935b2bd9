"""The deformation field of 4DGaussians (Wu et al. 2024): residuals of unconstrained values."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from gaussray.scene.deformation import Layer, head_output
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.planes import Planes, features
from gaussray.scene.srgb_harmonics import decode_harmonics


Head = tuple[Layer, Layer]


class ResidualField(eqx.Module):
    """A deformation field: features of position and time become residuals of the Gaussians.

    Times run from 0 to 1; before and after nothing moves.

    Args:
        planes: feature planes over space and time.
        trunk: hidden layers of the network.
        mean: head of the translation; a head that is None adds nothing.
        rotation: head of the quaternion.
        scale: head of the log scale.
        opacity: head of the logit of opacity.
        harmonics: head of the harmonics.
        logit_opacity: logits of the undeformed opacities, which an opacity near 1 does not
            determine; None without the head `opacity`.
        encoded: whether harmonics and their residuals are those of sRGB values, whose sum is
            converted to linear light at every time (`srgb_harmonics.decode_harmonics`).
    """

    planes: Planes
    trunk: tuple[Layer, ...]
    mean: Head | None
    rotation: Head | None
    scale: Head | None
    opacity: Head | None
    harmonics: Head | None
    logit_opacity: Float[Array, " gaussians"] | None
    encoded: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if (self.opacity is None) != (self.logit_opacity is None):
            raise ValueError("a residual of opacity and logit_opacity must be given both, or none.")
        if self.encoded and self.harmonics is None:
            raise ValueError("harmonics without a residual must be decoded once, not be encoded.")

    @property
    def instants(self) -> Float[Array, " instants"]:
        """The times of the rows of the time planes, between which features are linear."""
        planes = self.planes
        return jnp.linspace(planes.begin, planes.end, max(len(x[0]) for x in planes.time))

    def __call__(
        self, gaussians: Gaussians, time: Float[Array, ""], *, held: bool = False
    ) -> Gaussians:
        """The Gaussians at a time, of the undeformed ones. No fit changes such a field, so `held`
        has no effect (`scene.deformation.deform`).
        """
        del held
        hidden = features(self.planes, gaussians.mean, jnp.clip(time, 0, 1))
        for i, layer in enumerate(self.trunk):
            hidden = layer(jax.nn.relu(hidden) if i else hidden)

        def moved(rest: Array, head: Head | None) -> Array:
            return rest if head is None else rest + head_output(head, hidden).reshape(rest.shape)

        scale, opacity = gaussians.scale, gaussians.opacity
        if self.scale is not None:
            scale = scale * jnp.exp(head_output(self.scale, hidden))
        if self.logit_opacity is not None:
            opacity = jax.nn.sigmoid(moved(self.logit_opacity, self.opacity))
        harmonics = moved(gaussians.harmonics, self.harmonics)
        return Gaussians(
            mean=moved(gaussians.mean, self.mean),
            quat=moved(gaussians.quat, self.rotation),
            scale=scale,
            opacity=opacity,
            harmonics=decode_harmonics(harmonics) if self.encoded else harmonics,
        )
