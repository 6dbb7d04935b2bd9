"""Reads `.splat` files (antimatter15): 32 bytes for each Gaussian, without view dependence.

Each record is x y z and three scales as float32, then red green blue alpha, then the quaternion
w x y z, as bytes: a colour channel or alpha is its byte / 255, a quaternion component
(byte - 128) / 128.
"""

import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from gaussray.io.safe.files import opened
from gaussray.io.safe.limits import within
from gaussray.scene.formats.gaussian_ply import demand_valid
from gaussray.scene.gaussians import Gaussians
from gaussray.scene.harmonics import C0


_RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
# Scales of 0 would be infinitely thin.
_THINNEST = 1e-9


def read_splat(path: Path | str) -> Gaussians:
    """The Gaussians of a `.splat` file; records that are not finite are dropped with a warning.

    Raises:
        ValueError: The size is no multiple of 32 bytes, or no record is finite.
        FileNotFoundError: The file does not exist.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        within(path, "the millions of Gaussians", size // _RECORD.itemsize, "points", 1e6)
        data = file.read()
    if not data or len(data) % _RECORD.itemsize:
        raise ValueError(
            f"{path}: a .splat file must have 32 bytes for each Gaussian, got {len(data)} bytes. "
            "Copy it again."
        )
    table = np.frombuffer(data, _RECORD)
    quat = (table["quat"].astype(np.float32) - 128) / 128
    above = np.zeros((len(table), 0, 3), np.float32)
    return finite_gaussians(path, table["mean"], quat, table["scale"], table["rgba"], above)


def finite_gaussians(
    path: Path | str,
    mean: Float[np.ndarray, "gaussians 3"],
    quat: Float[np.ndarray, "gaussians 4"],
    scale: Float[np.ndarray, "gaussians 3"],
    rgba: UInt8[np.ndarray, "gaussians 4"],
    above: Float[np.ndarray, "gaussians coefficients 3"],
) -> Gaussians:
    """The Gaussians whose numbers are finite; others are dropped with a warning.

    Args:
        path: the file, for the message.
        mean: places.
        quat: quaternions w x y z of any length; one of length 0 is no rotation.
        scale: scales; those of 0 become very thin.
        rgba: colours and opacities as bytes.
        above: harmonics above degree 0.

    Raises:
        ValueError: None is finite.
    """
    good = np.ones(len(mean), bool)
    for part in (mean, quat, scale, above):
        good &= np.isfinite(part.reshape(len(mean), -1)).all(axis=1)
    demand_valid(path, good)
    mean, quat, scale, rgba, above = (x[good] for x in (mean, quat, scale, rgba, above))
    quat = np.where((quat == 0).all(axis=1, keepdims=True), [1, 0, 0, 0], quat)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    color = rgba.astype(np.float32) / 255
    constant = ((color[:, :3] - 0.5) / C0)[:, None, :]
    # A byte of 0 or 255 stands for half a step inside: opacities are neither 0 nor 1.
    opacity = np.clip(color[:, 3], 0.5 / 255, 1 - 0.5 / 255)
    harmonics = np.concatenate([constant, above], axis=1)
    parts = mean, quat, np.maximum(scale, _THINNEST), opacity, harmonics
    return Gaussians(*(jnp.asarray(part, jnp.float32) for part in parts))
