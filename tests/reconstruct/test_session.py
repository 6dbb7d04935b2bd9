"""What is said when the pictures of a segment are read."""

import numpy as np
import toy

from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.images import write_image
from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.session import Session
from gaussray.reconstruct.shared_results import SharedResults


def test_a_plain_backdrop_is_told_once(tmp_path, capsys):
    capture = read_capture(toy.write_capture(tmp_path / "in", toy.scene(speed=0), times=(0.0,)))
    log, shared = RunLog(tmp_path / "out", resume=False, interval=0.0), SharedResults()
    Session(capture, log, toy.SHORT, False)
    assert "backdrop" not in capsys.readouterr().out
    for view in capture.views:
        picture = np.zeros((toy.SIZE, toy.SIZE, 3), np.uint8)
        picture[5:-5, 5:-5] = 200
        write_image(view.image, picture)
    Session(capture, log, toy.SHORT, True)
    assert "backdrop" not in capsys.readouterr().out
    for _ in range(2):
        Session(capture, log, toy.SHORT, False, shared=shared)
    assert capsys.readouterr().out.count("border is black: that is taken as a plain backdrop") == 1
