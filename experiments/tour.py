# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A tour in ten cells
#
# A scene in, a camera put together from its parts, pictures and exact labels out. The scene comes
# with the package; nothing is trained. `experiments/tour.ipynb` is the same as a notebook, made
# by `jupytext --to ipynb experiments/tour.py`.

# %%
import dataclasses

import jax
import jax.numpy as jnp

from gaussray import at, load_scene
from gaussray.render.rig.view_files import load_views
from gaussray.io.sample_data import sample


scene = load_scene(sample("scene"))
print(f"{scene.static.count} Gaussians stand still, {scene.moving.count} move")

# %% [markdown]
# A scene is a pytree: Gaussians that stand still, Gaussians that move, and a field that says how.
# At an instant it is plain Gaussians.

# %%
now = jax.jit(at)(scene, jnp.float32(0.4))
print(now.mean.shape, now.quat.shape, now.scale.shape, now.opacity.shape, now.harmonics.shape)

# %% [markdown]
# A camera is film, lens, aperture, shutter and trajectory. These are the cameras the scene was
# filmed by; a small film is enough to look around.

# %%
from gaussray.camera.film import Film


camera = next(v.camera for v in load_views(sample("scene"), None) if v.camera_name == "cam13")
camera = dataclasses.replace(camera, film=Film(64, 64), time=jnp.float32(0.4))

# %% [markdown]
# Lenses are objects with `direction` (pixel to ray) and `project` (point to pixel). One for this
# film, by the keys that the command has.

# %%
from gaussray.render.rig.lens import LensOptions, build_lens


pinhole = build_lens(camera.film, LensOptions("pinhole", fov=65.0))
fisheye = build_lens(camera.film, LensOptions("equisolid", fov=180.0))
print(fisheye.direction(jnp.array([60.0, 32.0])), pinhole.direction(jnp.array([60.0, 32.0])))

# %% [markdown]
# A renderer measures the scene once and films any camera. A frame holds linear light.

# %%
from gaussray.render import Renderer, RenderOptions


render = Renderer(scene, options=RenderOptions(samples=2))
plain = render(dataclasses.replace(camera, lens=pinhole))
print(plain.color.shape, float(plain.color.mean()))

# %% [markdown]
# Everything at once: a fisheye, an opening that focuses on a sphere, rows read one after another
# and exposed.

# %%
from gaussray.camera.aperture import Aperture
from gaussray.camera.shutter import Shutter


number = jnp.float32
aperture = Aperture(number(0.06), number(2.5), number(0), number(1), focus="sphere")
shutter = Shutter(number(-0.1), number(0.2 / 63), number(0.02))
real = dataclasses.replace(camera, lens=fisheye, aperture=aperture, shutter=shutter)
bent = render(real)

# %% [markdown]
# Which instant did each row see? The camera knows, exactly.

# %%
from gaussray.camera.shutter import row_moments


moments = float(real.time) + row_moments(shutter, (64, 64))
print(f"from {moments[0]:.3f} to {moments[-1]:.3f}")

# %% [markdown]
# Light becomes a picture in the sensor: lens edge, exposure, colour filters, noise, digits.

# %%
from gaussray.camera.sensor.noise import add_noise


counted = add_noise(jax.random.key(0), jnp.asarray(plain.color), full_well=5000.0, read_noise=3.0)
print(f"noise: {float(jnp.std(counted - plain.color)):.4f} of white")

# %% [markdown]
# All of it is differentiable: how does the way of a pixel change with the focal length?


# %%
def sideways(scale):
    longer = dataclasses.replace(pinhole, focal=scale * pinhole.focal)
    return longer.direction(jnp.array([60.0, 32.0]))[0]


print("d direction / d log focal:", float(jax.grad(sideways)(1.0)))

# %% [markdown]
# Pictures are written as sRGB (PNG) or as linear light (EXR).

# %%
from gaussray.dataset.images import contact_sheet, write_image


pictures = [plain.color, counted, bent.color]
sheet = contact_sheet([("", pictures)], titles=["pinhole", "counted", "everything"])
write_image("tour.png", sheet)
