"""Pictures and videos."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from experiments.hostile.reader import Reader, written


def picture(suffix: str, channels: int = 3, kind: str = "uint8") -> bytes:
    import OpenImageIO as oiio

    def write(path):
        spec = oiio.ImageSpec(4, 3, channels, kind)
        file = oiio.ImageOutput.create(str(path))
        file.open(str(path), spec)
        file.write_image(np.arange(12 * channels).reshape(3, 4, channels).astype(kind))
        file.close()

    return written(f"a{suffix}", write)


def film(suffix: str, codec: str) -> bytes:
    import av

    def write(path):
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=10)
            stream.width, stream.height = 16, 16
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            for i in range(3):
                pixels = np.full((16, 16, 3), 60 * i, np.uint8)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, "rgb24")))
            container.mux(stream.encode())

    return written(f"a{suffix}", write)


def _read_stored(name: str, size: tuple[int, int] = (4, 3)) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from gaussray.capture.picture_file import read_stored

        return read_stored(folder / name, *size)

    return read


def _read_video(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from gaussray.capture.videos import decode_frames, read_video

        count = read_video(folder / name).frames
        return sum(1 for _ in decode_frames(folder / name, range(min(count, 20))))

    return read


def _pictures(name: str, *made: tuple) -> Reader:
    kind = "png" if name == ".png" else "bytes"
    return Reader(
        lambda: [{f"a{name}": picture(name, *how)} for how in made or ((),)],
        _read_stored(f"a{name}"),
        {f"a{name}": kind},
    )


def _videos(name: str, codec: str) -> Reader:
    file = f"a{name}"
    return Reader(lambda: [{file: film(name, codec)}], _read_video(file), {file: "bytes"})


READERS = {
    "png": _pictures(".png", (), (4,), (1,), (3, "uint16")),
    "jpeg": _pictures(".jpg", (), (1,)),
    "tiff": _pictures(".tif", (), (4, "float32"), (3, "uint16")),
    "exr": _pictures(".exr", (3, "float32"), (4, "float32"), (5, "float32")),
    "bmp": _pictures(".bmp"),
    "webp": _pictures(".webp", (), (4,)),
    "pgm": _pictures(".pgm", (1,), (1, "uint16")),
    "ppm": _pictures(".ppm", (), (3, "uint16")),
    "mp4-h264": _videos(".mp4", "libx264"),
    "mkv-vp9": _videos(".mkv", "libvpx-vp9"),
    "avi-mjpeg": _videos(".avi", "mjpeg"),
}
