"""The cameras of an input folder: a video or a folder of pictures each."""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gaussray.capture.video_file import open_video, upright, video_stream
from gaussray.capture.video_times import picture_ticks
from gaussray.capture.videos import VIDEO_SUFFIXES
from gaussray.io.natural_order import natural_order
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.first_picture import FirstPicture, first_picture
from gaussray.prepare.input_files import (
    MEDIA_SUFFIXES,
    camera_folders,
    files_in,
    photographs_in,
    unread_files,
    warn_of_input,
)
from gaussray.prepare.names_of_cameras import pictures_by_camera
from gaussray.prepare.panels.find import warn_of_panels
from gaussray.prepare.photographs import PHOTOGRAPH_SUFFIXES, photograph_size
from gaussray.prepare.unused_inputs import (
    camera_videos,
    check_one_video,
    tell_deeper,
    warn_of_unused,
    without_fewer,
)
from gaussray.runtime.output import counted, first_of
from gaussray.runtime.progress import say


# Intervals of a video may differ from their median by this share of it.
_EVEN = 0.25
# Cameras that a message names.
_NAMED = 3
# A folder with so many times as many pictures as another may not be one of the same cameras.
_UNEQUAL = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Source:
    """One camera of the input.

    Args:
        name: name of the camera: that of its video or folder.
        path: the video or the folder.
        pictures: the files of a folder in natural order; empty for a video.
        times: seconds of each frame on the camera's own clock; empty for pictures, which have none.
        sizes: columns and rows of each upright picture; of a video, whose frames have one size,
            a single pair.
        has_sound: the video has a sound track.
        first: what the first picture of a video tells; None of pictures.
    """

    name: str
    path: Path
    pictures: tuple[Path, ...]
    times: Float[np.ndarray, " frames"]
    sizes: tuple[tuple[int, int], ...]
    has_sound: bool = False
    first: FirstPicture | None = None

    @property
    def is_video(self) -> bool:
        """Whether the camera is a video."""
        return not self.pictures

    @property
    def width(self) -> int:
        """Columns of the first upright picture. Only photographs without a time may differ."""
        return self.sizes[0][0]

    @property
    def height(self) -> int:
        """Rows of the first upright picture. Only photographs without a time may differ."""
        return self.sizes[0][1]

    def size(self, frame: int) -> tuple[int, int]:
        """Columns and rows of an upright frame.

        Args:
            frame: index of the frame.
        """
        return self.sizes[0 if self.is_video else frame]

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.pictures) or len(self.times)

    @property
    def rate(self) -> float:
        """Frames per second; 0 for pictures."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0

    @property
    def is_even(self) -> bool:
        """Whether the frames are evenly spaced in time, as readers of captures demand."""
        steps = np.diff(self.times)
        return len(steps) < 1 or bool(np.ptp(steps) <= 2 * _EVEN * np.median(steps))


def find_sources(folder: Path | str) -> list[Source]:
    """The cameras of an input folder, in the natural order of their names; or that of a video.

    A camera is a video in the folder, a subfolder of pictures, or a subfolder with one video. A
    folder that holds nothing but pictures, or a single folder of pictures, is one camera; these may
    have several sizes. If the names of its pictures say cameras and times, as
    `cam_0_img_0008.jpg` does, it is these cameras. Pictures beside subfolders are used if they are
    more than those in them. A warning tells which are not. `cam0_mask.mp4` beside `cam0.mp4` holds
    its masks, and is no camera.

    Raises:
        FileNotFoundError: The folder does not exist.
        PrepareError: The folder holds neither videos nor pictures, or two cameras of one name.
    """
    folder = Path(folder)
    if folder.is_file():
        if folder.suffix.lower() in VIDEO_SUFFIXES:
            return _told_of_panels([_video(folder.stem, folder)])
        raise PrepareError(
            f"videos={folder}: must be a video or the folder of the videos or pictures, got "
            "another file. Put it into a folder of its own, and name that."
        )
    if not folder.is_dir():
        raise FileNotFoundError(f"videos={folder}: the folder does not exist.")
    videos, beside = camera_videos(folder), photographs_in(folder)
    inside = camera_folders(folder, alone=not videos and not beside)
    if not videos:
        inside = without_fewer(folder, beside, inside)
    sources = [_video(path.stem, path) for path in videos]
    # Photographs in one folder alone are of a single camera, unless their names say several.
    alone = not videos and sum(bool(files_in(p, MEDIA_SUFFIXES)) for p in inside) == 1
    check_one_video(inside)
    for inner in inside:
        sources += _inner_sources(inner, alone)
    if sources and beside:
        warn_of_unused(folder, beside, [source.name for source in sources])
    sources = sources or _photographs(folder, beside)
    unread = [path.name for place in (folder, *inside) for path in unread_files(place)]
    if sources and unread:
        warn_of_input(
            f"videos={folder}: {len(unread)} files of formats that are not read "
            f"({', '.join(unread[:_NAMED])}) are left out. Convert them to MP4 or JPEG if they "
            "are meant."
        )
    _check_sources(folder, sources, unread)
    tell_deeper(folder, inside)
    _warn_of_counts(folder, sources)
    return _told_of_panels(sorted(sources, key=lambda source: natural_order(Path(source.name))))


def _told_of_panels(sources: list[Source]) -> list[Source]:
    """The cameras, with a warning of each video that seems to hold several views or maps."""
    firsts = {source.path: source.first.panels for source in sources if source.first is not None}
    warn_of_panels(list(firsts), list(firsts.values()))
    return sources


def _check_sources(folder: Path, sources: list[Source], unread: list[str]) -> None:
    """Refuse an input without cameras, or with two of one name."""
    if not sources:
        deeper = next(
            (p for p in sorted(folder.glob("*/*")) if p.is_dir() and files_in(p, MEDIA_SUFFIXES)),
            None,
        )
        raise PrepareError(
            f"videos={folder}: must hold a video ({' '.join(VIDEO_SUFFIXES)}) or a folder of "
            f"pictures ({' '.join(PHOTOGRAPH_SUFFIXES)}) for each camera, got "
            + (f"{', '.join(unread[:_NAMED])}. Convert them." if unread else "none.")
            + (f" Did you mean videos={deeper}?" if deeper else "")
        )
    names = [source.name for source in sources]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        first, other = [source for source in sources if source.name == twice][:2]
        both = " and ".join(
            "the folder " * (not source.is_video) + str(source.path.relative_to(folder))
            for source in (first, other)
        )
        remedy = (
            f"If the folder {other.path.name} holds the frames of the video, move one of them out "
            "of the input; else rename one."
            if first.is_video and not other.is_video
            else "Rename one of them."
        )
        raise PrepareError(
            f"videos={folder}: each camera must have a name of its own, got {both}. {remedy}"
        )


def _warn_of_counts(folder: Path, sources: list[Source]) -> None:
    """Tell of folders that have far more pictures than others: cameras have as many as the least
    has, and one of them may be no camera."""
    counts = {source.name: source.count for source in sources if not source.is_video}
    few = min(counts, key=counts.__getitem__, default="")
    if counts and max(counts.values()) >= _UNEQUAL * counts[few]:
        many = max(counts, key=counts.__getitem__)
        warn_of_input(
            f"videos={folder}: {many} has {counted(counts[many], 'picture')} and {few} "
            f"{counts[few]}: as of cameras, at most {counts[few]} of each folder are used. Move "
            "folders that are no cameras out of the input; put photographs of a scene that stands "
            "still into one folder."
        )


def _video(name: str, path: Path) -> Source:
    if not path.stat().st_size:
        raise PrepareError(f"{path}: the video is an empty file. Copy it again, or take it away.")
    with open_video(path) as container:
        stream = video_stream(path, container)
        packets, picture = [], None
        for packet in container.demux(stream):
            if packet.size and not packet.is_discard and packet.pts is not None:
                packets.append((packet.pts, packet.size))
            if picture is None and (frame := next(iter(packet.decode()), None)) is not None:
                picture = upright(path, frame)
        ticks = picture_ticks(path, stream.codec_context.name, packets)
        times = np.array(ticks, np.float64) * float(stream.time_base)
        sound = bool(container.streams.audio)
    if picture is None or not len(times):
        raise PrepareError(f"{path}: the video must hold frames with times, got none.")
    height, width = picture.shape[:2]
    return Source(name, path, (), times, ((width, height),), sound, first_picture(picture))


def check_frames(source: Source, decoded: int) -> None:
    """Refuse a video that does not hold one picture for each of its times.

    Args:
        source: the video, with its times.
        decoded: number of pictures that were decoded.
    """
    if decoded != source.count:
        raise PrepareError(
            f"{source.path}: the video must hold a picture for each of its {source.count} times, "
            f"got {decoded} pictures. Encode it again: `ffmpeg -i IN -c:v libx264 OUT.mp4`."
        )


def _inner_sources(inner: Path, alone: bool) -> list[Source]:
    """The cameras of a subfolder: one, or several if it is alone and its pictures' names say so."""
    videos, pictures = camera_videos(inner), photographs_in(inner)
    if videos:
        return [_video(inner.name, videos[0])]
    return _photographs(inner, pictures) if alone else _camera(inner.name, inner, pictures)


def _photographs(folder: Path, pictures: list[Path]) -> list[Source]:
    """The camera of the only folder of pictures; the cameras that their names say, if they do."""
    named = pictures_by_camera(pictures)
    if named is None:
        return _camera(folder.name, folder, pictures, one_size=False)
    names = list(named.cameras)
    cameras = f"the pictures are of {len(names)} cameras ({first_of(names)})"
    if not named.together:
        warn_of_input(
            f"videos={folder}: by their names {cameras}, but they are taken as photographs of a "
            "scene that stands still. If they are not, put each camera's pictures into a folder "
            "of its own."
        )
        return _camera(folder.name, folder, pictures, one_size=False)
    times = len(named.cameras[names[0]])
    left = len(pictures) - times * len(names)
    say(
        f"videos={folder}: by their names {cameras} at {times} times"
        + (f"; {counted(left, 'other')} are left out" if left else "")
        + ". If they are photographs of a scene that stands still, rename them."
    )
    return [one for name, own in named.cameras.items() for one in _camera(name, folder, own)]


def _camera(name: str, folder: Path, pictures: list[Path], one_size: bool = True) -> list[Source]:
    """A camera of pictures, none if there are none. Photographs of a scene that stands still,
    which have no time, may have several sizes."""
    if not pictures:
        return []
    sizes = tuple(photograph_size(path) for path in pictures)
    other = next((k for k, size in enumerate(sizes) if size != sizes[0]), None)
    if other is not None and one_size:
        raise PrepareError(
            f"{pictures[other]}: the pictures of one of several cameras must have one size, got "
            f"{sizes[other]} after {sizes[0]}. Give the pictures of each size a folder of their "
            "own; put photographs of a scene that stands still into one folder."
        )
    return [Source(name, folder, tuple(pictures), np.zeros(0), sizes)]
