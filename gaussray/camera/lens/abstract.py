"""The interface of all lenses: maps between pixels and viewing directions, and their bookkeeping.

Camera axes are +x right, +y down, +z forward. Pixels are (column, row), pixel centres at +0.5.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import readable, to_device
from gaussray.io.validate import known, require


class LensRecord(NamedTuple):
    """A lens as a manifest holds it.

    Args:
        keys: keys of a frame, from which `LensModel.from_keys` builds the same lens bit by bit.
        tables: the arrays that the keys name, by file name.
    """

    keys: dict[str, Any]
    tables: dict[str, np.ndarray] = {}


class AbstractLens(eqx.Module):
    """A map between pixels and viewing directions, each the inverse of the other.

    Differentiable in its parameters, in pixels and in points. A subclass lives in a file of its own
    in `camera/lens/`, together with its `LensModel`s (`model.py`).
    """

    # What `check_lens` names, and the remedy, where two pixels share a direction.
    fold_message: ClassVar[tuple[str, str]] = (
        "lens.k",
        "Use weaker coefficients or a smaller picture.",
    )
    # Whether every pixel of the picture must have a direction; other lenses may leave pixels black.
    fills_picture: ClassVar[bool] = False

    @abc.abstractmethod
    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit viewing direction of a pixel; zero where the lens forms no ray."""

    @abc.abstractmethod
    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        """Pixel of a point in camera axes, at any distance; NaN where it is not imaged."""

    @abc.abstractmethod
    def check(self) -> None:
        """Raise a ValueError that names the invalid parameter."""

    @abc.abstractmethod
    def resized(
        self, whole: tuple[int, int], box: Sequence[float], size: tuple[int, int]
    ) -> "AbstractLens":
        """The lens of a part of the picture at another resolution.

        Args:
            whole: width and height of the picture of this lens.
            box: the part that is shown: left, top, width and height in pixels of that picture; it
                may go beyond the edges.
            size: width and height of the new picture, onto which the part is scaled.
        """

    @abc.abstractmethod
    def record(self) -> LensRecord:
        """The lens as a manifest holds it; its arrays are on the host."""

    @property
    @abc.abstractmethod
    def sees_sideways(self) -> bool:
        """Whether the lens forms rays at 90 degrees from its axis or more, so that focus on a plane
        in front of the camera is undefined."""

    @property
    def check_is_complete(self) -> bool:
        """Whether `check` alone shows that all pixels of any picture have different directions."""
        return False

    def __check_init__(self):
        if known(*jax.tree.leaves(self)):
            # Also where a lens of known numbers is built inside `jit`.
            with jax.ensure_compile_time_eval():
                self.check()

    def __repr__(self) -> str:
        return readable(self)

    def sees(self, pixel: Float[Array, "2"]) -> Bool[Array, ""]:
        """Whether the lens forms a ray for this pixel."""
        return jnp.any(self.direction(pixel) != 0)

    def _replaced(self, **fields: np.ndarray) -> "AbstractLens":
        """The lens with these fields, in its own precision."""
        dtype = jnp.result_type(*jax.tree.leaves(self))
        return dataclasses.replace(self, **{k: to_device(x, dtype) for k, x in fields.items()})


class FocalLens(AbstractLens):
    """A lens of the form pixel = center + focal * image, with an image point of its own meaning.

    Cropping and resizing the picture changes `focal` and `center` alone.
    """

    focal: eqx.AbstractVar[Float[Array, "2"]]
    center: eqx.AbstractVar[Float[Array, "2"]]

    @abc.abstractmethod
    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        """Unit viewing direction of an image point; zero where the lens forms no ray."""

    @abc.abstractmethod
    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        """Image point of a point in camera axes (finite in any case), and whether it is imaged."""

    @abc.abstractmethod
    def check_image(self) -> None:
        """`check` of all parameters but `focal` and `center`."""

    def direction(self, pixel: Float[Array, "2"]) -> Float[Array, "3"]:
        return self.ray((pixel - self.center) / self.focal)

    def project(self, point: Float[Array, "3"]) -> Float[Array, "2"]:
        xy, imaged = self.image(point)
        return jnp.where(imaged, self.center + self.focal * xy, jnp.nan)

    def check(self) -> None:
        require("lens.focal", self.focal, lambda f: np.isfinite(f) & (f > 0), "above 0")
        require("lens.center", self.center, np.isfinite, "finite")
        self.check_image()

    def resized(
        self, whole: tuple[int, int], box: Sequence[float], size: tuple[int, int]
    ) -> "AbstractLens":
        scale = np.array(size) / np.array(box[2:])
        return self._replaced(
            focal=np.asarray(self.focal, np.float64) * scale,
            center=(np.asarray(self.center, np.float64) - np.array(box[:2])) * scale,
        )

    def intrinsics(self) -> dict[str, float]:
        """`focal` and `center` as the keys of a frame."""
        (fl_x, fl_y), (cx, cy) = json_numbers(self.focal), json_numbers(self.center)
        return {"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy}
