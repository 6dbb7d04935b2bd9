"""A capture of the generated room: pictures by cameras around it, of every instant."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.problem import EYE, INSTANTS, cameras, room_axes
from gaussray.camera.camera import Camera
from gaussray.camera.trajectory import Trajectory
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.geometry import quaternion
from gaussray.render import Renderer, RenderOptions
from gaussray.scene.scene import Scene


def around(side: int, count: int) -> list[Camera]:
    """Pinhole cameras on a circle in the room, which look at its middle."""
    first = cameras(side)["pinhole"]
    turns = Rotation.from_rotvec(np.arange(count)[:, None] / count * [0, 0, 2 * np.pi])
    made = []
    for turn in turns.as_matrix():
        axes = turn @ np.stack([*room_axes()], axis=1) * [1, -1, 1]
        place = Trajectory(
            jnp.zeros(1),
            quaternion(jnp.asarray(axes, jnp.float32))[None],
            jnp.asarray(turn @ EYE, jnp.float32)[None],
        )
        made.append(eqx.tree_at(lambda c: c.trajectory, first, place))
    return made


def write_capture(folder: Path, scene: Scene, side: int, count: int) -> None:
    """A capture of a scene by cameras `around` it, of each of its instants."""
    render = Renderer(scene, options=RenderOptions(samples=1))
    listed = []
    for number, camera in enumerate(around(side, count)):
        for instant in range(INSTANTS):
            shown = eqx.tree_at(lambda c: c.time, camera, jnp.float32(instant / (INSTANTS - 1)))
            name = f"images/cam{number:02d}/{instant:02d}.png"
            write_image(folder / name, render(shown).color)
            listed.append(FrameRecord(name, shown, f"cam{number:02d}", "train"))
    write_manifest(folder / "transforms.json", listed)
