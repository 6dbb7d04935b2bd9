"""One of several lenses, so that cameras with different ones can be stacked."""

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from gaussray.camera.lens import AbstractLens
from gaussray.camera.lens.abstract import LensRecord
from gaussray.io.validate import require


class MixedLens(AbstractLens):
    """The lens `chosen` of several lenses. Every camera computes all of them.

    Args:
        lenses: lenses of any kinds; cameras that are stacked have the same kinds in the same order.
        chosen: which of them this one is.
    """

    lenses: tuple[AbstractLens, ...]
    chosen: Int[Array, ""]

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        return jnp.stack([lens.direction(pixel) for lens in self.lenses])[self.chosen]

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        return jnp.stack([lens.project(point) for lens in self.lenses])[self.chosen]

    def check(self) -> None:
        rule = f"the number of one of the {len(self.lenses)} lenses"
        require("lens.chosen", self.chosen, lambda x: (x >= 0) & (x < len(self.lenses)), rule)

    def resized(
        self, whole: tuple[int, int], box: Sequence[float], size: tuple[int, int]
    ) -> "MixedLens":
        resized = tuple(lens.resized(whole, box, size) for lens in self.lenses)
        return MixedLens(resized, self.chosen)

    def record(self) -> LensRecord:
        return self._own.record()

    @property
    def sees_sideways(self) -> bool:
        return self._own.sees_sideways

    @property
    def _own(self) -> AbstractLens:
        return self.lenses[int(self.chosen)]
