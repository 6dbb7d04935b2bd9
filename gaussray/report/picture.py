"""Pictures embedded in the report: compressed, compared with a slider, as a sequence."""

import base64
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.dataset.images import write_image
from gaussray.io.safe.openimageio import oiio
from gaussray.report.markup import Markup, tag


# Bytes of all pictures of a report, before base64 adds a third.
BYTES = 3_300_000
# Largest side of an embedded picture, in pixels.
SIDE = 720
# Pictures up to this side stay lossless and are shown with visible pixels.
SMALL = 200
# Difference (8-bit levels) at the end of the difference map's scale, and its colours.
FULL = 64
HEAT = ((0, 0, 4), (40, 11, 84), (101, 21, 110), (159, 42, 99), (212, 72, 66), (245, 125, 21),
        (250, 193, 39), (252, 255, 164))  # fmt: skip


def embedded_image(levels: UInt8[np.ndarray, "h w 3"], most: int) -> str:
    """A picture as a data URL: PNG if it is small, else JPEG with decreasing quality and size.

    Args:
        levels: the picture, 8-bit sRGB.
        most: limit of its bytes, before base64. A small picture may always have 20 kB, and none is
            reduced below 64 pixels, whatever its bytes.
    """
    side = max(levels.shape[:2])
    if side <= SMALL:
        data = _encode(levels, ".png", 0)
        if len(data) <= max(most, 20_000):
            return _data_url(data, "png")
    size = min(side, SIDE)
    while True:
        small = _shrink(levels, size)
        for quality in (88, 75):
            data = _encode(small, ".jpg", quality)
            if len(data) <= most or size <= 64:
                return _data_url(data, "jpeg")
        size = max(size * 3 // 4, 64)


def error_map(truth: np.ndarray, image: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """The mean absolute difference of the channels as a color map, 8-bit sRGB.

    Args:
        truth, image: pictures of equal size, 8-bit levels. Equal pixels are black; a difference of
            FULL levels or more is light yellow.
    """
    difference = np.abs(truth.astype(np.float32) - image.astype(np.float32)).mean(axis=2)
    level = np.clip(difference / FULL, 0, 1) * (len(HEAT) - 1)
    knots = np.arange(len(HEAT))
    channels = [np.interp(level, knots, [c[i] for c in HEAT]) for i in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def error_scale() -> Markup:
    """A legend of the difference map."""
    stops = ", ".join(f"rgb{c}" for c in HEAT)
    bar = tag("span", class_="scale", style=f"background:linear-gradient(90deg, {stops})")
    words = "Difference map: mean over the channels of |rendering - truth|, from 0"
    end = f"to {FULL} or more of 255. Drag across a picture: truth left, rendering right."
    return tag("p", words, bar, end, class_="note")


def comparison_figure(
    truth: np.ndarray,
    image: np.ndarray,
    caption: Sequence[Markup | str],
    *,
    shown: np.ndarray | None = None,
    most: int,
) -> Markup:
    """Truth and rendering with a slider between them, and the difference map.

    Args:
        truth, image: pictures of equal size, 8-bit sRGB.
        caption: parts of the caption.
        shown: pixels [h, w] that count; the map is black in all others. None: all count.
        most: limit of the bytes of each picture.
    """
    height, width = truth.shape[:2]
    shape = f"aspect-ratio:{width}/{height}"
    small = " small" if max(width, height) <= SMALL else ""
    slider = tag("input", type="range", min=0, max=100, value=50, step="any",
                 aria_label="share of the picture that shows the truth")  # fmt: skip
    both = tag(
        "div",
        tag("img", src=embedded_image(image, most), alt="rendering"),
        tag("img", src=embedded_image(truth, most), alt="truth"),
        tag("span", "truth", class_="chip left"),
        tag("span", "rendering", class_="chip right"),
        slider,
        class_=f"compare{small}",
        style=shape,
    )
    compared = image if shown is None else np.where(shown[..., None], image, truth)
    difference = captioned_image(error_map(truth, compared), "difference", most=most)
    return tag(
        "figure", tag("div", both, difference, class_="pair"), tag("figcaption", list(caption))
    )


def captioned_image(levels: np.ndarray, name: str, *, most: int) -> Markup:
    """A picture with its name in the corner.

    Args:
        levels: 8-bit sRGB levels [h, w, 3].
        name: words in the corner, which also describe the picture where it is not shown.
        most: limit of the picture's bytes (`embedded_image`).
    """
    height, width = levels.shape[:2]
    small = " small" if max(width, height) <= SMALL else ""
    return tag(
        "div",
        tag("img", src=embedded_image(levels, most), alt=name),
        tag("span", name, class_="chip left"),
        class_=f"still{small}",
        style=f"aspect-ratio:{width}/{height}",
    )


def picture_slider(frames: Sequence[tuple[str, np.ndarray]], name: str, *, most: int) -> Markup:
    """A sequence of pictures behind a slider, which shows one at a time.

    Args:
        frames: name and 8-bit sRGB levels of each picture, all of one size.
        name: name of the sequence.
        most: limit of the bytes of each picture.
    """
    height, width = frames[0][1].shape[:2]
    small = " small" if max(width, height) <= SMALL else ""
    pictures = [
        tag("img", src=embedded_image(levels, most), alt=label, class_="shown" if i == 0 else None)
        for i, (label, levels) in enumerate(frames)
    ]
    slider = tag("input", type="range", min=0, max=len(frames) - 1, value=0, step=1,
                 aria_label=f"frame of {name}")  # fmt: skip
    return tag(
        "figure",
        tag("div", pictures, class_=f"frames{small}", style=f"aspect-ratio:{width}/{height}"),
        slider if len(frames) > 1 else None,
        tag("figcaption", f"{name} ", tag("b", frames[0][0])),
        class_="film",
    )


def _shrink(levels: np.ndarray, side: int) -> np.ndarray:
    """The picture with its larger side reduced to at most `side` pixels."""
    height, width = levels.shape[:2]
    if max(height, width) <= side:
        return levels
    scale = side / max(height, width)
    size = oiio.ROI(0, max(round(width * scale), 1), 0, max(round(height * scale), 1))
    source = oiio.ImageBuf(np.ascontiguousarray(levels))
    made = oiio.ImageBufAlgo.resize(source, roi=size)
    return np.ascontiguousarray(made.get_pixels(oiio.UINT8))


def _encode(levels: np.ndarray, suffix: str, quality: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture{suffix}"
        if suffix == ".png":
            write_image(path, np.ascontiguousarray(levels))
            return path.read_bytes()
        height, width = levels.shape[:2]
        spec = oiio.ImageSpec(width, height, 3, "uint8")
        spec["Compression"] = f"jpeg:{quality}"
        file = oiio.ImageOutput.create(str(path))
        pixels = np.ascontiguousarray(levels)
        if not (file and file.open(str(path), spec) and file.write_image(pixels) and file.close()):
            raise OSError(f"a picture of the report cannot be encoded: {oiio.geterror()}")
        return path.read_bytes()


def _data_url(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
