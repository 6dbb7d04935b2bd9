"""Options of the viewer: its address, the size of the picture, the quality of previews."""

import math

import equinox as eqx


class ViewOptions(eqx.Module):
    """Options of `gaussray view`.

    Args:
        host: address to listen on; 0.0.0.0 accepts connections from other machines.
        port: port of the web page; the next free one if it is taken.
        width: width of the final picture in pixels; 0 is the capture's.
        height: height of the final picture in pixels; 0 keeps the capture's aspect.
        rate: previews per second while something changes; a slower machine renders smaller ones.
        samples: rays per pixel of a preview where the aperture or the exposure blurs.
        keys: key states of the scene across the frame time of a preview.
        dark: whether the page has dark colours.
    """

    host: str = eqx.field(static=True, default="127.0.0.1")
    port: int = eqx.field(static=True, default=8080)
    width: int = eqx.field(static=True, default=0)
    height: int = eqx.field(static=True, default=0)
    rate: float = eqx.field(static=True, default=8.0)
    samples: int = eqx.field(static=True, default=4)
    keys: int = eqx.field(static=True, default=3)
    dark: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not 0 < self.port < 65536:
            raise ValueError(f"view.port must be in 1 ... 65535, got {self.port}.")
        for key in ("width", "height"):
            if getattr(self, key) < 0:
                raise ValueError(f"view.{key} must be at least 0, got {getattr(self, key)}.")
        if not 0 < self.rate < math.inf:
            raise ValueError(f"view.rate must be above 0 frames a second, got {self.rate}.")
        if self.samples < 1:
            raise ValueError(f"view.samples must be at least 1, got {self.samples}.")
        if self.keys != 2 and (self.keys < 3 or self.keys % 2 == 0):
            raise ValueError(f"view.keys must be 2 or odd from 3, got {self.keys}.")
