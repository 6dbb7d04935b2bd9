"""Scenes, unfinished fits, and trained models of other programs."""

import sys
import tempfile
from pathlib import Path

from experiments.hostile.reader import Files, Reader, written


# Where tests make models of other programs.
sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))


def _scenes() -> list[Files]:
    import jax

    from gaussray.scene.bodies import bodies_at_rest
    from gaussray.scene.deformation import initial_deformation
    from gaussray.scene.formats.gaussian_folder import read_model
    from gaussray.scene.gaussians import Gaussians
    from gaussray.scene.planes import initial_planes
    from gaussray.scene.scene import Scene
    from gaussray.scene.segmented import Clip
    from gaussray.scene.store import save_scene

    def some(count):
        shapes = (3,), (4,), (3,), (), (4, 3)
        return Gaussians(*(jax.numpy.full((count, *shape), 0.5) for shape in shapes))

    def save(path, scene, precision):
        save_scene(path, scene, precision=precision, info={"a": 1})

    key, zero = jax.random.key(0), jax.numpy.zeros(3)
    planes = initial_planes(key, zero - 1, zero + 1, (0.0, 1.0), sides=(2,), instants=2, channels=2)
    bodies = bodies_at_rest(zero[None], jax.numpy.ones(1), jax.numpy.asarray([0.0, 1.0]))
    field = initial_deformation(key, planes, bodies, width=2)
    times = jax.numpy.asarray
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        rest, residuals, _ = read_model(_written_model(folder))
    still = Scene(some(2), some(0), None, times([0.0, 1.0]))
    moves = Scene(some(1), some(2), field, times([1.0, 2.0]))
    other = Scene(some(0), rest, residuals, times([0.0, 1.0]))
    cases = [(still, "full"), (moves, "full"), (moves, "compact"), (other, "full")]
    cases.append((Clip((still, moves)), "full"))
    return [{"scene.npz": written("scene.npz", lambda p, c=c: save(p, *c))} for c in cases]


def _read_scene(folder: Path) -> object:
    from gaussray.scene.store import load_scene, scene_info

    return load_scene(folder), scene_info(folder)


def _checkpoint() -> list[Files]:
    from experiments.hostile.checkpoint import sample

    return [{"checkpoint.npz": written("checkpoint.npz", sample)}]


def _read_checkpoint(folder: Path) -> object:
    from gaussray.reconstruct.log import RunLog

    return RunLog(folder, resume=True, interval=1.0).resumed()


def _model() -> list[Files]:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        root = _written_model(folder)
        paths = [path for path in root.rglob("*") if path.is_file()]
        return [{str(path.relative_to(root)): path.read_bytes() for path in paths}]


def _written_model(folder: str) -> Path:
    import foreign

    tensors = foreign.state(side=2, rows=2, width=2, channels=1, scales=(1,))
    return foreign.write_model(Path(folder), tensors, foreign.cloud(2))


def _read_tensors(folder: Path) -> object:
    from gaussray.scene.formats.pth import read_tensors

    return read_tensors(folder / "point_cloud/iteration_20/deformation.pth")


def _read_model(folder: Path) -> object:
    from gaussray.scene.formats.gaussian_folder import read_model

    return read_model(folder)


READERS = {
    "scene": Reader(_scenes, _read_scene, {"scene.npz": "npz"}),
    "checkpoint": Reader(_checkpoint, _read_checkpoint, {"checkpoint.npz": "npz"}),
    "pth": Reader(_model, _read_tensors, {"point_cloud/iteration_20/deformation.pth": "npz"}),
    "model": Reader(_model, _read_model, {"cfg_args": "text"}),
}
