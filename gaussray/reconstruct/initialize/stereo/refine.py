"""Refinement: planes spread from pixel to pixel, and each is moved and turned while that helps."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gaussray.geometry import normalize
from gaussray.reconstruct.initialize.stereo.cost import (
    Comparison,
    best_half,
    comparison,
    misses,
    patch_cost,
    window,
)
from gaussray.reconstruct.initialize.stereo.options import StereoOptions
from gaussray.reconstruct.initialize.stereo.pixel_list import PixelList
from gaussray.reconstruct.initialize.stereo.sweep import DepthCandidates, DepthLevels
from gaussray.reconstruct.initialize.stereo.views import (
    StereoViews,
    sampled,
    seen_at,
    turned,
    unpacked,
)


# Windows may be seen this many times larger or smaller by a neighbour.
_STRETCH = 4.0
# A plane that is seen at less than this cosine is not tried.
_GRAZING = 0.1


class Surface(NamedTuple):
    """A view's surface: per pixel the inverse distance along its ray, the normal in the world and
    the matching cost."""

    inverse: Float[Array, "h w"]
    normal: Float[Array, "3 h w"]
    cost: Float[Array, "h w"]


def moves(rounds: int) -> Float[np.ndarray, "moves 5"]:
    """The changes that are tried one after the other at every pixel, a row of numbers each.

    A row is the offset (rows, columns) of the pixel whose plane is taken, the change of its inverse
    distance in steps of the sweep, and the tangents of the angles by which its normal is turned
    towards two directions perpendicular to it.
    """
    table = []
    spans = ((1, 4, 12, 32), (1, 2, 6, 18), (1, 3, 9), (1, 2, 5))
    for k in range(rounds):
        for span in spans[k % len(spans)]:
            table += [
                (span, 0, 0, 0, 0),
                (-span, 0, 0, 0, 0),
                (0, span, 0, 0, 0),
                (0, -span, 0, 0, 0),
            ]
        shift, turn = 0.5 / 2**k, np.tan(np.radians(30)) / 2**k
        table += [(0, 0, s, 0, 0) for s in (-shift, shift, -shift / 2, shift / 2)]
        table += [(0, 0, 0, turn, 0), (0, 0, 0, -turn, 0), (0, 0, 0, 0, turn), (0, 0, 0, 0, -turn)]
        table += [(0, 0, s, 0, 0) for s in (-shift / 4, shift / 4, -shift / 8, shift / 8)]
    return np.array(table, np.float64)


def refine(
    own: StereoViews,
    ray: Float[Array, "3 h w"],
    near: StereoViews,
    candidates: DepthCandidates,
    levels: DepthLevels,
    pixels: PixelList,
    options: StereoOptions,
) -> Surface:
    """The best plane of every listed pixel: the candidates first, then the `moves`, each kept where
    it costs less (PatchMatch stereo, Bleyer et al. 2011, in which all pixels move at once). Other
    pixels keep their best candidates.

    Args:
        own: the view whose surface is looked for.
        ray: unit viewing directions of its pixels in the world; zero where the lens has none.
        near: its neighbours.
        candidates: distances and normals to start from, at the size of its picture.
        levels: inverse distances of the sweep: moves stay between them and are counted in steps.
        pixels: the pixels that are refined.
        options: number of rounds, size of the windows, and the cost's weights.
    """
    patch = _Patch(own, ray, near, pixels, options)
    last = levels.first + (levels.count - 1) * levels.step

    def with_cheaper(surface: Surface, hypothesis):
        """The surface with the planes that `hypothesis` names for each part, where they cost
        less."""

        def one(k, result):
            inverse, normal, allowed = hypothesis(k)
            cost = jnp.where(allowed, patch.cost(k, inverse, normal), 2)
            before = jax.tree.map(lambda x: pixels.part(k, x), surface)
            after = _better(before, inverse, normal, cost)
            return jax.tree.map(lambda x, part: pixels.with_part(k, x, part), result, after)

        return jax.lax.fori_loop(0, pixels.parts, one, surface)

    def pick(surface: Surface, candidate):
        def hypothesis(k):
            return *(pixels.part(k, x) for x in candidate), True

        return with_cheaper(surface, hypothesis), None

    def move(surface: Surface, change):
        def hypothesis(k):
            inverse, normal = _moved(surface, patch.ray, pixels, k, change, levels.step, own)
            facing = -jnp.sum(normal * pixels.part(k, patch.ray), axis=0)
            allowed = (inverse >= levels.first) & (inverse <= last) & (facing > _GRAZING)
            return inverse, normal, allowed

        return with_cheaper(surface, hypothesis), None

    inverse, normal = (pixels.listed(x) for x in (candidates.inverse, candidates.normal))
    surface = Surface(inverse[0], normal[0], 0 * inverse[0] + 2)
    surface, _ = jax.lax.scan(pick, surface, (inverse, normal))
    table = jnp.asarray(moves(options.rounds), ray.dtype)
    surface, _ = jax.lax.scan(move, surface, table)
    swept = Surface(*(x[0] for x in candidates))
    return jax.tree.map(pixels.picture, surface, swept)


def _better(surface, inverse, normal, cost):
    """The surface with what costs less."""
    lower = cost < surface.cost
    return Surface(
        jnp.where(lower, inverse, surface.inverse),
        jnp.where(lower[None], normal, surface.normal),
        jnp.minimum(cost, surface.cost),
    )


def _moved(surface, rays, pixels, k, change, step, own):
    """Inverse distance and normal of the hypothesis that a move makes of the surface, for the
    pixels of a part."""
    h, w = own.size
    row, column = jnp.divmod(pixels.part(k, pixels.pixel), w)
    offset = change[:2].astype(jnp.int32)
    row, column = jnp.clip(row + offset[0], 0, h - 1), jnp.clip(column + offset[1], 0, w - 1)
    slot = pixels.slot.reshape(-1)[row * w + column]
    normal, its_ray, ray = surface.normal[:, slot], rays[:, slot], pixels.part(k, rays)
    # The plane through the other pixel's point, met by this pixel's ray: 1/t = 1/t' (n r)/(n r').
    facing = jnp.sum(normal * its_ray, axis=0)
    along = jnp.sum(normal * ray, axis=0)
    inverse = surface.inverse[slot] * along / jnp.where(facing < -1e-6, facing, -1)
    inverse = inverse + change[2] * step
    first, second = _tangents(normal, own.world_from_camera)
    return inverse, normalize_first(normal + change[3] * first + change[4] * second)


def _tangents(normal, axes):
    """Two directions perpendicular to a normal and to each other (Duff et al. 2017), built in the
    camera's axes, so that they turn with the camera."""
    x, y, z = turned(axes.T, normal)
    sign = jnp.where(z < 0, -1.0, 1.0).astype(normal.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x])
    second = jnp.stack([b, sign + y * y * a, -y])
    return turned(axes, first), turned(axes, second)


def normalize_first(vector: Float[Array, "3 ..."]) -> Float[Array, "3 ..."]:
    """Unit vectors, components first."""
    return jnp.moveaxis(normalize(jnp.moveaxis(vector, 0, -1)), -1, 0)


class _Patch:
    """The windows of a view's listed pixels, to be compared with its neighbours' on any planes."""

    def __init__(self, own, ray, near, pixels, options):
        self.own, self.near, self.pixels, self.options = own, near, pixels, options
        side = np.arange(-options.radius, options.radius + 1)
        rows, columns = np.meshgrid(side, side, indexing="ij")
        # Every second pixel, as on a chess board, tells as much as all.
        keep = (rows + columns) % 2 == 0
        self.taps = jnp.asarray(np.stack([rows[keep], columns[keep]], axis=-1), jnp.int32)
        padded = jnp.pad(ray, ((0, 0), (1, 1), (1, 1)), mode="edge")
        right = _where_formed(padded[:, 1:-1, 2:], padded[:, 1:-1, :-2], ray)
        down = _where_formed(padded[:, 2:, 1:-1], padded[:, :-2, 1:-1], ray)
        self.ray, self.right, self.down = (pixels.listed(x) for x in (ray, right, down))
        self.packed = self._listed_windows()
        self.reference = self._mean(lambda _, packed: window(self._color(packed)), self.packed)

    def _listed_windows(self):
        """The packed pixels [taps, slots] of the windows about the listed ones."""
        h, w = self.own.size
        row, column = jnp.divmod(self.pixels.pixel, w)
        row = jnp.clip(row[None] + self.taps[:, :1], 0, h - 1)
        column = jnp.clip(column[None] + self.taps[:, 1:], 0, w - 1)
        return self.own.pixel.reshape(-1)[row * w + column]

    def cost(self, k, inverse, normal):
        """Cost of one plane at every pixel of a part."""
        own = tuple(self.pixels.part(k, x) for x in (self.ray, self.right, self.down))
        formed = jnp.any(own[0] != 0, axis=0) & (inverse > 0)
        distance = 1 / jnp.where(formed, inverse, 1)
        # The map of a window's pixels into a neighbour is linear, with the slopes that the places
        # of two points beside the window's middle give.
        (x, y, sees), right, down = (
            seen_at(self.near, self._on_plane(own[0], ray, distance, normal)) for ray in own
        )
        slopes = [
            jnp.where(inside, beside - middle, 0)
            for *places, inside in (right, down)
            for beside, middle in zip(places, (x, y), strict=True)
        ]
        area = jnp.abs(slopes[0] * slopes[3] - slopes[1] * slopes[2])
        sees = sees & formed[None] & (area < _STRETCH**2) & (area > _STRETCH**-2)
        reference = jax.tree.map(lambda x: self.pixels.part(k, x)[None], self.reference)
        cost = patch_cost(reference, self._compared(k, x, y, slopes), self.options)
        _, hit = sampled(self.near.pixel, x, y)
        if not self.options.silhouette:
            return best_half(cost, sees & hit)
        return misses(best_half(cost, sees), sees, hit, self.options.silhouette)

    def _on_plane(self, middle, ray, distance, normal):
        """Where a ray beside a pixel's own meets the pixel's plane."""
        own = jnp.sum(normal * middle, axis=0)
        other = jnp.sum(normal * ray, axis=0)
        ratio = jnp.clip(own / jnp.where(other < -1e-3, other, -1e-3), 0.3, 3)
        return self.own.origin[:, None] + ray * (distance * ratio)[None]

    def _compared(self, k, x, y, slopes) -> Comparison:
        """What the neighbours show of the windows about these places."""
        h, w = self.own.size
        right_x, right_y, down_x, down_y = slopes

        def tap(place, packed):
            row, column = place
            u = jnp.clip(x + right_x * column + down_x * row, 0.5, w - 0.5)
            v = jnp.clip(y + right_y * column + down_y * row, 0.5, h - 0.5)
            color, _ = sampled(self.near.pixel, u, v)
            return comparison(tuple(c[None] for c in self._color(packed)), color)

        return self._mean(tap, self.pixels.part(k, self.packed))

    def _mean(self, tap, packed):
        """Mean of what `tap` says of every place of a window and the packed pixels there."""
        kind = jax.eval_shape(tap, self.taps[0], packed[0])
        # From `packed`, as in the sweep: the loop is traced once.
        empty = jax.tree.map(
            lambda like: jnp.broadcast_to(0 * packed[0], like.shape).astype(like.dtype), kind
        )

        def add(whole, place):
            return jax.tree.map(jnp.add, whole, tap(*place)), None

        whole, _ = jax.lax.scan(add, empty, (self.taps, packed), unroll=self.options.places)
        return jax.tree.map(lambda value: value / len(self.taps), whole)

    def _color(self, packed):
        return unpacked(packed, self.ray.dtype)[0]


def _where_formed(ahead, behind, ray):
    """The ray one pixel further, by half the difference of both neighbours; the ray itself where
    the lens forms one of them not."""
    formed = jnp.any(ahead != 0, axis=0) & jnp.any(behind != 0, axis=0)
    return jnp.where(formed[None], ray + (ahead - behind) / 2, ray)
