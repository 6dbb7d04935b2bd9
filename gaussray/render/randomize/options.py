"""Options of a randomised dataset: number of samples, and which of them a process renders."""

import equinox as eqx


class DrawOptions(eqx.Module):
    """Options of a randomised dataset.

    A sample depends on `seed` and its index alone.

    Args:
        count: number of samples to draw from `sample`; 0 is one, without drawing.
        frames: successive frames of each sample, from a random one of the chosen cameras and times;
            0 is all of them.
        seed: random seed.
        redraws: attempts to replace an impossible sample; 0 refuses it. With redraws, samples
            follow the distributions restricted to what is possible.
        clearance: least distance from a camera to anything opaque, as a share of the median
            distance from the capture's cameras to what they see (without a capture, of the radius
            of the scene). Cameras that are nearer, in an object or behind one are drawn again
            (`clearance.FreeSpace`); places of the capture's own cameras are free. 0 allows all.
        shard: i/n: this process renders the samples i, i + n, i + 2n, ...
        shards: number of processes that Hydra's launcher starts.
        layout: layout of a published dataset in which the samples are also written
            (`dataset.layouts`); empty for none.

    Raises:
        ValueError: A value breaks its rule; the message names the key.
    """

    count: int = eqx.field(static=True, default=0)
    frames: int = eqx.field(static=True, default=1)
    seed: int = eqx.field(static=True, default=0)
    redraws: int = eqx.field(static=True, default=0)
    # 3 cm in a room that is seen from 3 m: nearer, single Gaussians of a surface show.
    clearance: float = eqx.field(static=True, default=0.01)
    shard: str = eqx.field(static=True, default="0/1")
    shards: int = eqx.field(static=True, default=1)
    layout: str = eqx.field(static=True, default="")

    def __check_init__(self):
        leasts = {"count": 0, "frames": 0, "redraws": 0, "clearance": 0, "shards": 1}
        for key, least in leasts.items():
            if not getattr(self, key) >= least:
                raise ValueError(
                    f"dataset.{key} must be at least {least}, got {getattr(self, key)}."
                )
        number, _, of = self.shard.partition("/")
        if not (number.isdigit() and of.isdigit() and int(number) < int(of)):
            raise ValueError(
                f"dataset.shard must be i/n with i from 0 to n - 1, got {self.shard!r}."
            )
        if self.shards > 1 and (self.count == 0 or self.shard != "0/1"):
            raise ValueError(
                f"dataset.shards = {self.shards} needs dataset.count above 0, and dataset.shard "
                f"left at 0/1, got {self.count} and {self.shard}."
            )

    @property
    def indices(self) -> range:
        """Indices of the samples that this process renders."""
        number, of = (int(word) for word in self.shard.split("/"))
        return range(number, self.count, of)
