"""The common timestamps of all cameras, and the frame that each camera shows at each of them."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from gaussray.capture.frame_numbers import (
    FrameNumbers,
    evenly_numbered,
    frame_numbers,
)
from gaussray.prepare.errors import PrepareError
from gaussray.prepare.options import FramesOptions
from gaussray.prepare.sources import Source
from gaussray.prepare.sync import Sync
from gaussray.runtime.output import first_of
from gaussray.runtime.progress import say


# Timestamps per second of folders of pictures, which have no clock.
PICTURE_RATE = 30.0
# Pictures of videos of cameras that move, at most: of hundreds more, poses take hours and gain
# nothing.
MOST_OF_ONE = 200
# What to do if pictures are no photographs.
_IF_FRAMES = f"If these are frames of a video, give frames.rate={PICTURE_RATE:g}"
# Rates that differ by less than this share are equal.
_SAME = 2e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Timeline:
    """Timestamps and frames of a capture.

    Args:
        rate: timestamps per second; 0 for photographs, which have no time.
        times: seconds from the first timestamp on.
        frames: index of the frame of each camera at each timestamp.
        shifts: seconds by which that frame was exposed after its timestamp.
        numbers: how the pictures of the folders among the cameras belong together.
        clocks: seconds from the first timestamp of each frame of each camera, also of those that
            are not used; with `frames.span` of those within it alone.
    """

    rate: float
    times: Float[np.ndarray, " times"]
    frames: dict[str, Int[np.ndarray, " times"]]
    shifts: dict[str, Float[np.ndarray, " times"]]
    numbers: FrameNumbers = FrameNumbers()
    clocks: Mapping[str, Float[np.ndarray, " frames"]] = dataclasses.field(default_factory=dict)

    @property
    def is_static(self) -> bool:
        """Whether the pictures are photographs without a time."""
        return self.rate == 0


def common_timeline(sources: Sequence[Source], sync: Sync, options: FramesOptions) -> Timeline:
    """The timestamps that all cameras share, and the nearest frame of each camera at each of them.

    The shift of a frame against its timestamp, at most half a frame of its camera, is kept. Of a
    video that is alone, by a camera on its way, each k-th frame is used, so that they are at most
    MOST_OF_ONE. Folders of pictures alone share the numbers that all of them have
    (`frame_numbers`); beside videos, times at which a folder lacks a picture are left out.

    Args:
        sources: cameras of the input; one folder of pictures alone is photographs without a time,
            unless `frames.rate` says how many of them there are in a second.
        sync: offsets that take each camera's clock to the common one.
        options: rate of the timestamps (0: that of the slowest camera), and their span.

    Raises:
        PrepareError: The cameras share no time, no timestamp lies in `frames.span`, photographs
            have a span, or pictures of one camera with times have several sizes.
    """
    if len(sources) == 1 and not sources[0].is_video:
        if not options.rate:
            return _photographs(sources[0], options)
        _check_one_size(sources[0], options)
    # Whoever gives offsets, gives the times of the first pictures: their order counts.
    given = sync.method == "known"
    folders = [source for source in sources if not source.is_video]
    found = frame_numbers({} if given else {s.name: s.pictures for s in folders})
    clocks = {source.name: _clock(source, sync, options, found) for source in sources}
    rates = [source.rate or options.rate or PICTURE_RATE for source in sources]
    rate = options.rate or min(rates) / _stride(sources, min(rates), options)
    if found.common and len(found.times) == len(sources):
        grid = clocks[sources[0].name][found.places(sources[0].name)]
    else:
        grid = _even_grid(list(clocks.values()), rates, rate)
        half = 0.5 / (options.rate or PICTURE_RATE) + 1e-9
        for clock in (clocks[source.name] for source in folders):
            grid = grid[np.abs(clock[_nearest(clock, grid)] - grid) <= half]
    if not len(grid):
        spans = ", ".join(f"{n} {c[0]:.2f} to {c[-1]:.2f} s" for n, c in clocks.items())
        raise PrepareError(
            f"the videos must overlap in time, got {spans} after synchronisation. Give the right "
            "offsets as sync.offsets=[...], or sync.method=none if they start together."
        )
    whole, asked = grid - grid[0], clocks
    if options.span:
        first, last = (float(grid[0]) + seconds for seconds in options.span)

        def within_span(times: np.ndarray) -> np.ndarray:
            return times[(times >= first - 1e-9) & (times <= last + 1e-9)]

        grid = within_span(grid)
        asked = {name: within_span(clock) for name, clock in clocks.items()}
    if not len(grid):
        raise PrepareError(
            f"frames.span must lie in the common time of 0 to {whole[-1]:.2f} s, got "
            f"{list(options.span)}."
        )
    frames = {name: _nearest(clock, grid) for name, clock in clocks.items()}
    shifts = {name: clocks[name][index] - grid for name, index in frames.items()}
    asked = {name: clock - grid[0] for name, clock in asked.items()}
    return Timeline(rate, grid - grid[0], frames, shifts, found, asked)


def _photographs(source: Source, options: FramesOptions) -> Timeline:
    """The pictures of a folder without times."""
    if options.span:
        raise PrepareError(
            "frames.span must be [] for photographs of a scene that stands still, which have no "
            f"time, got {list(options.span)}. {_IF_FRAMES}."
        )
    zeros = np.zeros(source.count)
    return Timeline(0.0, zeros, {source.name: np.arange(source.count)}, {source.name: zeros})


def _check_one_size(source: Source, options: FramesOptions) -> None:
    """Refuse a folder of frames of several sizes."""
    if len(sizes := dict.fromkeys(source.sizes)) > 1:
        (a, b), *_, (c, d) = sizes
        raise PrepareError(
            f"{source.path}: frames of a video (frames.rate={options.rate:g}) must have one size, "
            f"got {a} x {b} and {c} x {d}. Take away those of other sizes; photographs of a scene "
            "that stands still need no frames.rate."
        )


def tell_numbers(sources: Sequence[Source], timeline: Timeline) -> None:
    """Say that pictures go together by the numbers in their names, where their order would not do.

    Args:
        sources: cameras of the input.
        timeline: their timestamps.
    """
    found = timeline.numbers
    if found.common:
        a, b = [source for source in sources if not source.is_video][:2]
        pair = (f"{s.name}/{s.pictures[found.places(s.name)[0]].name}" for s in (a, b))
        text = (
            f"{first_of(list(found.times))}: pictures go together by the numbers in their names "
            f"({' with '.join(pair)}), of which all folders have {len(found.common)}."
        )
        # Videos would lose their synchronisation.
        if len(found.times) == len(sources):
            offsets = str([0] * len(sources)).replace(" ", "")
            text += f" sync.offsets={offsets} pairs them by their order."
        say(text)


def tell_assumed_rate(
    sources: Sequence[Source], timeline: Timeline, options: FramesOptions
) -> None:
    """Say how pictures without a clock are taken: at which rate they follow each other, unless it
    is given, or that they are photographs of a scene that stands still.

    Args:
        sources: cameras of the input.
        timeline: their timestamps.
        options: the rate that the user has chosen, 0 for none.
    """
    folders = [source for source in sources if not source.is_video]
    if not folders or len(timeline.times) < 2:
        return
    if len(sources) == 1:
        _tell_one_folder(folders[0], timeline)
    elif not options.rate:
        several = len(folders) > 1
        say(
            f"{first_of([source.name for source in folders])}: "
            f"{'folders' if several else 'a folder'} of pictures without a "
            f"frame rate: {PICTURE_RATE:g} a second are assumed; frames.rate=... sets another."
        )


def _tell_one_folder(source: Source, timeline: Timeline) -> None:
    """Say that the pictures of the only folder are photographs, or frames of a video."""
    even = evenly_numbered(source.pictures)
    pair = " and ".join(path.name for path in source.pictures[:2])
    if timeline.is_static:
        names = f" Their names ({pair}) count as those of frames do." if even else ""
        say(
            f"{source.name}: {source.count} pictures are taken as photographs of a scene that "
            f"stands still.{names} {_IF_FRAMES}: else what moves is lost."
        )
        return
    order = "" if even else " The order of their names counts, and not the numbers in them."
    say(
        f"{source.name}: {source.count} pictures are taken as frames of a video by one camera, "
        f"{timeline.rate:.6g} a second.{order}"
    )


def _stride(sources: Sequence[Source], rate: float, options: FramesOptions) -> int:
    """Of so many frames of a video that is alone, one is used; 1 for several videos."""
    if len(sources) > 1:
        return 1
    count = sources[0].count
    if options.span:
        count = min(count, int((options.span[1] - options.span[0]) * rate) + 1)
    return -(-count // MOST_OF_ONE)


def moving_stride(
    sources: Sequence[Source], timeline: Timeline, still: Collection[str], options: FramesOptions
) -> int:
    """Of so many timestamps one is used, so that the pictures of all cameras that move, each of
    which needs a pose, are at most MOST_OF_ONE; 1 if `frames.rate` is given.

    Folders of pictures are what the user has chosen: they count only beside videos that move.

    Args:
        sources: cameras of the input.
        timeline: their timestamps.
        still: names of the cameras that stand still.
        options: the rate that the user has chosen, 0 for none.
    """
    moving = [source for source in sources if source.name not in still]
    if options.rate or not any(source.is_video for source in moving):
        return 1
    most = max(MOST_OF_ONE // len(moving), 1)
    return -(-len(timeline.times) // most)


def thinned_timeline(timeline: Timeline, stride: int) -> Timeline:
    """Each k-th timestamp, with the frames and shifts of all cameras at it.

    Args:
        timeline: all timestamps.
        stride: k.
    """
    return dataclasses.replace(
        timeline,
        rate=timeline.rate / stride,
        times=timeline.times[::stride],
        frames={name: frames[::stride] for name, frames in timeline.frames.items()},
        shifts={name: shifts[::stride] for name, shifts in timeline.shifts.items()},
    )


def of_one_rate(sources: Sequence[Source]) -> bool:
    """Whether all videos have one rate."""
    rates = [source.rate for source in sources if source.rate]
    return not rates or max(rates) / min(rates) - 1 <= _SAME


def resampled(sources: Sequence[Source], timeline: Timeline) -> list[str]:
    """Names of the videos whose rate is not that of the timestamps.

    Args:
        sources: cameras of the input.
        timeline: rate of the timestamps.
    """
    return [s.name for s in sources if s.rate and abs(s.rate / timeline.rate - 1) > _SAME]


def _clock(
    source: Source, sync: Sync, options: FramesOptions, found: FrameNumbers
) -> Float[np.ndarray, " frames"]:
    """Common time of each frame of a camera."""
    if source.is_video:
        return source.times + sync.offsets[source.name]
    counts = found.times[source.name] if found.common else np.arange(source.count)
    return np.array(counts) / (options.rate or PICTURE_RATE) + sync.offsets[source.name]


def _even_grid(
    clocks: Sequence[np.ndarray], rates: Sequence[float], rate: float
) -> Float[np.ndarray, " times"]:
    """Evenly spaced times that all cameras share; none if they share none.

    Args:
        clocks: common time of each frame of each camera.
        rates: frames per second of each camera, of each of which half a frame counts at its ends.
        rate: timestamps per second.
    """
    slack = [0.495 / own for own in rates]
    begin = max(float(clock[0]) - half for clock, half in zip(clocks, slack, strict=True))
    end = min(float(clock[-1]) + half for clock, half in zip(clocks, slack, strict=True))
    # The grid goes through the frames of the slowest camera, which then shows each frame once.
    slowest = clocks[int(np.argmin(rates))]
    shared = slowest[(slowest >= begin) & (slowest <= end)]
    start = float(shared[0]) if len(shared) else begin
    return start + np.arange(max(int(np.floor((end - start) * rate)) + 1, 0)) / rate


def _nearest(
    clock: Float[np.ndarray, " frames"], grid: Float[np.ndarray, " times"]
) -> Int[np.ndarray, " times"]:
    after = np.clip(np.searchsorted(clock, grid), 1, max(len(clock) - 1, 1))
    if len(clock) == 1:
        return np.zeros(len(grid), int)
    return np.where(grid - clock[after - 1] <= clock[after] - grid, after - 1, after)
