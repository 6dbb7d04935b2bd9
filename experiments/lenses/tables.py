"""How many directions a table needs: its rays and its pixels against the lens it was sampled from.

python experiments/lenses/tables.py
"""

import jax
import jax.numpy as jnp
import numpy as np


SIDE = 512
SAMPLES = (9, 17, 33, 65, 129)


def main():
    jax.config.update("jax_enable_x64", True)

    from gaussray.camera.lens import DoubleSphere, ray_table

    # 200 degrees across 512 pixels, within which errors count; the table goes on beyond the rim.
    half = jnp.deg2rad(118.0)
    xi, alpha = -0.2, 0.6
    unit = DoubleSphere(jnp.ones(2), jnp.zeros(2), jnp.array([xi, alpha]), half)
    focal = SIDE / 2 / unit.radius(jnp.deg2rad(100.0))
    middle = jnp.full(2, SIDE / 2)
    lens = DoubleSphere(jnp.full(2, focal), middle, unit.coefficients, half)
    look = jax.jit(jax.vmap(jax.vmap(lambda x, p: x.direction(p), (None, 0)), (None, 0)))
    image = jax.jit(jax.vmap(jax.vmap(lambda x, p: x.project(p), (None, 0)), (None, 0)))

    def cells(count):
        place = (jnp.arange(count) + 0.5) * SIDE / count
        return jnp.stack(jnp.meshgrid(place, place), -1)

    pixel = cells(150)
    truth = look(lens, pixel)
    print(f"{'directions':>12}{'angle, mean (px)':>20}{'largest':>10}{'there and back (px)':>22}")
    for count in SAMPLES:
        table = ray_table(look(lens, cells(count)), SIDE, SIDE)
        found = look(table, pixel)
        lit = (np.asarray(truth[..., 2]) > np.cos(np.deg2rad(100))) & np.any(truth != 0, axis=-1)
        lit &= np.any(found != 0, axis=-1)
        # A pixel in the middle is this many radians.
        error = np.linalg.norm(found - truth, axis=-1)[lit] * float(focal) / (1 + xi)
        back = np.abs(image(table, found) - pixel).max(axis=-1)[lit]
        print(f"{count:>8}^2{error.mean():>20.5f}{error.max():>10.5f}{back.max():>22.2e}")


if __name__ == "__main__":
    main()
