"""How many takes are drawn, and which of them this process films."""

import equinox as eqx


class FactoryOptions(eqx.Module):
    """`count` takes are drawn from `sample` (0: one, not drawn, as the keys are). What a take is
    follows from `seed` and its index alone.

    An impossible one is refused, or drawn anew up to `redraws` times: what is filmed then follows
    the distribution within what is possible. This process films the indices i, i + n, i + 2n, ...
    of `shard` = i/n. `shards` > 1 has Hydra's launcher start as many processes. A sample has so
    many `frames` of a camera, one after another, from a random one of the chosen cameras and times;
    0 is all of them.
    """

    count: int = eqx.field(static=True, default=0)
    frames: int = eqx.field(static=True, default=1)
    seed: int = eqx.field(static=True, default=0)
    redraws: int = eqx.field(static=True, default=0)
    shard: str = eqx.field(static=True, default="0/1")
    shards: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        for key, least in {"count": 0, "frames": 0, "redraws": 0, "shards": 1}.items():
            if getattr(self, key) < least:
                raise ValueError(
                    f"factory.{key} must be at least {least}, got {getattr(self, key)}."
                )
        number, _, of = self.shard.partition("/")
        if not (number.isdigit() and of.isdigit() and int(number) < int(of)):
            raise ValueError(
                f"factory.shard must be i/n with i from 0 to n - 1, got {self.shard!r}."
            )
        if self.shards > 1 and (self.count == 0 or self.shard != "0/1"):
            raise ValueError(
                f"factory.shards = {self.shards} needs factory.count above 0, and factory.shard "
                f"left at 0/1, got {self.count} and {self.shard}."
            )

    @property
    def indices(self) -> range:
        """Indices of the takes that this process films."""
        number, of = (int(word) for word in self.shard.split("/"))
        return range(number, self.count, of)
