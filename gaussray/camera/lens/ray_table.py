"""A lens given as a table of viewing directions, for example from a measurement."""

import hashlib
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, DTypeLike, Float, Int

from gaussray.camera.film import Film
from gaussray.camera.lens.abstract import FocalLens, LensRecord
from gaussray.camera.lens.model import LensKeys, LensModel, LensOptions
from gaussray.camera.roots import plane_root
from gaussray.geometry import normalize, product
from gaussray.io.json_numbers import json_numbers
from gaussray.io.plain_values import to_device, vector
from gaussray.io.ray_map import read_ray_map
from gaussray.io.validate import require


# Directions in a table, along each side: every frame of a capture carries its lens.
_FEWEST, _MOST = 4, 513
# Of the table, this many along each side are compared with a point to begin Newton's steps there.
_GUESSES, _NEWTON_STEPS = 48, 8
# Largest angle (radians) between a point and the ray that Newton found for it.
_RESIDUAL = 1e-5


class RayTable(FocalLens):
    """Directions at every `focal` pixels, the first at pixel `center`, and smooth ones between.

    `rays` are unit vectors in camera axes (+x right, +y down, +z forward), zero where the lens
    forms none. Between them: bicubic (Catmull and Rom; in the outermost cells the cubic through the
    same four samples), made unit; black where one of these sixteen samples is zero, so a table
    should go on for two samples beyond the rim. The outermost samples are continued by one cell.
    The inverse begins at the nearest sample and is found by Newton's steps.
    """

    focal: Float[Array, "2"] = eqx.field(converter=vector("lens.focal", 2, spread=True))
    center: Float[Array, "2"] = eqx.field(converter=vector("lens.center", 2))
    rays: Float[Array, "rows columns 3"]

    fold_message: ClassVar[tuple[str, str]] = (
        "lens.file",
        "Smooth the table, or remove directions that occur twice.",
    )

    @property
    def sees_sideways(self) -> bool:
        lit = jnp.any(self.rays != 0, axis=-1)
        return bool(jnp.any(lit & (self.rays[..., 2] <= 0)))

    def record(self) -> LensRecord:
        rays = np.asarray(self.rays)
        name = f"lens_{hashlib.sha256(rays.tobytes()).hexdigest()[:12]}.npz"
        first, every = json_numbers(self.center), json_numbers(self.focal)
        block = {"model": "table", "file": name, "first": first, "every": every}
        return LensRecord({"lens": block}, {name: rays})

    def ray(self, xy: Float[Array, "2"]) -> Float[Array, "3"]:
        return jnp.where(self._lit(xy), _between(xy, self.rays), 0)

    def image(self, point: Float[Array, "3"]) -> tuple[Float[Array, "2"], Bool[Array, ""]]:
        toward = normalize(point)
        toward = jnp.where(jnp.any(toward != 0), toward, jnp.array([0, 0, 1], point.dtype))
        across = _across(toward)
        rows, columns = self.rays.shape[:2]
        skip = -(-rows // _GUESSES), -(-columns // _GUESSES)
        coarse = self.rays[:: skip[0], :: skip[1]]
        nearest = jnp.argmax(jnp.sum(coarse * toward[None, None], axis=-1))
        row, column = jnp.unravel_index(nearest, coarse.shape[:2])
        start = jnp.stack([column * skip[1], row * skip[0]]).astype(point.dtype)
        xy, has_ray = plane_root(
            _aside, jnp.zeros_like(start), (self.rays, across), start,
            steps=_NEWTON_STEPS, residual=_RESIDUAL,
        )  # fmt: skip
        ahead = jnp.sum(_between(xy, self.rays) * toward) > 0
        return xy, has_ray & ahead & self._lit(xy) & jnp.any(point != 0)

    def check_image(self) -> None:
        rays = np.asarray(self.rays, np.float64)
        for name, count in zip(("rows", "columns"), rays.shape, strict=False):
            if not _FEWEST <= count <= _MOST:
                raise ValueError(
                    f"lens.file must hold {_FEWEST} to {_MOST} {name} of directions, got {count}. "
                    "Keep every n-th: what lies between is interpolated smoothly."
                )
        length = np.linalg.norm(rays, axis=-1)
        rule = "unit vectors, or zero where there is no ray"
        require(
            "lens.file (lengths)", length[(length != 0) & ~(abs(length - 1) < 1e-4)][:3],
            lambda x: x == 0, rule,
        )  # fmt: skip
        corner = rays[:-1, :-1], rays[:-1, 1:], rays[1:, 1:], rays[1:, :-1]
        lit = np.all([np.any(x != 0, axis=-1) for x in corner], axis=0)
        if not lit.any():
            raise ValueError("lens.file must hold directions that are not zero, got none.")
        for i in range(4):
            here, after, before = corner[i], corner[(i + 1) % 4], corner[i - 1]
            turn = np.sum(here * np.cross(after, before), axis=-1)
            wrong = lit & ~(turn > 0)
            if wrong.any():
                row, column = np.argwhere(wrong)[0].tolist()
                raise ValueError(
                    "lens.file must be invertible: neighbouring pixels must look in different "
                    "directions that turn as they do (no fold, no mirror; +x right, +y down, +z "
                    f"forward), which fails at row {row}, column {column} of the table and "
                    f"{int(wrong.sum()) - 1} more. Smooth the table, or flip its axes."
                )

    def _lit(self, xy: Float[Array, "2"]) -> Bool[Array, ""]:
        """Whether the sixteen samples around an image point are rays; one cell beyond the outermost
        ones still counts as theirs."""
        last = jnp.array(self.rays.shape[1::-1], xy.dtype) - 1
        around = _window(self.rays, _cell(xy, self.rays.shape))
        return jnp.all(jnp.any(around != 0, axis=-1)) & jnp.all((xy >= -1) & (xy <= last + 1))


def ray_table(rays: Float[Array, "rows columns 3"], width: int, height: int) -> RayTable:
    """A lens from directions that cover a picture in equal cells.

    Args:
        rays: unit direction at the centre of each cell, OpenCV axes; zero where no light arrives.
            A table of height x width directions holds one per pixel centre.
        width, height: size of the picture in pixels.
    """
    every = jnp.array([width, height], rays.dtype) / jnp.array(rays.shape[1::-1], rays.dtype)
    return RayTable(every, every / 2, rays)


def _between(xy: Float[Array, "2"], rays: Float[Array, "rows columns 3"]) -> Float[Array, "3"]:
    """Unit direction at an image point, whatever its distance from the table."""
    cell = _cell(xy, rays.shape)
    column, row = (_cubic(x) for x in xy - cell.astype(xy.dtype))
    return normalize(product("i,j,ijk->k", row, column, _window(rays, cell)))


def _cell(xy: Float[Array, "2"], shape: tuple[int, ...]) -> Int[Array, "2"]:
    """Column and row of the first of the four samples along each side around an image point."""
    first = jnp.floor(jax.lax.stop_gradient(xy)).astype(jnp.int32) - 1
    return jnp.clip(first, 0, jnp.array([shape[1] - 4, shape[0] - 4], jnp.int32))


def _window(rays: Float[Array, "rows columns 3"], cell: Int[Array, "2"]) -> Float[Array, "4 4 3"]:
    """The samples that begin at a cell (column, row)."""
    return jax.lax.dynamic_slice(rays, (cell[1], cell[0], jnp.zeros_like(cell[0])), (4, 4, 3))


def _cubic(t: Float[Array, ""]) -> Float[Array, "4"]:
    """Weights of four samples at 0 ... 3: Catmull and Rom's between 1 and 2, elsewhere Lagrange's,
    with which the outermost cells stay as exact as the others."""
    u = t - 1
    middle = jnp.stack(
        [
            -u * (1 - u) ** 2,
            2 - 5 * u * u + 3 * u**3,
            u + 4 * u * u - 3 * u**3,
            -u * u * (1 - u),
        ]
    ) / 2  # fmt: skip
    outside = jnp.stack(
        [
            -(t - 1) * (t - 2) * (t - 3) / 6,
            t * (t - 2) * (t - 3) / 2,
            -t * (t - 1) * (t - 3) / 2,
            t * (t - 1) * (t - 2) / 6,
        ]
    )
    return jnp.where((t >= 1) & (t <= 2), middle, outside)


def _aside(xy: Float[Array, "2"], parameters: tuple[Array, Array]) -> Float[Array, "2"]:
    """How far the ray of an image point lies beside a direction, along the two axes across it."""
    rays, across = parameters
    return jnp.sum(across * _between(xy, rays)[None], axis=-1)


def _across(direction: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Two unit vectors that with a unit direction form a right-handed frame (Duff et al. 2017)."""
    x, y, z = direction
    sign = jnp.where(z < 0, -1, 1).astype(direction.dtype)
    a = -1 / (sign + z)
    b = x * y * a
    first = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x])
    return jnp.stack([first, jnp.stack([b, sign + y * y * a, -y])])


def _from_options(film: Film, options: LensOptions) -> RayTable:
    if not options.file:
        raise ValueError("lens.file must name a table of directions (.npz or .exr), got ''.")
    rays = to_device(read_ray_map(options.file), jnp.float32)
    return ray_table(rays, film.width, film.height)


def _from_keys(keys: LensKeys, block: LensKeys, dtype: DTypeLike) -> RayTable:
    path = block.path("file")
    if path is None:
        raise block.error("file", "a table of directions (.npz or .exr)")
    rays = to_device(read_ray_map(path), dtype)
    if not (block.has("first") or block.has("every")):
        return ray_table(rays, keys.count("w"), keys.count("h"))
    every, first = (to_device(block.vector(key, 2), dtype) for key in ("every", "first"))
    return RayTable(every, first, rays)


MODELS = (
    LensModel(
        name="table",
        label="ray_table",
        from_options=_from_options,
        block="table",
        from_keys=_from_keys,
        block_keys=("file", "first", "every"),
        any_size=False,
        option_keys=("file",),
    ),
)
