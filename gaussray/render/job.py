"""A render job: everything that one dataset is made from."""

from collections.abc import Sequence
from typing import NamedTuple

from gaussray.dataset.manifest import FrameRecord
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.renderer import Renderer
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip
from gaussray.tracer.options import TraceOptions


class RenderJob(NamedTuple):
    """A scene, the frames to render of it, how they are traced, and what is stored of them."""

    scene: Scene | Clip
    records: Sequence[FrameRecord]
    options: RenderOptions
    trace: TraceOptions
    dataset: DatasetOptions

    def renderer(self, devices: int | None = None) -> Renderer:
        """A renderer of the scene with the job's options, on so many devices (None: all)."""
        return Renderer(self.scene, options=self.options, trace=self.trace, devices=devices)
