"""A room of textured quads and its true cameras, to prepare videos and pictures of."""

from fractions import Fraction

import av
import numpy as np

from gaussray.dataset.images import write_image


SIZE = (320, 240)
FOCAL = 300.0
RATE = 15.0
_TEXELS = 256
# Centre, half edges along the two sides, of each quad: floor, two walls, three boxes' faces.
_QUADS = (
    ((0, 0, 0), (4, 0, 0), (0, 4, 0)),
    ((0, 4, 2), (4, 0, 0), (0, 0, 2)),
    ((-4, 0, 2), (0, 4, 0), (0, 0, 2)),
    ((1.2, 1.5, 0.7), (0.8, 0.3, 0), (0, 0, 0.7)),
    ((-1.5, 1.0, 0.6), (0.6, -0.4, 0), (0, 0, 0.6)),
    ((0.2, 2.6, 1.0), (0.9, 0.1, 0), (0, 0, 1.0)),
)


def textures(seed=0):
    """Levels [quad, t, t, 3] with structure at every scale, so that features are found."""
    rng, result = np.random.default_rng(seed), []
    for _ in _QUADS:
        levels = np.zeros((_TEXELS, _TEXELS, 3))
        for size in (8, 16, 32, 64, 128):
            noise = rng.normal(size=(size, size, 3))
            levels += np.kron(noise, np.ones((_TEXELS // size, _TEXELS // size, 1)))
        result.append(np.clip(128 + 30 * levels, 0, 255))
    return np.array(result)


def looking(place, target=(0, 1.5, 0.8)):
    """World to camera [3, 4] of a camera that looks at a target, OpenCV axes, z up in the world."""
    place = np.array(place, float)
    forward = np.array(target, float) - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(forward, right), forward])
    return np.column_stack([turn, -turn @ place])


def arc(count, first=-35, last=35, distance=5.0):
    """Cameras on an arc about the middle of the room, high and low in turn."""
    angles = np.radians(np.linspace(first, last, count))
    heights = [1.6 if k % 2 else 2.2 for k in range(count)]
    return [
        looking((distance * np.sin(a), 1.5 - distance * np.cos(a), h))
        for a, h in zip(angles, heights, strict=True)
    ]


def picture(pose, painted, mover=None, gain=1.0, focal=FOCAL, size=SIZE, fisheye=False):
    """8-bit levels of the room; `mover` is the place of a bright quad that moves.

    A fisheye is equidistant.
    """
    width, height = size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([(x - width / 2) / focal, (y - height / 2) / focal, np.ones_like(x)], -1)
    if fisheye:
        angle = np.linalg.norm(rays[..., :2], axis=-1, keepdims=True)
        rays = np.concatenate([np.sinc(angle / np.pi) * rays[..., :2], np.cos(angle)], -1)
    directions, origin = rays @ pose[:, :3], -pose[:, :3].T @ pose[:, 3]
    quads, images = list(_QUADS), list(painted)
    if mover is not None:
        quads.append((mover, (0.5, 0, 0), (0, 0, 0.5)))
        images.append(255 - painted[0][::2, ::2].repeat(2, 0).repeat(2, 1))
    depth, levels = np.full(x.shape, np.inf), np.full((*x.shape, 3), 90.0)
    for (centre, side, up), image in zip(quads, images, strict=True):
        side, up = np.array(side, float), np.array(up, float)
        normal = np.cross(side, up)
        across = directions @ normal
        toward = np.where(np.abs(across) > 1e-9, across, np.inf)
        t = ((np.array(centre) - origin) @ normal) / toward
        local = origin + t[..., None] * directions - np.array(centre)
        u, v = local @ side / (side @ side), local @ up / (up @ up)
        hit = (t > 0) & (t < depth) & (np.abs(u) <= 1) & (np.abs(v) <= 1)
        i = np.clip(((v + 1) / 2 * _TEXELS).astype(int), 0, _TEXELS - 1)
        j = np.clip(((u + 1) / 2 * _TEXELS).astype(int), 0, _TEXELS - 1)
        levels, depth = np.where(hit[..., None], image[i, j], levels), np.where(hit, t, depth)
    light = gain * (levels / 255) ** 2.2
    return (255 * np.clip(light, 0, 1) ** (1 / 2.2) + 0.5).astype(np.uint8)


_RNG = np.random.default_rng(5)
_HOPS, _PLACES = np.cumsum(_RNG.uniform(0.3, 1.2, 40)), _RNG.uniform(-1.2, 1.2, 41)


def mover_at(time):
    """Where the moving quad is: it hops at irregular times, in a quarter of a second."""
    k = int(np.searchsorted(_HOPS, time))
    before, start = (_PLACES[k - 1], _HOPS[k - 1]) if k else (_PLACES[0], 0.0)
    share = np.clip((time - start) / 0.25, 0, 1)
    return (float(before + (_PLACES[k] - before) * share), 0.2, 1.2)


def write_video(path, frames, rate=RATE, sound=None, sound_rate=16000):
    """An H.264 video, with a mono sound track if samples in -1..1 are given."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "12"}
        track = container.add_stream("aac", rate=sound_rate) if sound is not None else None
        for frame in frames:
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")):
                container.mux(packet)
        container.mux(stream.encode())
        if track is not None:
            samples = np.asarray(sound, np.float32)[None]
            whole = av.AudioFrame.from_ndarray(samples, format="fltp", layout="mono")
            whole.sample_rate = sound_rate
            container.mux(track.encode(whole))
            container.mux(track.encode())


def write_pictures(folder, poses, painted):
    """A PNG of each pose."""
    for k, pose in enumerate(poses):
        write_image(folder / f"{k:03d}.png", picture(pose, painted))
