"""Long scenes: segments of time, each a scene of its own."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.scene.scene import Scene


# What a scene must be, where it is none, for messages.
SCENE_RULE = "a gaussray.Scene or Clip, such as gaussray.load(path)"


class Clip(eqx.Module):
    """Scenes of neighbouring intervals of time, in order; they share the instants where they meet.

    A segment shows the times from its first instant until before the next one's; the first one also
    what was before, the last one what comes after. ValueError if there is none, or if one does not
    begin where the one before ends.
    """

    segments: tuple[Scene, ...]

    def __check_init__(self):
        if not self.segments:
            raise ValueError("a clip must have at least one segment, got none.")
        ranges = [np.asarray(scene.time_range) for scene in self.segments]
        for i, (before, own) in enumerate(zip(ranges, ranges[1:], strict=False), 2):
            if not before[0] < before[1] == own[0] < own[1]:
                raise ValueError(
                    f"segment {i} of a clip must begin where the one before ends, got the times "
                    f"{own[0]:g} ... {own[1]:g} after {before[0]:g} ... {before[1]:g}."
                )

    @property
    def time_range(self) -> Float[Array, "2"]:
        """The interval of the capture, in the capture's own unit."""
        return jnp.stack([self.segments[0].time_range[0], self.segments[-1].time_range[1]])


def segments_of(scene: Scene | Clip) -> tuple[Scene, ...]:
    """The segments of a clip; any other scene is its only one."""
    return scene.segments if isinstance(scene, Clip) else (scene,)


def edges_of(scene: Scene | Clip) -> Float[np.ndarray, " edges"]:
    """The instants where segments meet, on the host."""
    return np.array([float(part.time_range[0]) for part in segments_of(scene)[1:]])


def segment_at(scene: Scene | Clip, time: float) -> Scene:
    """The segment that shows a time."""
    return segments_of(scene)[int(np.searchsorted(edges_of(scene), time, side="right"))]
