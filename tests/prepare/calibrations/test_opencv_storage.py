"""Files of OpenCV's FileStorage are refused by the name of one that is a calibration."""

import pytest

from gaussray.prepare.calibrations.read import read_calibration
from gaussray.prepare.errors import PrepareError


def test_of_files_of_opencv_one_with_a_camera_is_named_and_the_conventions(tmp_path):
    def put(name, *shapes):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        sizes = "".join(f"<rows>{r}</rows>\n  <cols>{c}</cols>" for r, c in shapes)
        text = f'<?xml version="1.0"?>\n<opencv_storage>{sizes}</opencv_storage>'
        (tmp_path / name).write_text(text)

    def named():
        with pytest.raises(
            PrepareError, match="vector and translation, world.*k1 k2 p1 p2 k3"
        ) as e:
            read_calibration(tmp_path)
        return str(e.value).split(": must")[0]

    put("checkerboard.xml")
    put("cam1/corners.xml", (88, 2))
    put("cam1/intrinsics.xml", (3, 3), (1, 5))
    assert named().endswith("cam1/intrinsics.xml")
    put("cam1/config.xml", (3, 3), (1, 5), (3, 1), (3, 1))
    assert named().endswith("cam1/config.xml")
