"""Options of the evaluation."""

import equinox as eqx


class EvaluateOptions(eqx.Module):
    """Which pictures are scored, and with how many rays per pixel.

    Args:
        split: `train`, `test` or `all`.
        effects: Names of the effects to score. Empty: all.
        frames: The largest number of pictures per effect, evenly spread. 0: all.
        pinhole: Rays per pixel of the effect `pinhole`.
        rolling_shutter: Rays per pixel of the effect `rolling_shutter`.
        fisheye: Rays per pixel of the effect `fisheye`.
        depth_of_field: Rays per pixel of the effect `depth_of_field`.
        other: Rays per pixel of any other effect.
        images: Whether to write truth, rendering and difference side by side, and videos.

    Raises:
        ValueError: If an option is out of range. The message names its key.
    """

    split: str = eqx.field(static=True, default="test")
    effects: tuple[str, ...] = eqx.field(static=True, default=())
    frames: int = eqx.field(static=True, default=0)
    pinhole: int = eqx.field(static=True, default=1)
    rolling_shutter: int = eqx.field(static=True, default=1)
    fisheye: int = eqx.field(static=True, default=4)
    depth_of_field: int = eqx.field(static=True, default=16)
    other: int = eqx.field(static=True, default=16)
    images: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if self.split not in ("train", "test", "all"):
            raise ValueError(f"evaluate.split must be train, test or all, got {self.split!r}.")
        for name in ("pinhole", "rolling_shutter", "fisheye", "depth_of_field", "other"):
            if getattr(self, name) < 1:
                raise ValueError(f"evaluate.{name} must be at least 1, got {getattr(self, name)}.")
        if self.frames < 0:
            raise ValueError(f"evaluate.frames must be at least 0, got {self.frames}.")

    def samples(self, effect: str) -> int:
        """Rays per pixel of an effect."""
        effects = ("pinhole", "rolling_shutter", "fisheye", "depth_of_field")
        return getattr(self, effect if effect in effects else "other")
