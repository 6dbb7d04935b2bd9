"""Videos that hold two views, side by side or one above the other, as stereo cameras write them."""

import warnings
from pathlib import Path
from shlex import quote

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import gaussian_filter1d

from gaussray.capture.errors import CaptureWarning


# Rows and columns to which a half is reduced, and how far its likeness to the other one is sought:
# disparities of a sixth of the width, and rows that are off by a few hundredths of the height. What
# repeats does so at any phase: a quarter of the height.
_ROWS, _COLUMNS = 64, 96
_UP, _ACROSS = 3, 16
_FAR_UP = 16
# Details are what is left without a blur of this width, in reduced pixels.
_BLUR = 4.0
# Correlation of the details of two views: 0.74 and more for those of a stereo endoscope and for
# neighbours in a light field, at most 0.62 for the halves of an ordinary picture. In the shape of
# ordinary pictures two views are narrowed and rare, and chessboards reach 0.83.
_ALIKE, _VERY_ALIKE = 0.65, 0.9
# That of their details along the axis of the cut alone: edges across it continue in the other half
# of any picture, and reach 0.25 there.
_ALONG = 0.4


def warn_of_two_views(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Warn of a video whose picture seems to hold two views of one scene, and tell how to cut it.

    The halves of such a picture are alike at a small shift. From 2:1 on, or higher than wide,
    they need be less alike than in the shape of an ordinary picture. Where the halves along the
    other axis are alike as well, the scene repeats itself (tiles, bricks, a chessboard).

    Args:
        path: the video, for the message.
        picture: its first frame, upright.
    """
    height, width = picture.shape[:2]
    for axis, likely in ((1, width >= 2 * height), (0, height > width)):
        if _are_alike(*_halves(picture, axis), axis, _ALIKE if likely else _VERY_ALIKE) and (
            not _is_repeated(*_halves(picture, 1 - axis))
        ):
            warnings.warn(_message(path, axis, likely), CaptureWarning, stacklevel=5)


def _message(path: Path, axis: int, likely: bool) -> str:
    if axis == 1:
        how, names, cuts = "side by side", ("left", "right"), ("iw/2:ih:0:0", "iw/2:ih:iw/2:0")
        whole = ",scale=2*iw:ih"
    else:
        how, names, cuts = (
            "one above the other",
            ("upper", "lower"),
            ("iw:ih/2:0:0", "iw:ih/2:0:ih/2"),
        )
        whole = ",scale=iw:2*ih"
    first, second = (
        f"`ffmpeg -i {quote(str(path))} -vf crop={cut}{'' if likely else whole} {name}.mp4`"
        for name, cut in zip(names, cuts, strict=True)
    )
    return (
        f"{path}: the picture looks like two views {how}, but the video of a camera must hold one. "
        f"Cut it by {first} and {second}, and put these in its place (or leave it, if it is one)."
    )


def _halves(
    picture: UInt8[np.ndarray, "h w 3"], axis: int
) -> tuple[Float[np.ndarray, "rows columns"], Float[np.ndarray, "rows columns"]]:
    """Both halves, reduced; empty ones of a picture that is smaller."""
    half = picture.shape[axis] // 2
    first, second = np.split(picture[..., 1].swapaxes(0, axis)[: 2 * half], 2)
    return _reduced(first.swapaxes(0, axis)), _reduced(second.swapaxes(0, axis))


def _reduced(half: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, "rows columns"]:
    rows, columns = half.shape[0] // _ROWS, half.shape[1] // _COLUMNS
    blocks = half[: rows * _ROWS, : columns * _COLUMNS].reshape(_ROWS, rows, _COLUMNS, columns)
    return blocks.mean(axis=(1, 3)) if rows and columns else np.zeros((0, 0))


def _are_alike(
    first: Float[np.ndarray, "rows columns"],
    second: Float[np.ndarray, "rows columns"],
    axis: int,
    least: float,
) -> bool:
    """Whether the details of two halves correlate, and those along the axis of the cut as well."""
    if not first.size:
        return False
    for axes, limit in (((0, 1), least), ((axis,), _ALONG)):
        if _correlation(_details(first, axes), _details(second, axes)) < limit:
            return False
    return True


def _is_repeated(
    first: Float[np.ndarray, "rows columns"], second: Float[np.ndarray, "rows columns"]
) -> bool:
    """Whether the details of two halves correlate at any shift."""
    both = (0, 1)
    return _correlation(_details(first, both), _details(second, both), _FAR_UP) >= _ALIKE


def _details(
    half: Float[np.ndarray, "rows columns"], axes: tuple[int, ...]
) -> Float[np.ndarray, "rows columns"]:
    blurred = half
    for axis in axes:
        blurred = gaussian_filter1d(blurred, _BLUR, axis=axis)
    return half - blurred


def _correlation(
    first: Float[np.ndarray, "rows columns"],
    second: Float[np.ndarray, "rows columns"],
    most_up: int = _UP,
) -> float:
    """The largest normalised correlation of two halves over all shifts; 0 if one is plain."""
    rows, columns = first.shape
    best = 0.0
    for up in range(-most_up, most_up + 1):
        for across in range(-_ACROSS, _ACROSS + 1):
            a = first[max(up, 0) : rows + min(up, 0), max(across, 0) : columns + min(across, 0)]
            b = second[max(-up, 0) : rows - max(up, 0), max(-across, 0) : columns - max(across, 0)]
            a, b = a - a.mean(), b - b.mean()
            # Halves without details of a grey level correlate by their noise.
            if min(a.std(), b.std()) >= 1:
                best = max(best, float((a * b).mean() / (a.std() * b.std())))
    return best
