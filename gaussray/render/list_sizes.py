"""Sizes of the tracer's lists for a picture's programs: powers of two for those in stages, so that
few sets of programs serve all cameras."""

from jax.typing import DTypeLike

from gaussray.render.parts import Part
from gaussray.scene.scene import Scene
from gaussray.tracer.measure import HEADROOM, enlarged_capacity
from gaussray.tracer.options import TraceOptions, grid_levels
from gaussray.tracer.traverse import Capacity


# For programs that have not been measured.
NO_LISTS = Capacity((), 0, 0)


def default_capacity(part: Part, trace: TraceOptions, scene: Scene, dtype: DTypeLike) -> Capacity:
    """List sizes to start from in stages.

    Args:
        part: the pixels, with a leading axis of devices.
        trace: options of the tracer.
        scene: the scene that it traces.
        dtype: precision of the rays.
    """
    bundles = -(-part.pixel.shape[-2] // trace.bundle**2)
    transient = 0 if scene.transient is None else scene.transient.count
    alive = min(transient, max(64, transient // 16))
    cells = (256 * bundles,) * grid_levels(trace, dtype)
    return round_capacity(Capacity(cells, 512 * bundles, 1024, alive))


def enlarge_program_capacity(
    capacity: Capacity, needed: list[int], *, staged: bool, headroom: float = HEADROOM
) -> Capacity:
    """Enlarge list sizes that are too short for a picture.

    Args:
        capacity, needed: the sizes, and those that a trace needs (`Report.needed`).
        staged: whether the picture is rendered in stages, for which sizes are powers of two.
        headroom: factor of the needed sizes, for other frames.
    """
    enlarged = enlarged_capacity(capacity, needed, headroom=headroom)
    return round_capacity(enlarged) if staged else enlarged


def round_capacity(capacity: Capacity) -> Capacity:
    """List sizes rounded up to powers of two."""

    def round_size(size: int) -> int:
        return 1 << max(size - 1, 0).bit_length() if size else 0

    return Capacity(
        tuple(map(round_size, capacity.cells)),
        round_size(capacity.pairs),
        round_size(capacity.slots),
        round_size(capacity.transient),
    )
