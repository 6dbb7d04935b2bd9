"""Lenses whose parameters refinement and calibration may correct."""

import abc
import dataclasses
from collections.abc import Sequence
from typing import ClassVar

from jaxtyping import Array, Float

from gaussray.camera.lens.abstract import AbstractLens, FocalLens


class CorrectableLens(AbstractLens):
    """A lens whose focal length, principal point and coefficients may be wrong in a capture.

    `fit.refine=[lens]` and `calibrate.parameters=[focal,lens]` correct all of them through
    `corrected`. Lenses without such parameters (a panorama, a table) are no subclass.
    """

    # Units in which calibration reports the focal length and the principal point.
    focal_unit: ClassVar[str] = "px"
    center_unit: ClassVar[str] = "px"
    # Index of a coefficient that the focal length determines; None if there is none.
    linear_coefficient: ClassVar[int | None] = None

    @property
    @abc.abstractmethod
    def coefficient_values(self) -> Float[Array, "*cameras coefficients"]:
        """The coefficients that may be corrected; leading axes are those of stacked lenses."""

    @property
    @abc.abstractmethod
    def coefficient_names(self) -> tuple[str, ...]:
        """A name for each coefficient, as `calibrate.coefficients` spells it."""

    @property
    @abc.abstractmethod
    def focal_length(self) -> Float[Array, ""]:
        """The focal length that calibration reports."""

    @property
    @abc.abstractmethod
    def principal_point(self) -> Float[Array, "2"]:
        """The principal point that calibration reports."""

    @property
    def possible_coefficients(self) -> tuple[str, ...]:
        """Names of all coefficients that a lens of this type can have."""
        return self.coefficient_names

    def with_named_coefficients(self, names: Sequence[str]) -> "CorrectableLens":
        """The same lens with these coefficients, of `possible_coefficients`; new ones are zero."""
        return self

    @abc.abstractmethod
    def corrected(
        self,
        scale: Float[Array, ""],
        shift: Float[Array, "2"],
        change: Float[Array, " coefficients"],
    ) -> "CorrectableLens":
        """The lens with corrections of order 1 where they are of the size of the picture.

        Args:
            scale: factor of both focal lengths.
            shift: shift of the principal point, in focal lengths on the axis.
            change: what is added to the coefficients.
        """


class ParametricLens(FocalLens, CorrectableLens):
    """A `FocalLens` with the field `coefficients` of order 1, named k1, k2, ...

    A subclass with other names, no coefficients or other units redefines the properties below.
    """

    @property
    def coefficient_values(self) -> Float[Array, "*cameras coefficients"]:
        return getattr(self, "coefficients", self.center[..., :0])

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        return tuple(f"k{i + 1}" for i in range(self.coefficient_values.shape[-1]))

    @property
    def focal_length(self) -> Float[Array, ""]:
        return self.focal[0]

    @property
    def principal_point(self) -> Float[Array, "2"]:
        return self.center

    def axis_slope(self) -> Float[Array, ""] | float:
        """Distance on the image by angle on the axis, in focal lengths a radian."""
        return 1.0

    def coefficient_units(self) -> Float[Array, " coefficients"] | float:
        """What a correction of 1 adds to each coefficient."""
        return 1.0

    def with_coefficients(self, values: Float[Array, " coefficients"]) -> "ParametricLens":
        """The lens with other values of its coefficients."""
        return dataclasses.replace(self, **{"coefficients": values})

    def corrected(
        self,
        scale: Float[Array, ""],
        shift: Float[Array, "2"],
        change: Float[Array, " coefficients"],
    ) -> "CorrectableLens":
        paraxial = self.focal * self.axis_slope()
        focal, center = scale * self.focal, self.center + paraxial * shift
        lens = dataclasses.replace(self, focal=focal, center=center)
        values = self.coefficient_values
        if not values.shape[0]:
            return lens
        return lens.with_coefficients(values + change * self.coefficient_units())
