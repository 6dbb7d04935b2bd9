"""Results of a calibration: values, standard errors, correlations, and the calibrated manifest."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.calibrate.least_squares import correlated_pairs, covariance
from gaussray.calibrate.parameters import SHARED, Unknown, corrected_camera, reported_values
from gaussray.calibrate.solver import CameraSolver, Solution, Sums
from gaussray.capture.capture import View
from gaussray.color import psnr_from_mse
from gaussray.dataset.manifest import FrameRecord


# RMS change of the encoded picture per unit of an unknown, below which it has no effect.
NO_EFFECT = 1e-6
# Two unknowns whose errors correlate by at least this much are reported as confounded.
CONFOUNDED = 0.98


class Label(NamedTuple):
    """An unknown and the name of its camera; None if all cameras share it."""

    unknown: Unknown
    camera: str | None

    def __str__(self) -> str:
        return " ".join(filter(None, (self.camera, self.unknown.name)))


def unknown_labels(solver: CameraSolver, cameras: Sequence[str]) -> list[Label]:
    """A label for every unknown, in the order of the values.

    Args:
        solver: the solver.
        cameras: names of the cameras.
    """
    result: dict[int, Label] = {}
    for camera, row in zip(cameras, solver.places, strict=True):
        for unknown, place in zip(solver.unknowns, row, strict=True):
            shared = unknown.kind in SHARED or len(cameras) == 1
            result.setdefault(int(place), Label(unknown, None if shared else camera))
    return [result[i] for i in range(len(result))]


def check_effect(sums: Sums, labels: Sequence[Label]) -> None:
    """Check that every unknown has an effect on the pictures.

    Args:
        sums: sums for the recorded cameras.
        labels: labels of the unknowns.

    Raises:
        ValueError: An unknown has no effect.
    """
    effects = np.sqrt(np.diag(sums.inlier_curvature) / len(sums.residual))
    for label, effect in zip(labels, effects, strict=True):
        if effect < NO_EFFECT:
            kind = label.unknown.kind
            still = kind in ("shutter", "offset")
            reason = "nothing moves in them" if still else "they do not show it"
            raise ValueError(
                f"calibrate.parameters: {label} has no effect on these pictures ({reason}). Leave "
                f"{kind} out."
            )


def parameter_rows(
    solver: CameraSolver, solution: Solution, labels: Sequence[Label]
) -> list[dict[str, Any]]:
    """Name, camera (unless shared), start, value, standard errors and unit of every unknown.

    Standard errors are of first order (`least_squares.covariance`).

    Args:
        solver: the solver.
        solution: its solution.
        labels: labels of the unknowns.
    """
    cameras = {one.camera_index: one.camera for one in solver.observations}
    errors = [
        covariance(solution.after.inlier_curvature, scatter) for scatter in solution.after.scatter
    ]

    @jax.jit
    def read(value, camera):
        return reported_values(value, camera, solver.unit, solver.unknowns)

    figures: dict[int, list[float]] = {}
    for index, camera in cameras.items():
        place = solver.places[index]
        value = jnp.asarray(solution.value[place], camera.time.dtype)
        slope = np.asarray(jax.jacfwd(read)(value, camera), np.float64)
        deviations = [np.sqrt(np.diag(slope @ c[np.ix_(place, place)] @ slope.T)) for c in errors]
        start, end = read(jnp.zeros_like(value), camera), read(value, camera)
        columns = zip(start, end, *deviations, strict=True)
        figures |= {int(i): [float(x) for x in row] for i, row in zip(place, columns, strict=True)}
    rows = []
    for i, label in enumerate(labels):
        start, value, independent, tiles = figures[i]
        rows.append(
            {"name": label.unknown.name}
            | ({"camera": label.camera} if label.camera else {})
            | {"start": start, "value": value}
            | {"standard_error": {"independent": independent, "tiles": tiles}}
            | {"unit": label.unknown.unit}
        )
    return rows


def confounded_pairs(solution: Solution, labels: Sequence[Label]) -> list[str]:
    """A sentence for every two unknowns that the pictures can hardly distinguish.

    Args:
        solution: the solution.
        labels: labels of the unknowns.
    """
    return [
        f"{labels[i]} and {labels[j]} can hardly be told apart in these pictures (their errors "
        f"correlate by {correlation:.4f}): trust only their combined effect, or fix one of them."
        for i, j, correlation in correlated_pairs(solution.after.inlier_curvature, CONFOUNDED)
    ]


def residual_psnr(sums: Sums) -> float:
    """PSNR of the compared blocks, from sRGB-encoded values, in dB."""
    return round(psnr_from_mse(np.mean(sums.residual.astype(np.float64) ** 2)), 4)


def calibrated_records(
    solver: CameraSolver, solution: Solution, views: Sequence[View], effect: str, cameras: list[str]
) -> list[FrameRecord]:
    """Manifest records of views with their calibrated cameras.

    Args:
        solver: the solver.
        solution: its solution.
        views: all views of the effect.
        effect: name of the effect.
        cameras: names of the calibrated cameras.

    Raises:
        ValueError: The estimated coefficients are no valid lens.
    """
    lens, records = solver.observations[0].camera.lens, []
    for view in views:
        if view.camera_name not in cameras:
            continue
        camera = dataclasses.replace(view.camera, lens=lens)
        place = solver.places[cameras.index(view.camera_name)]
        value = jnp.asarray(solution.value[place], camera.time.dtype)
        try:
            camera, _ = corrected_camera(value, camera, solver.unit, solver.unknowns)
        except ValueError as error:
            raise ValueError(
                f"the estimated coefficients make no valid lens: {error} Nothing is written. Start "
                "from better recorded cameras, with more calibrate.coarsest blocks, or estimate "
                "fewer calibrate.coefficients."
            ) from error
        records.append(
            FrameRecord(
                str(view.image.resolve()),
                camera,
                view.camera_name,
                view.split,
                effect,
                view.samples,
                None if view.mask is None else str(view.mask.resolve()),
                None if view.depth is None else str(view.depth.resolve()),
            )
        )
    return records


def calibration_table(report: dict[str, Any]) -> str:
    """A report as text: a line per unknown, the PSNR, then confounded unknowns."""
    lines = [f"{'':<24}{'start':>13}{'value':>13}{'+-':>11}{'tiles +-':>11}  unit"]
    for row in report["parameters"]:
        name = " ".join(filter(None, (row.get("camera"), row["name"])))
        errors = (row["standard_error"][key] for key in ("independent", "tiles"))
        figures = f"{row['start']:>13.6g}{row['value']:>13.6g}"
        lines.append(f"{name:<24}{figures}{''.join(f'{x:>11.2g}' for x in errors)}  {row['unit']}")
    before, after = report["psnr"]["before"], report["psnr"]["after"]
    return "\n".join([*lines, f"PSNR {before:.2f} -> {after:.2f} dB", *report["confounded"]])
