"""The measured sizes of lists, counted by hand: Gaussians that cover the whole picture are in the
list of every bundle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.render.camera_layout import pack_camera
from gaussray.render.compiled import ProgramSettings
from gaussray.render.list_sizes import NO_LISTS, default_capacity
from gaussray.render.measured_capacity import single_program_capacity, staged_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import whole_picture
from gaussray.scene.scene import Scene


# Pictures of 16 x 16 in bundles of 8 x 8.
BUNDLES = 4
SETTINGS = ProgramSettings(NO_LISTS, 1, RenderOptions(samples=1), toy.TRACE, None)
CAMERA = toy.records()[0].camera


def covering(count, behind=0):
    """Gaussians as large as the room, and small ones behind the camera."""
    ahead, away = np.zeros((count, 3)), np.full((behind, 3), 1e3)
    scale = np.concatenate([np.full(count, 2.0), np.full(behind, 0.01)])
    return Scene(toy.gaussians(np.concatenate([ahead, away]), scale, (0.5, 0.5, 0.5)))


@pytest.mark.parametrize(("headroom", "pairs", "slots"), [(1.0, 128, 32), (2.0, 256, 64)])
def test_one_program_needs_each_gaussian_once_a_bundle(headroom, pairs, slots):
    part, trace = whole_picture(CAMERA.film, toy.TRACE)
    assert trace.bundle**2 * BUNDLES == CAMERA.film.width * CAMERA.film.height
    capacity = single_program_capacity(
        covering(32, behind=8), CAMERA, part, settings=SETTINGS, headroom=headroom
    )
    assert (capacity.pairs, capacity.slots) == (pairs, slots)


def staged(scene):
    """The capacity in stages, and the one that it starts from."""
    part, trace = whole_picture(CAMERA.film, toy.TRACE)
    part = jax.tree.map(lambda x: jnp.asarray(x)[None], part)
    row, layout = pack_camera(jax.device_get(CAMERA))
    leaves, structure = jax.tree.flatten(scene)
    arguments = leaves, np.stack([row]), part
    found = staged_capacity(structure, layout, SETTINGS, arguments, jnp.float32)
    return found, default_capacity(part, trace, scene, jnp.float32)


def test_lists_of_stages_are_those_of_an_ordinary_scene_or_the_next_power_of_two():
    found, ordinary = staged(covering(32))
    assert found == ordinary and found.pairs == 512 * BUNDLES
    found, _ = staged(covering(600))
    # 2400 pairs with room for half as many more.
    assert found.pairs == 4096 and found.slots == ordinary.slots == 1024
