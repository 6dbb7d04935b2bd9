"""Pictures within a page: small enough, and beside each other."""

import base64
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gaussray.dataset.images import write_image
from gaussray.io.safe.openimageio import oiio
from gaussray.report.markup import Markup, tag


# Bytes of all pictures of a page; base64 makes a third more of them.
BYTES = 3_300_000
SIDE = 720
# Pictures up to this side are kept as they are, and shown with their pixels.
SMALL = 200
# Codes of 255 at the end of the scale of a difference map, and colours along it.
FULL = 64
HEAT = ((0, 0, 4), (40, 11, 84), (101, 21, 110), (159, 42, 99), (212, 72, 66), (245, 125, 21),
        (250, 193, 39), (252, 255, 164))  # fmt: skip


def inline(codes: UInt8[np.ndarray, "h w 3"], most: int) -> str:
    """A picture as an address that holds it in at most about so many bytes: PNG of a small one,
    else JPEG, smaller and coarser until it fits."""
    side = max(codes.shape[:2])
    if side <= SMALL:
        kept = _encoded(codes, ".png", 0)
        if len(kept) <= max(most, 20_000):
            return _address(kept, "png")
    size = min(side, SIDE)
    while True:
        small = _shrunk(codes, size)
        for quality in (88, 75):
            data = _encoded(small, ".jpg", quality)
            if len(data) <= most or size <= 64:
                return _address(data, "jpeg")
        size = max(size * 3 // 4, 64)


def heat(truth: np.ndarray, ours: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    """The mean absolute difference of the channels, in colours from black (none) to light yellow
    (FULL codes and more)."""
    off = np.abs(truth.astype(np.float32) - ours.astype(np.float32)).mean(axis=2)
    place = np.clip(off / FULL, 0, 1) * (len(HEAT) - 1)
    knots = np.arange(len(HEAT))
    channels = [np.interp(place, knots, [c[i] for c in HEAT]) for i in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def heat_scale() -> Markup:
    """What the colours of a difference map mean."""
    stops = ", ".join(f"rgb{c}" for c in HEAT)
    bar = tag("span", class_="scale", style=f"background:linear-gradient(90deg, {stops})")
    words = "Difference maps: mean over the channels of |ours - truth|, 0"
    end = f"{FULL} of 255 and more. Drag across a picture: truth at the left, ours at the right."
    return tag("p", words, bar, end, class_="note")


def compared(
    truth: np.ndarray, ours: np.ndarray, caption: Sequence[Markup | str], *, most: int
) -> Markup:
    """Truth and ours with a slider between them, the difference beside them; `most` bytes each."""
    height, width = truth.shape[:2]
    shape = f"aspect-ratio:{width}/{height}"
    small = " small" if max(width, height) <= SMALL else ""
    slider = tag("input", type="range", min=0, max=100, value=50, step="any",
                 aria_label="share of the picture that shows the truth")  # fmt: skip
    both = tag(
        "div",
        tag("img", src=inline(ours, most), alt="ours"),
        tag("img", src=inline(truth, most), alt="truth"),
        tag("span", "truth", class_="chip left"),
        tag("span", "ours", class_="chip right"),
        slider,
        class_=f"compare{small}",
        style=shape,
    )
    off = still(heat(truth, ours), "difference", most=most)
    return tag("figure", tag("div", both, off, class_="pair"), tag("figcaption", list(caption)))


def still(codes: np.ndarray, name: str, *, most: int) -> Markup:
    """One picture, named in its corner."""
    height, width = codes.shape[:2]
    small = " small" if max(width, height) <= SMALL else ""
    return tag(
        "div",
        tag("img", src=inline(codes, most), alt=name),
        tag("span", name, class_="chip left"),
        class_=f"still{small}",
        style=f"aspect-ratio:{width}/{height}",
    )


def film(frames: Sequence[tuple[str, np.ndarray]], name: str, *, most: int) -> Markup:
    """Pictures at one place, by name, with a slider through them."""
    height, width = frames[0][1].shape[:2]
    small = " small" if max(width, height) <= SMALL else ""
    shown = [
        tag("img", src=inline(codes, most), alt=told, class_="shown" if i == 0 else None)
        for i, (told, codes) in enumerate(frames)
    ]
    slider = tag("input", type="range", min=0, max=len(frames) - 1, value=0, step=1,
                 aria_label=f"frame of {name}")  # fmt: skip
    return tag(
        "figure",
        tag("div", shown, class_=f"frames{small}", style=f"aspect-ratio:{width}/{height}"),
        slider if len(frames) > 1 else None,
        tag("figcaption", f"{name} ", tag("b", frames[0][0])),
        class_="film",
    )


def _shrunk(codes: np.ndarray, side: int) -> np.ndarray:
    """The picture with its larger side at most so long."""
    height, width = codes.shape[:2]
    if max(height, width) <= side:
        return codes
    scale = side / max(height, width)
    size = oiio.ROI(0, max(round(width * scale), 1), 0, max(round(height * scale), 1))
    source = oiio.ImageBuf(np.ascontiguousarray(codes))
    made = oiio.ImageBufAlgo.resize(source, roi=size)
    return np.ascontiguousarray(made.get_pixels(oiio.UINT8))


def _encoded(codes: np.ndarray, suffix: str, quality: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"picture{suffix}"
        if suffix == ".png":
            write_image(path, np.ascontiguousarray(codes))
            return path.read_bytes()
        height, width = codes.shape[:2]
        spec = oiio.ImageSpec(width, height, 3, "uint8")
        spec["Compression"] = f"jpeg:{quality}"
        file = oiio.ImageOutput.create(str(path))
        pixels = np.ascontiguousarray(codes)
        if not (file and file.open(str(path), spec) and file.write_image(pixels) and file.close()):
            raise OSError(f"a picture of a page cannot be encoded: {oiio.geterror()}")
        return path.read_bytes()


def _address(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
