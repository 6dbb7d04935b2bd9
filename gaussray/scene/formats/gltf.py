"""Reads and writes Gaussians as glTF with KHR_gaussian_splatting (Khronos), in one GLB file.

A mesh primitive of points holds POSITION, and with the prefix KHR_gaussian_splatting: ROTATION
(unit quaternions x y z w), SCALE and OPACITY (not as logarithm and logit), and SH_DEGREE_l_COEF_n,
the harmonics in the order and sign of 3DGS. `colorSpace` says whether colours are sRGB values or
linear light. Axes are left, up, forward, against right, down, forward of PLY files: x and y change
sign.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from gaussray.color import srgb_decode
from gaussray.scene.formats.glb_file import Glb, read_glb, write_glb
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0, harmonic_basis


EXTENSION = "KHR_gaussian_splatting"
_COLOR_SPACES = {"srgb": "srgb_rec709_display", "linear": "lin_rec709_display"}
# The turn by half a circle about z; harmonics of odd order change sign.
_FLIP = np.array([-1, -1, 1], np.float32)
_ORDERS = np.concatenate([np.arange(-degree, degree + 1) for degree in range(4)])
# Nodes below one another, and how far a node's axes may be from a rotation of one scale.
_DEEPEST, _SKEWED = 64, 1e-3
# Scales of 0 would be infinitely thin.
_THINNEST = 1e-9


def write_gltf(path: Path | str, gaussians: Gaussians, color: str) -> None:
    """Write Gaussians at one time, without tints, as a GLB file.

    Values are kept in single precision. COLOR_0, for programs without Gaussians, shows points of
    the constant harmonic.

    Args:
        path: the file.
        gaussians: the Gaussians, whose colours are in the colour space of the file.
        color: `srgb` or `linear`, which the file states.

    Raises:
        ValueError: A value is not finite, there are no Gaussians, or the file would exceed 4 GB.
        OSError: The file cannot be written.
    """
    attributes = _attributes(gaussians, color)
    for name, values in attributes.items():
        if not np.isfinite(values).all() or not len(values):
            raise ValueError(f"{path}: {name} must be finite numbers, of at least one Gaussian.")
    extension = {
        "kernel": "ellipse",
        "colorSpace": _COLOR_SPACES[color],
        "sortingMethod": "cameraDistance",
        "projection": "perspective",
    }
    primitive = {
        "mode": 0,
        "attributes": {name: i for i, name in enumerate(attributes)},
        "extensions": {EXTENSION: extension},
    }
    document = {
        "asset": {"version": "2.0", "generator": "gaussray"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
    }
    write_glb(path, document, attributes)


def _attributes(gaussians: Gaussians, color: str) -> dict[str, np.ndarray]:
    """The vertex attributes by their semantics."""
    mean, turned, scale, opacity, harmonics = upright_columns(gaussians)
    return {
        "POSITION": mean,
        "COLOR_0": _points(harmonics[:, 0], opacity, color),
        f"{EXTENSION}:ROTATION": turned,
        f"{EXTENSION}:SCALE": scale,
        f"{EXTENSION}:OPACITY": opacity,
        **{name: harmonics[:, i] for i, name in enumerate(_names(harmonics.shape[1]))},
    }


def upright_columns(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    """Means, unit quaternions x y z w, scales, opacities [n, 1] and harmonics in single precision,
    turned by half a circle about z: y is up instead of down."""
    quat = np.asarray(gaussians.quat, np.float64)
    quat = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    harmonics = np.asarray(gaussians.harmonics, np.float32)
    return (
        np.asarray(gaussians.mean, np.float32) * _FLIP,
        # The product of the half turn (0, 0, 0, 1) and w x y z, as x y z w.
        (quat[:, [2, 1, 0, 3]] * [-1, 1, 1, -1]).astype(np.float32),
        np.asarray(gaussians.scale, np.float32),
        np.clip(np.asarray(gaussians.opacity, np.float32), 0, 1)[:, None],
        harmonics * _signs(harmonics.shape[1]),
    )


def _points(constant: np.ndarray, opacity: np.ndarray, color: str) -> np.ndarray:
    """Bytes of linear red, green, blue and opacity."""
    rgb = np.clip(C0 * constant + 0.5, 0, 1)
    light = srgb_decode(rgb) if color == "srgb" else rgb
    return np.round(255 * np.concatenate([light, opacity], axis=1)).astype(np.uint8)


def _names(coefficients: int) -> list[str]:
    """The semantics of the first harmonics."""
    names = [(degree, n) for degree in range(4) for n in range(2 * degree + 1)]
    return [f"{EXTENSION}:SH_DEGREE_{l}_COEF_{n}" for l, n in names[:coefficients]]  # noqa: E741


def _signs(coefficients: int) -> np.ndarray:
    """The signs of harmonics after half a turn about z."""
    return np.where(_ORDERS[:coefficients, None] % 2, -1, 1).astype(np.float32)


def read_gltf(path: Path | str) -> tuple[Gaussians, str]:
    """Read the Gaussians of a GLB file, of all nodes of its scene together.

    Returns:
        The Gaussians in the axes of PLY files, and the colour space that the file states, `srgb`
        or `linear`.

    Raises:
        ValueError: The file is no GLB, is cut off or compressed, or holds no Gaussians; the message
            says what it must hold.
        FileNotFoundError: The file does not exist.
    """
    glb = read_glb(path)
    parts = list(_primitives(glb))
    spaces = {space for space, *_ in parts}
    if not parts or len(spaces) > 1:
        raise glb.refuse(f"hold Gaussians of {EXTENSION}, of one colour space")
    most = max(part[-1].shape[1] for part in parts)
    rest = [np.pad(x[-1], ((0, 0), (0, most - x[-1].shape[1]), (0, 0))) for x in parts]
    columns = [*(np.concatenate(x) for x in zip(*(p[1:-1] for p in parts), strict=True))]
    columns.append(np.concatenate(rest))
    good = np.all([np.isfinite(x.reshape(len(x), -1)).all(axis=1) for x in columns], axis=0)
    if not good.any():
        raise glb.refuse("hold at least one finite Gaussian")
    return Gaussians(*(jnp.asarray(x[good], jnp.float32) for x in columns)), spaces.pop()


def _primitives(glb: Glb) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray, Any, Any]]:
    """Colour space, means, quaternions, scales, opacities and harmonics of every primitive."""
    for node, matrix in _nodes(glb):
        primitives = glb.entry("meshes", node["mesh"]).get("primitives")
        for primitive in primitives if isinstance(primitives, list) else ():
            extensions = primitive.get("extensions") if isinstance(primitive, dict) else None
            if isinstance(extensions, dict) and isinstance(extensions.get(EXTENSION), dict):
                yield _primitive(glb, primitive, extensions[EXTENSION], matrix)


def _primitive(
    glb: Glb, primitive: dict[str, Any], extension: dict[str, Any], matrix: np.ndarray
) -> tuple[str, np.ndarray, np.ndarray, np.ndarray, Any, Any]:
    if extension.get("extensions"):
        names = ", ".join(map(str, extension["extensions"]))[:80]
        raise glb.refuse(f"be uncompressed, got {names}; export it without compression, or as PLY")
    spaces = {name: color for color, name in _COLOR_SPACES.items()}
    space = spaces.get(str(extension.get("colorSpace")))
    if space is None or extension.get("kernel") != "ellipse":
        raise glb.refuse(f"have the kernel ellipse and a colorSpace among {', '.join(spaces)}")
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        raise glb.refuse("have attributes")
    harmonics = [name for name in _names(16) if name in attributes]
    required = ["POSITION", *(f"{EXTENSION}:{x}" for x in ("ROTATION", "SCALE", "OPACITY"))]
    missing = [name for name in required if name not in attributes]
    if missing or harmonics not in [_names(n) for n in (1, 4, 9, 16)]:
        raise glb.refuse(f"have {', '.join(missing) or 'all harmonics of each degree'}")
    columns = [glb.accessor(attributes[name]) for name in [*required, *harmonics]]
    widths = [3, 4, 3, 1, *[3] * len(harmonics)]
    if [x.shape for x in columns] != [(len(columns[0]), width) for width in widths]:
        raise glb.refuse(f"have attributes of {EXTENSION} of one length and the right types")
    mean, quat, scale, opacity, *rest = columns
    return space, *_world_columns(glb, (mean, quat, scale, np.stack(rest, axis=1)), opacity, matrix)


def _world_columns(
    glb: Glb, columns: tuple[np.ndarray, ...], opacity: np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Any, Any]:
    """The columns of a primitive in the axes of PLY files, after its node's transform."""
    world_columns = transform_columns(columns, matrix)
    if world_columns is None:
        raise glb.refuse("have nodes that scale all axes alike, without mirrors; apply the others")
    mean, quat, scale, harmonics = world_columns
    return mean, quat, scale, np.clip(opacity[:, 0], 0, 1), harmonics


def transform_columns(
    columns: tuple[np.ndarray, ...], matrix: Float[np.ndarray, "4 4"]
) -> tuple[np.ndarray, ...] | None:
    """Gaussians after a transform to a world whose y is up, in the axes of PLY files.

    Args:
        columns: means, quaternions x y z w, scales, and harmonics.
        matrix: from their axes to the world.

    Returns:
        Means, unit quaternions w x y z, scales, and harmonics; None if the matrix has different
        scales along its axes, or mirrors.
    """
    mean, quat, scale, harmonics = columns
    linear, origin = _FLIP[:, None] * matrix[:3, :3], _FLIP * matrix[:3, 3]
    size = np.cbrt(np.linalg.det(linear))
    turn = linear / size if size > 0 else np.zeros((3, 3))
    if np.abs(turn @ turn.T - np.eye(3)).max() > _SKEWED:
        return None
    quat = np.where((quat == 0).all(axis=1, keepdims=True), [0, 0, 0, 1], quat)
    rotation = _rotation_type()
    turned = rotation.from_matrix(turn) * rotation.from_quat(quat)
    return (
        mean @ linear.T + origin,
        np.roll(turned.as_quat(), 1, axis=1),
        np.maximum(scale * size, _THINNEST),
        np.einsum("ij,njk->nik", rotated_harmonics(turn, harmonics.shape[1]), harmonics),
    )


def rotated_harmonics(
    turn: Float[np.ndarray, "3 3"], coefficients: int
) -> Float[np.ndarray, "coefficients coefficients"]:
    """The matrix that rotates harmonics: c'(d) = c(turn^T d).

    Every degree is closed under rotations, so least squares over more directions than coefficients
    is exact.

    Args:
        turn: rotation matrix.
        coefficients: number of harmonics.
    """
    direction = np.random.default_rng(0).normal(size=(3, 64))
    direction /= np.linalg.norm(direction, axis=0)
    here, there = (
        np.stack(
            [np.asarray(x, np.float64) for x in harmonic_basis(jnp.asarray(d), coefficients)],
            axis=1,
        )
        for d in (direction, turn.T @ direction)
    )
    return np.linalg.lstsq(here, there, rcond=None)[0]


def _nodes(glb: Glb) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """The nodes of the scene that have a mesh, each with its matrix to the world."""
    scene = glb.entry("scenes", glb.document.get("scene", 0))
    level, count = [(index, np.eye(4)) for index in _list(scene.get("nodes"))], 0
    for _ in range(_DEEPEST):
        below = []
        for index, parent in level:
            node = glb.entry("nodes", index)
            count += 1
            matrix = parent @ _matrix(glb, node)
            if "mesh" in node:
                yield node, matrix
            below += [(child, matrix) for child in _list(node.get("children"))]
        level = below
        if count > len(glb.document["nodes"]):
            break
    if level:
        raise glb.refuse("have nodes in a tree, where each is the child of one")


def _matrix(glb: Glb, node: dict[str, Any]) -> np.ndarray:
    """The 4x4 matrix of a node: its own, or translation, rotation and scale."""
    words = {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}
    values = {name: np.asarray(_list(node[name])) for name in words if name in node}
    for name, value in values.items():
        if value.shape != (words[name],) or value.dtype.kind not in "if":
            raise glb.refuse(f"have {words[name]} numbers as {name} of a node")
    if "matrix" in values:
        return values["matrix"].reshape(4, 4).T.astype(np.float64)
    matrix = np.eye(4)
    if "rotation" in values and np.any(values["rotation"]):
        matrix[:3, :3] = _rotation_type().from_quat(values["rotation"]).as_matrix()
    matrix[:3, :3] *= values.get("scale", np.ones(3))
    matrix[:3, 3] = values.get("translation", np.zeros(3))
    return matrix


def _rotation_type() -> Any:
    """SciPy's rotations, imported when needed: that takes a fifth of a second."""
    from scipy.spatial.transform import Rotation

    return Rotation


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
