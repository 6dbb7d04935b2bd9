"""Opens untrusted pictures: known formats only, with size limits checked before decoding."""

from pathlib import Path
from typing import Any

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import limits, within
from gaussray.io.safe.netpbm import check_netpbm
from gaussray.io.safe.openimageio import oiio


_PGM, _PPM = "binary PGM", "binary PPM"
# First bytes of each format that is read, its name and its file extensions. OpenImageIO supports
# twenty more, some of which accept any bytes.
SIGNATURES = {
    b"\x89PNG\r\n\x1a\n": ("PNG", (".png",)),
    b"\xff\xd8\xff": ("JPEG", (".jpg", ".jpeg")),
    b"II*\0": ("TIFF", (".tif", ".tiff")),
    b"MM\0*": ("TIFF", (".tif", ".tiff")),
    b"II+\0": ("TIFF", (".tif", ".tiff")),
    b"MM\0+": ("TIFF", (".tif", ".tiff")),
    b"v/1\x01": ("OpenEXR", (".exr",)),
    b"BM": ("BMP", (".bmp",)),
    b"RIFF": ("WebP", (".webp",)),
    b"P5": (_PGM, (".pgm", ".pnm")),
    b"P6": (_PPM, (".ppm", ".pnm")),
}


def open_picture(path: Path | str, config: "oiio.ImageSpec | None" = None) -> "oiio.ImageInput":
    """Open a picture and check its header; no pixels are read yet.

    The first bytes define the format, and the file extension must match it.

    Args:
        path: the picture.
        config: settings of OpenImageIO's reader, such as `oiio:UnassociatedAlpha`; None: its own.

    Raises:
        OSError: the file is missing, or no flat picture of a known format.
        ValueError: the picture exceeds limits.picture or limits.channels.
    """
    _check_format(Path(path))
    most = limits()
    # Settings of the process: only the reader of the format is tried, and it does not allocate a
    # picture that is refused below.
    oiio.attribute("try_all_readers", 0)
    oiio.attribute("limits:channels", most.channels)
    pixels = 4 * most.picture * most.channels
    oiio.attribute("limits:imagesize_MB", int(min(pixels, 1e6)) + 1)
    file = oiio.ImageInput.open(str(path), config or oiio.ImageSpec())
    if file is None:
        raise OSError(f"{path}: the picture cannot be opened: {complaint(oiio)}")
    spec = file.spec()
    try:
        _ = spec.channelnames
    except UnicodeDecodeError:
        raise OSError(f"{path}: the picture's channels must have names in UTF-8.") from None
    within(path, "its megapixels", spec.width * spec.height * spec.depth, "picture", 1e6)
    within(path, "its channels", spec.nchannels, "channels")
    if min(spec.width, spec.height, spec.nchannels) < 1 or spec.depth != 1 or spec.deep:
        raise OSError(f"{path}: the picture must be flat, with pixels and channels.")
    return file


def _check_format(path: Path) -> None:
    with opened(path) as file:
        begin = file.read(16)
    found = [known for bytes_, known in SIGNATURES.items() if begin.startswith(bytes_)]
    if not found or (found[0][0] == "WebP" and begin[8:12] != b"WEBP"):
        names = ", ".join(dict.fromkeys(name for name, _ in SIGNATURES.values()))
        raise OSError(f"{path}: the picture cannot be opened: it is none of {names}.")
    name, suffixes = found[0]
    cannot = f"{path}: the picture cannot be opened"
    if "?" in path.name:
        raise OSError(f"{cannot}: its name must not contain a question mark. Rename it.")
    if path.suffix.lower() not in suffixes:
        raise OSError(
            f"{cannot}: it is a {name} file, so its name must end in {' or '.join(suffixes)}. "
            "Rename it."
        )
    if name in (_PGM, _PPM):
        check_netpbm(path)


def complaint(source: Any) -> str:
    """The error message of OpenImageIO or of one of its files. It may quote bytes of the file."""
    try:
        return source.geterror().strip().split("\n")[0][:300]
    except UnicodeDecodeError:
        return "it is damaged"
