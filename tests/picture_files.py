"""Files of pictures, and what a view says of each."""

import dataclasses
import pathlib

import numpy as np
import OpenImageIO as oiio

from gaussray.capture.stored_part import Window


@dataclasses.dataclass
class Picture:
    image: pathlib.Path
    width: int
    height: int
    color_space: str = "srgb"
    background: str = "none"
    window: Window | None = None
    margin: tuple[int, int, int, int] = (0, 0, 0, 0)


def write(path, pixels):
    kind = "float" if pixels.dtype == np.float32 else str(pixels.dtype)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    spec["oiio:UnassociatedAlpha"] = 1
    spec["jpeg:subsampling"] = "4:4:4"
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()
    return path


def random_codes(kind=np.uint8, channels=3):
    return np.random.default_rng(0).integers(0, np.iinfo(kind).max + 1, (24, 32, channels), kind)
