"""Long scenes: segments of time, each a scene of its own."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.scene.scene import Scene, transient_count


# What a scene must be, where it is none, for messages.
SCENE_RULE = "a gaussray.Scene or Clip, such as gaussray.load(path)"


class Clip(eqx.Module):
    """A long scene: scenes of consecutive time intervals.

    A segment shows the times from its own first time until that of the next; the first segment also
    all earlier times, the last one all later times.

    Args:
        segments: the scenes, in order; each begins where the one before ends.

    Raises:
        ValueError: There is no segment, or the intervals do not meet.
    """

    segments: tuple[Scene, ...]

    def __check_init__(self):
        if not self.segments:
            raise ValueError("a clip must have at least one segment, got none.")
        ranges = [np.asarray(scene.time_range) for scene in self.segments]
        for i, (previous, current) in enumerate(zip(ranges, ranges[1:], strict=False), 2):
            if not previous[0] < previous[1] == current[0] < current[1]:
                raise ValueError(
                    f"segment {i} of a clip must begin where the one before ends, got the times "
                    f"{current[0]:g} ... {current[1]:g} after {previous[0]:g} ... "
                    f"{previous[1]:g}."
                )

    @property
    def time_range(self) -> Float[Array, "2"]:
        """The interval of the capture, in the capture's own unit."""
        return jnp.stack([self.segments[0].time_range[0], self.segments[-1].time_range[1]])


def segments_of(scene: Scene | Clip) -> tuple[Scene, ...]:
    """The segments of a clip; a single scene is its own segment."""
    return scene.segments if isinstance(scene, Clip) else (scene,)


def segment_edges(scene: Scene | Clip) -> Float[np.ndarray, " edges"]:
    """The times at which segments meet."""
    return np.array([float(part.time_range[0]) for part in segments_of(scene)[1:]])


def segment_at(scene: Scene | Clip, time: float) -> Scene:
    """The segment that shows a time.

    Args:
        scene: a clip, or a scene, which is its own segment.
        time: any time, in the capture's unit; where two segments meet the later one shows it.
    """
    return segments_of(scene)[int(np.searchsorted(segment_edges(scene), time, side="right"))]


def scene_size(scene: Scene | Clip) -> dict[str, int]:
    """Number of Gaussians, of moving ones, and bytes of a scene, over all segments."""
    size = sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(scene))
    parts = segments_of(scene)
    moving = sum(part.moving.count for part in parts)
    total, transient = sum(part.count for part in parts), sum(transient_count(x) for x in parts)
    facts = {"gaussians": total, "moving": moving, "bytes": int(size)}
    if transient:
        facts["transient"] = transient
    return facts | {"segments": len(parts)} if isinstance(scene, Clip) else facts
