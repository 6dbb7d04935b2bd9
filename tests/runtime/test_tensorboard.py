"""Figures of a fit reach TensorBoard's files under names that say what they are."""

import struct
import sys

import jax.numpy as jnp
import pytest

from gaussray.reconstruct.log import RunLog
from gaussray.reconstruct.run_progress import RunProgress
from gaussray.runtime.tensorboard import tensorboard


LINE = {"stage": "fine", "step": 25, "seconds": 1.5, "l1": 0.25, "psnr": 20.0, "gaussians": 9}


def test_every_figure_is_a_scalar_of_its_stage(monkeypatch, tmp_path):
    class Writer:
        def __init__(self, folder, **_):
            self.folder, self.told = folder, []
            written.append(self)

        def add_scalar(self, name, value, step):
            self.told.append((name, value, step))

        def close(self):
            pass

    written = []
    monkeypatch.setitem(sys.modules, "tensorboardX", type(sys)("tensorboardX"))
    sys.modules["tensorboardX"].SummaryWriter = Writer
    told = tensorboard(tmp_path)
    told(LINE)
    told({"segment": 2} | LINE)
    names = ("l1", "psnr", "gaussians")
    expected = [(f"fine/{name}", LINE[name], 25) for name in names]
    expected += [(f"segment_2/fine/{name}", LINE[name], 25) for name in names]
    assert written[0].told == expected and written[0].folder == str(tmp_path)


def test_files_are_written_to_the_last_figure(monkeypatch, tmp_path):
    pytest.importorskip("tensorboardX", reason="an extra")
    ends = []
    monkeypatch.setattr("atexit.register", ends.append)
    tensorboard(tmp_path)(LINE)
    ends[-1]()
    (file,) = tmp_path.glob("events.out.tfevents.*")
    expected = {"fine/l1": 0.25, "fine/psnr": 20.0, "fine/gaussians": 9.0}
    assert list(scalars(file)) == [(name, 25, value) for name, value in expected.items()]


def scalars(file):
    """(name, step, value) of a file of events: records of length, check sum, event, check sum."""
    from tensorboardX.proto.event_pb2 import Event

    data = file.read_bytes()
    while data:
        (length,) = struct.unpack_from("<Q", data)
        event, data = Event.FromString(data[12 : 12 + length]), data[16 + length :]
        yield from ((told.tag, event.step, told.simple_value) for told in event.summary.value)


def test_a_missing_package_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(ValueError, match=r"tensorboard=true needs .*'\.\[log\]'"):
        tensorboard(tmp_path)


def test_a_journal_tells_every_line_it_writes(tmp_path):
    told = []
    log = RunLog(tmp_path, resume=False, interval=0.0, listener=told.append)
    log.record(
        RunProgress(stage="fine"), 25, {"mse": jnp.asarray(0.01), "l1": jnp.asarray(0.25)}, 9
    )
    (line,) = told
    assert line["psnr"] == pytest.approx(20.0) and line["gaussians"] == 9 and line["step"] == 25
