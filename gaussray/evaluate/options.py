"""Options of the evaluation."""

import equinox as eqx


# Effects with a number of rays of their own.
_SAMPLED = ("pinhole", "rolling_shutter", "fisheye", "depth_of_field")


class EvaluateOptions(eqx.Module):
    """Which pictures are scored, and with how many rays per pixel.

    Args:
        split: `train`, `test` or `all`.
        effects: names of the effects to score. Empty: all.
        frames: the largest number of pictures per effect, evenly spread. 0: all.
        samples_pinhole: rays per pixel of the effect `pinhole`.
        samples_rolling_shutter: rays per pixel of the effect `rolling_shutter`.
        samples_fisheye: rays per pixel of the effect `fisheye`.
        samples_depth_of_field: rays per pixel of the effect `depth_of_field`.
        samples_other: rays per pixel of any other effect.
        images: whether to write truth, rendering and difference side by side, and videos.

    Raises:
        ValueError: If an option is out of range. The message names its key.
    """

    split: str = eqx.field(static=True, default="test")
    effects: tuple[str, ...] = eqx.field(static=True, default=())
    frames: int = eqx.field(static=True, default=0)
    samples_pinhole: int = eqx.field(static=True, default=1)
    samples_rolling_shutter: int = eqx.field(static=True, default=1)
    samples_fisheye: int = eqx.field(static=True, default=4)
    samples_depth_of_field: int = eqx.field(static=True, default=16)
    samples_other: int = eqx.field(static=True, default=16)
    images: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if self.split not in ("train", "test", "all"):
            raise ValueError(f"evaluate.split must be train, test or all, got {self.split!r}.")
        for name in (*_SAMPLED, "other"):
            if (count := getattr(self, f"samples_{name}")) < 1:
                raise ValueError(f"evaluate.samples_{name} must be at least 1, got {count}.")
        if self.frames < 0:
            raise ValueError(f"evaluate.frames must be at least 0, got {self.frames}.")

    def samples(self, effect: str) -> int:
        """Rays per pixel of an effect."""
        return getattr(self, f"samples_{effect if effect in _SAMPLED else 'other'}")
