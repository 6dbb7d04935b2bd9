"""Options of rendering: how a picture is sampled, and what a dataset stores of every frame."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx

from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.io.plain_values import whole_number
from gaussray.io.validate import check_field_types


# The standard error of a pixel is estimated from at least this many batches of samples.
BATCHES = 4
# A sensor that changes nothing: the light is written as it is.
NO_SENSOR = SensorOptions()


class RenderOptions(eqx.Module):
    """How a picture is sampled.

    Args:
        samples: rays per pixel, over pixel filter, aperture and exposure.
        keys: states of the scene across the times of one frame; each ray moves the Gaussians
            between them to its own time. 0 is three for every interval between the capture's
            timestamps (neighbouring intervals share a state), and one for a frame whose rays share
            one time.
        chunk_rows: above 0, the method of the paper instead: one state for so many rows (1 is a
            state for every row).
        dilation: square pixels added to each Gaussian on the screen. A model shows as in the
            rasteriser that it was fitted with: 3DGS has 0.3.
        harmonics: direction of the harmonics: "ray", or "center" from the camera's center to the
            Gaussian's, as 3DGS has it.
        error: above 0, batches of `samples` are added until the standard error of the mean of 95 %
            of the pixels is at most that (linear light, the largest of three channels).
        samples_most: largest number of rays per pixel with `error`.
        memory: gigabytes that the rays of a frame may take. A larger frame is traced in strips of
            rows (`parts.strip_rows`), with the same result. The scene itself comes on top, and 4
            bytes for each Gaussian in a bundle's list. Labels are cut likewise.

    Raises:
        ValueError: A value breaks its rule; the message names the key.
    """

    samples: int = eqx.field(static=True, default=4, converter=whole_number)
    keys: int = eqx.field(static=True, default=0, converter=whole_number)
    chunk_rows: int = eqx.field(static=True, default=0, converter=whole_number)
    dilation: float = eqx.field(static=True, default=0.0)
    harmonics: str = eqx.field(static=True, default="ray")
    error: float = eqx.field(static=True, default=0.0)
    samples_most: int = eqx.field(static=True, default=1024, converter=whole_number)
    memory: float = eqx.field(static=True, default=8.0)

    def __check_init__(self):
        check_field_types("render", self)
        if self.samples < 1:
            raise ValueError(f"render.samples must be at least 1, got {self.samples}.")
        if self.keys not in (0, 2) and (self.keys < 3 or self.keys % 2 == 0):
            raise ValueError(
                f"render.keys must be 0 (chosen automatically), 2 or odd from 3, got {self.keys}."
            )
        if self.chunk_rows < 0:
            raise ValueError(f"render.chunk_rows must be at least 0, got {self.chunk_rows}.")
        if not self.memory > 0:
            raise ValueError(f"render.memory must be above 0, got {self.memory}.")
        if not 0 <= self.dilation < math.inf:
            raise ValueError(f"render.dilation must be at least 0, got {self.dilation}.")
        if self.harmonics not in ("ray", "center"):
            raise ValueError(f"render.harmonics must be ray or center, got {self.harmonics!r}.")
        if not 0 <= self.error < math.inf:
            raise ValueError(f"render.error must be at least 0, got {self.error}. 0 is off.")
        least = BATCHES * self.samples
        if self.error and self.samples_most < least:
            raise ValueError(
                f"render.samples_most must be at least {least}, which is {BATCHES} batches of "
                f"render.samples, got {self.samples_most}."
            )

    @property
    def imitates_splatting(self) -> bool:
        """Whether the Gaussians depend on the camera, as in 3DGS' renderer."""
        return self.dilation > 0 or self.harmonics == "center"


@dataclasses.dataclass(frozen=True)
class DatasetOptions:
    """What a dataset stores of every frame.

    Args:
        sensor: the sensor that develops the light.
        labels: names of `aov.labeller.LABELS`, which are written beside the pictures.
        fps: frames per second of the videos.
        info: facts that are copied into the manifests.
    """

    sensor: SensorOptions = NO_SENSOR
    labels: Sequence[str] = ()
    fps: float = 8.0
    info: Mapping[str, Any] = dataclasses.field(default_factory=dict)
