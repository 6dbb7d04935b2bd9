"""gsplat's rasterizers beside the tracer: the same Gaussians, standing still, and the same camera.

`ewa` splats projected Gaussians (3DGS), `3dgut` evaluates them along each pixel's ray, as the
tracer does. Both blend in the order of the centres' depths; the tracer in that of the hits. Needs
the `peer` extra and a CUDA device; its kernels compile when it is first imported.
"""

import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import exact
from benchmarks.record import timed
from gaussray.camera.camera import Camera
from gaussray.camera.lens.perspective import Pinhole
from gaussray.camera.trajectory import pose_at
from gaussray.geometry import rotation_matrix
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.scene import Scene, at


RASTERIZERS: dict[str, dict[str, bool]] = {
    "ewa": {},
    "3dgut": {"with_ut": True, "with_eval3d": True},
}
# What `columns` adds to a line: seconds of each, those of the tracer divided by 3dgut's, and how
# far 3dgut's colours are from double precision.
COLUMNS = ("ewa_s", "3dgut_s", "against_3dgut", "3dgut_psnr")


class PeerView(NamedTuple):
    """A pinhole camera in gsplat's terms.

    Args:
        camera_from_world: 4 x 4, x to the right, y down, z forward.
        intrinsics: 3 x 3, in pixels.
        size: width and height.
        radial: k1 to k6 of OpenCV's model.
        tangential: p1 and p2.
    """

    camera_from_world: np.ndarray
    intrinsics: np.ndarray
    size: tuple[int, int]
    radial: np.ndarray
    tangential: np.ndarray

    @property
    def distorted(self) -> bool:
        """Whether the lens bends rays, which `ewa` cannot."""
        return bool(np.any(self.radial) or np.any(self.tangential))


def usable() -> bool:
    """Whether gsplat is installed and JAX computes on a CUDA device."""
    return importlib.util.find_spec("gsplat") is not None and jax.default_backend() == "gpu"


def peer_view(camera: Camera) -> PeerView:
    """A camera at its frame's time; aperture, shutter and motion are left out.

    Raises:
        TypeError: its lens is no pinhole, or its distortion has more than gsplat's terms.
    """
    lens = camera.lens
    if not isinstance(lens, Pinhole) or np.any(np.asarray(lens.distortion)[8:]):
        raise TypeError("gsplat is compared by pinholes with OpenCV's k1 to k6, p1 and p2.")
    pose = np.eye(4)
    world_from_camera = pose_at(
        jax.tree.map(jnp.asarray, camera.trajectory), jnp.asarray(camera.time)
    )
    pose[:3, :3] = rotation_matrix(jnp.asarray(world_from_camera.quat))
    pose[:3, 3] = world_from_camera.translation
    intrinsics = np.eye(3)
    intrinsics[[0, 1], [0, 1]], intrinsics[:2, 2] = lens.focal, lens.center
    k = np.asarray(lens.distortion)
    return PeerView(
        np.linalg.inv(pose), intrinsics, (camera.film.width, camera.film.height),
        k[[0, 1, 4, 5, 6, 7]], k[2:4],
    )  # fmt: skip


def rasterize(view: PeerView, values: dict[str, Any], kind: str, **options: Any) -> tuple[Any, Any]:
    """Picture [h, w, 3] and gsplat's further results.

    Args:
        view: the camera.
        values: gsplat's arrays of Gaussians, as torch tensors on the device.
        kind: ewa or 3dgut.
        options: further ones of gsplat.rasterization.
    """
    import gsplat
    import torch

    def there(x: np.ndarray) -> torch.Tensor:
        return torch.tensor(x, dtype=torch.float32, device="cuda")[None]

    settings = RASTERIZERS[kind]
    if view.distorted:
        if kind == "ewa":
            raise ValueError("gsplat's ewa rasterizer has no distortion: use 3dgut.")
        settings = settings | {
            "radial_coeffs": there(view.radial),
            "tangential_coeffs": there(view.tangential),
        }
    picture, _, info = gsplat.rasterization(
        **values,
        viewmats=there(view.camera_from_world),
        Ks=there(view.intrinsics),
        width=view.size[0],
        height=view.size[1],
        packed=False,
        **settings,
        **options,
    )
    return picture[0], info


def columns(
    gaussians: Gaussians,
    camera: Camera,
    ours: float,
    *,
    gradients: bool = False,
    truth: tuple[np.ndarray, np.ndarray] | None = None,
) -> dict[str, float]:
    """Figures of both rasterizers (of 3dgut alone where the lens is distorted); none where gsplat
    cannot be used.

    Args:
        gaussians: all of them, at one time.
        camera: a pinhole.
        ours: seconds of the tracer for the same.
        gradients: whether the gradient of the mean square of the colours in all values of the
            Gaussians is computed as well.
        truth: numbers of pixels, and their exact colours.
    """
    if not usable():
        return {}
    import torch

    view, values = peer_view(camera), _tensors(gaussians)
    degree = int(np.sqrt(gaussians.harmonics.shape[1])) - 1
    figures: dict[str, float] = {}
    for kind in ("3dgut",) if view.distorted else RASTERIZERS:

        def forward(kind: str = kind):
            return rasterize(view, values, kind, sh_degree=degree)[0]

        def backward(forward: Callable = forward):
            return torch.autograd.grad((forward() ** 2).mean(), list(values.values()))

        for x in values.values():
            x.requires_grad_(gradients)
        timing = timed(backward if gradients else forward, wait=_wait)
        figures[f"{kind}_s"] = timing["run_s_median"]
        if kind == "3dgut" and truth is not None:
            seen = forward().detach().cpu().numpy().reshape(-1, 3)[truth[0]]
            figures["3dgut_psnr"] = exact.psnr(seen, truth[1])
    return figures | {"against_3dgut": ours / figures["3dgut_s"]}


def scene_columns(scene: Scene, camera: Camera, ours: float) -> dict[str, float]:
    """`columns` of a scene as it is at the time of a camera; none for a lens that gsplat has not.

    Args:
        scene: the scene.
        camera: the camera.
        ours: seconds of the tracer for a frame.
    """
    if not usable() or not isinstance(camera.lens, Pinhole):
        return {}
    return columns(at(scene, jnp.asarray(camera.time)), camera, ours)


def _tensors(gaussians: Gaussians) -> dict[str, Any]:
    import torch

    names = {
        "means": gaussians.mean,
        "quats": gaussians.quat,
        "scales": gaussians.scale,
        "opacities": gaussians.opacity,
        "colors": gaussians.harmonics,
    }
    return {name: torch.tensor(np.asarray(x), device="cuda") for name, x in names.items()}


def _wait(_: Any) -> None:
    import torch

    torch.cuda.synchronize()
