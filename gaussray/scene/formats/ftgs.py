"""Reads and writes `.ftgs.ply` files: the transient Gaussians of FreeTimeGS (Wang et al. 2025).

A PLY file of 3D Gaussian Splatting whose element vertex also has `time`, the instant of the largest
opacity, `log_duration`, the logarithm of the standard deviation of the window, and `velocity_0..2`,
all in a time that is 0 at the beginning of the sequence and 1 at its end. Comments of the header
say ftgs_version 1, use_velocity 0 or 1 (whether Gaussians move) and n_frames.
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gaussray.io.ply import comments_of
from gaussray.scene.formats.gaussian_ply import model_columns, unit_quaternions, write_gaussians
from gaussray.scene.transient import Transients


_TIMES = ("time", "log_duration", "velocity_0", "velocity_1", "velocity_2")
# Windows are not shorter or longer than this in files (a longer one is as good as none).
_SHORTEST, _LONGEST = 1e-6, 1e4


def is_ftgs(path: Path | str) -> bool:
    """Whether a file is a PLY file that says ftgs_version."""
    path = Path(path)
    return path.suffix.lower() == ".ply" and path.is_file() and "ftgs_version" in comments_of(path)


def read_ftgs(path: Path | str) -> Transients:
    """The Gaussians of a `.ftgs.ply` file, over the times 0 to 1.

    Raises:
        ValueError: The version is not 1, or as `read_gaussians`.
    """
    comments = comments_of(path)
    if comments.get("ftgs_version") != "1":
        raise ValueError(
            f"{path}: ftgs_version must be 1, got {comments.get('ftgs_version')!s:.80}. Export the "
            "model again."
        )
    mean, quat, log_scale, logit, harmonics, more = model_columns(path, _TIMES)
    velocity = more[:, 2:] * (comments.get("use_velocity", "1") != "0")
    with np.errstate(over="ignore"):
        values = {
            "mean": mean,
            "velocity": velocity,
            "quat": unit_quaternions(quat),
            "scale": np.exp(log_scale),
            "opacity": 1 / (1 + np.exp(-logit)),
            "harmonics": harmonics,
            "instant": more[:, 0],
            "lifetime": np.clip(np.exp(more[:, 1]), _SHORTEST, _LONGEST),
            "plateau": np.zeros(len(mean)),
        }
    return Transients(**{name: jnp.asarray(x, jnp.float32) for name, x in values.items()})


def write_ftgs(path: Path | str, transients: Transients) -> None:
    """Write transient Gaussians as a `.ftgs.ply` file.

    Args:
        path: the file.
        transients: Gaussians without plateaus, whose times are 0 to 1.

    Raises:
        ValueError: A Gaussian has a plateau, or a value is not finite.
        OSError: The file cannot be written.
    """
    if np.any(np.asarray(transients.plateau) != 0):
        raise ValueError(f"{path}: a .ftgs.ply file must hold Gaussian windows, got plateaus.")
    lifetime = np.clip(np.asarray(transients.lifetime, np.float64), _SHORTEST, _LONGEST)
    columns = [transients.instant, np.log(lifetime), *np.asarray(transients.velocity).T]
    degree = round(transients.harmonics.shape[1] ** 0.5) - 1
    comments = ["ftgs_version 1", "time_units normalized", f"sh_degree {degree}", "use_velocity 1"]
    more = {name: np.asarray(x) for name, x in zip(_TIMES, columns, strict=True)}
    write_gaussians(path, transients.gaussians, more=more, comments=comments)
