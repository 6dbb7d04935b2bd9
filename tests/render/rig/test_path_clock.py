"""The times of a path file are checked in double precision, before cameras have them in single."""

import dataclasses

import numpy as np
import pytest

from gaussray.render.rig import rig


def ridden(views, trajectory):
    return rig.frame_records(views, options=rig.RigOptions(trajectory=trajectory), samples=1)


@pytest.mark.parametrize(
    ("stamps", "steps", "message", "remedy"),
    [
        # Single precision does not tell the poses apart, nor the frames between them.
        (("1700000000.0", "1700000000.5"), 2, "to 1700000000.5, lie outside of the ch", "subtract"),
        (
            ("1700000000", "1700000200"),
            5,
            "lie outside of the chosen times, 0 to 1",
            "subtract",
        ),
        (
            ("0.5", "0.50000000001"),
            2,
            "are too close to each other",
            "leave out poses",
        ),
        (("0.5", "0.500001"), 200, "are too close to each other", "fewer trajectory.steps"),
    ],
)
def test_a_clock_beyond_single_precision_is_told_with_its_remedies(
    views, tmp_path, stamps, steps, message, remedy
):
    file = tmp_path / "path.txt"
    file.write_text("".join(f"{t} {i} 0 -3 0 0 0 1\n" for i, t in enumerate(stamps)))
    options = rig.TrajectoryOptions("path", steps, file=str(file), clock="file")
    with pytest.raises(ValueError, match=message) as error:
        ridden(views, options)
    assert f"trajectory.clock=span, or {remedy}" in str(error.value)
    span = ridden(views, dataclasses.replace(options, clock="span"))
    np.testing.assert_allclose(span[0].camera.trajectory.time, [0, 1])
