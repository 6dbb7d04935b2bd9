"""What `test_preview.py` runs where JAX has two devices: they make what one renders."""

import sys
from pathlib import Path

import jax
import numpy as np
import rooms

from gaussray.render import renderer
from gaussray.render.renderer import Renderer
from gaussray.viewer import preview
from gaussray.viewer.develop import develop_preview
from gaussray.viewer.preview import PreviewRenderer


jax.config.update("jax_disable_most_optimizations", True)

# The same rays by another program, in single precision.
SINGLE = 1e-5
# In tiles of 8 x 8 neither side comes out even, nor does their number.
SIZE = 44, 20


def main(folder: Path) -> None:
    assert len(jax.devices()) == 2
    model = rooms.viewer_model(rooms.write_scene(folder))
    job = model.job(model.initial_values | {"aperture.radius": 0.2}, model.initial_viewpoint, SIZE)
    camera = job.records[0].camera
    previewer = PreviewRenderer(model.scene, options=job.options, trace=job.trace, keys=3)
    preview.staged_capacity = renderer.staged_capacity = lambda *_: rooms.ROOM
    found = rooms.made(previewer, camera, job.options.samples)
    frame = Renderer(model.scene, options=job.options, trace=job.trace, devices=1)(camera)
    values = np.asarray(found.values).reshape(*SIZE[::-1], 5)
    assert frame.color.std() > 0.05 and found.hits == frame.hits and found.dropped == 0
    np.testing.assert_allclose(values[..., :3], frame.color, atol=SINGLE)
    np.testing.assert_allclose(values[..., 3], frame.alpha, atol=SINGLE)
    assert develop_preview(found, job).shape == (*SIZE[::-1], 3)
    print("the same")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
