"""What an adjustment found, in words and figures: values, standard errors, what is confounded."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gaussray.calibrate.least_squares import confounded, covariance
from gaussray.calibrate.parameters import SHARED, Unknown, readings
from gaussray.calibrate.solver import Adjustment, Found, Total


# RMS change of the encoded picture, per unit of an unknown, below which it has no effect.
NO_EFFECT = 1e-6
# Correlation from which two numbers are said to be confounded.
CONFOUNDED = 0.98


class Label(NamedTuple):
    """An unknown, and whose it is (None: that of all cameras)."""

    unknown: Unknown
    camera: str | None

    def __str__(self) -> str:
        return " ".join(filter(None, (self.camera, self.unknown.name)))


def labels(adjustment: Adjustment, names: Sequence[str]) -> list[Label]:
    """A label for every unknown of the cameras of these names, in the order of the values."""
    found: dict[int, Label] = {}
    for camera, row in zip(names, adjustment.places, strict=True):
        for one, place in zip(adjustment.told, row, strict=True):
            shared = one.kind in SHARED or len(names) == 1
            found.setdefault(int(place), Label(one, None if shared else camera))
    return [found[i] for i in range(len(found))]


def demand_effect(total: Total, labelled: Sequence[Label]) -> None:
    """ValueError for an unknown that changes nothing in the pictures."""
    effect = np.sqrt(np.diag(total.inner) / len(total.residual))
    for label, size in zip(labelled, effect, strict=True):
        if size < NO_EFFECT:
            kind = label.unknown.kind
            moves = kind in ("shutter", "offset")
            why = "nothing that they see moves" if moves else "they do not show it"
            raise ValueError(
                f"calibrate.parameters: {label} has no effect on these pictures ({why}). Leave "
                f"{kind} out."
            )


def parameters(
    adjustment: Adjustment, found: Found, labelled: Sequence[Label]
) -> list[dict[str, Any]]:
    """Name, camera (of what is one's own), start, value, standard errors and unit of every number;
    errors to first order (`least_squares.covariance`)."""
    told, cameras = {}, {shot.owner: shot.camera for shot in adjustment.shots}
    errors = [covariance(found.after.inner, scatter) for scatter in found.after.scatter]

    @jax.jit
    def read(value, camera):
        return readings(value, camera, adjustment.unit, adjustment.told)

    for owner, camera in cameras.items():
        place = adjustment.places[owner]
        value = jnp.asarray(found.value[place], camera.time.dtype)
        slope = np.asarray(jax.jacfwd(read)(value, camera), np.float64)
        own = [np.sqrt(np.diag(slope @ c[np.ix_(place, place)] @ slope.T)) for c in errors]
        start, end = read(jnp.zeros_like(value), camera), read(value, camera)
        figures = zip(start, end, *own, strict=True)
        told |= {int(i): [float(x) for x in row] for i, row in zip(place, figures, strict=True)}
    rows = []
    for i, label in enumerate(labelled):
        start, value, independent, tiles = told[i]
        rows.append(
            {"name": label.unknown.name}
            | ({"camera": label.camera} if label.camera else {})
            | {"start": start, "value": value}
            | {"standard_error": {"independent": independent, "tiles": tiles}}
            | {"unit": label.unknown.unit}
        )
    return rows


def undone(found: Found, labelled: Sequence[Label]) -> list[str]:
    """A line for every two numbers that the pictures can hardly tell apart."""
    return [
        f"{labelled[i]} and {labelled[j]} can hardly be told apart in these pictures (their errors "
        f"correlate by {correlation:.4f}): trust what they do together, or hold one of them."
        for i, j, correlation in confounded(found.after.inner, CONFOUNDED)
    ]


def decibel(total: Total) -> float:
    """PSNR of the compared pixels, encoded values."""
    return round(-10 * float(np.log10(np.mean(total.residual.astype(np.float64) ** 2))), 4)


def table(report: dict[str, Any]) -> str:
    """A report as text: a line for every number, then what cannot be told apart."""
    lines = [f"{'':<24}{'start':>12}{'value':>12}{'+-':>11}{'tiles +-':>11}  unit"]
    for row in report["parameters"]:
        name = " ".join(filter(None, (row.get("camera"), row["name"])))
        errors = (row["standard_error"][key] for key in ("independent", "tiles"))
        figures = f"{row['start']:>12.6g}{row['value']:>12.6g}"
        lines.append(f"{name:<24}{figures}{''.join(f'{x:>11.2g}' for x in errors)}  {row['unit']}")
    before, after = report["psnr"]["before"], report["psnr"]["after"]
    return "\n".join([*lines, f"PSNR {before:.2f} -> {after:.2f} dB", *report["confounded"]])
