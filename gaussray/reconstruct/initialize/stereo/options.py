"""How carefully stereo matching looks, by device."""

from dataclasses import replace

import equinox as eqx


# Of pictures that show no motion on a GPU: pixels for each point, and points at most.
_PIXELS, _MOST_POINTS = 25, 250_000


class StereoOptions(eqx.Module):
    """Settings of stereo matching.

    A picture is reduced until it has at most `pixels`; of more than `views` pictures an even share
    is matched. Every view is compared with `neighbours` others at no more than `depths` distances
    (as many as steps of 2.5 pixels need), on spheres about the camera and on planes of `tilts`
    inclinations (degrees, four directions each), in pictures of half the size and windows of
    (2 `radius` + 1)^2 pixels. The `modes` best distances are refined at full size, in
    `rounds` rounds of propagation and search.

    A cost is `zncc` (1 - ZNCC) + (1 - `zncc`) min(colour difference / `color`, 1), at most 1, with
    ZNCC regularised by the noise of a picture (`noise`, of full scale). A point stays if it costs
    less than `cost` and at least `confirm` other views see a surface there. Of all, about `points`
    are kept, and `moving` of what moves at a timestamp. Where a view masks a point, it says
    nothing; with `silhouette` above 0 it counts against the point, by so much for each view beyond
    the first. As many views are matched at once as have `at_once` samples (pixels times
    neighbours): a GPU is not busy with one small picture. It also computes `levels` of the sweep,
    and `places` of a window, before it writes results to its memory. Where masks leave less than
    half of the pixels, these and those within two pixels of them are refined alone, in parts of
    `part` samples.
    """

    pixels: int = eqx.field(static=True, default=140_000)
    views: int = eqx.field(static=True, default=120)
    neighbours: int = eqx.field(static=True, default=8)
    depths: int = eqx.field(static=True, default=256)
    tilts: tuple[float, ...] = eqx.field(static=True, default=(45.0,))
    radius: int = eqx.field(static=True, default=2)
    modes: int = eqx.field(static=True, default=3)
    rounds: int = eqx.field(static=True, default=3)
    zncc: float = eqx.field(static=True, default=0.6)
    color: float = eqx.field(static=True, default=0.15)
    noise: float = eqx.field(static=True, default=0.015)
    cost: float = eqx.field(static=True, default=0.35)
    confirm: int = eqx.field(static=True, default=2)
    points: int = eqx.field(static=True, default=100_000)
    moving: int = eqx.field(static=True, default=25_000)
    silhouette: float = eqx.field(static=True, default=0.0)
    at_once: int = eqx.field(static=True, default=1)
    levels: int = eqx.field(static=True, default=1)
    places: int = eqx.field(static=True, default=1)
    part: int = eqx.field(static=True, default=2**13)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self):
        for name in (
            "pixels",
            "views",
            "neighbours",
            "depths",
            "radius",
            "modes",
            "points",
            "moving",
            "at_once",
            "levels",
            "places",
            "part",
        ):
            if getattr(self, name) < 1:
                raise ValueError(f"stereo.{name} must be at least 1, got {getattr(self, name)}.")
        for name in ("zncc", "cost"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"stereo.{name} must be in [0, 1], got {getattr(self, name)}.")


def options_for(platform: str, views: int, *, still_pixels: int = 0) -> StereoOptions:
    """Settings with which stereo takes seconds on a GPU or a minute and a half on two CPU cores.

    Args:
        platform: kind of the device, as JAX names it; all but cpu are GPUs.
        views: number of pictures; on a CPU more than 50 of them are reduced further.
        still_pixels: pixels of all pictures, if these show no motion: on a GPU, which has the time
            for as many Gaussians, each 25 of them may have a point.
    """
    if platform != "cpu":
        points = min(max(still_pixels // _PIXELS, StereoOptions().points), _MOST_POINTS)
        return StereoOptions(points=points, at_once=2**23, part=2**20, levels=2, places=4)
    # 50 views of 135 x 240 is what the time was measured with; more views get smaller pictures.
    pixels = int(min(33_000, max(12_000, 33_000 * 50 / max(views, 1))))
    return StereoOptions(
        pixels=pixels,
        views=80,
        neighbours=4,
        depths=160,
        tilts=(),
        modes=2,
        rounds=1,
        points=60_000,
        moving=15_000,
    )


def with_silhouette(options: StereoOptions) -> StereoOptions:
    """The settings for what moves: silhouettes count, and `moving` points are kept."""
    return replace(options, silhouette=0.12, points=options.moving)
