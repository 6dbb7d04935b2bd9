"""What a killed process left in the output folder is removed by the next one."""

import pytest

from gaussray.prepare import prepare_capture
from gaussray.runtime.lock import output_lock


pytest.importorskip("pycolmap")


def test_folders_of_killed_processes_are_removed_and_nothing_else(tmp_path):
    out = tmp_path / "out"
    kept = (".prepared", ".prepare_notes", "prepare12345678", "images")
    for name in (".prepare0a_b1c2d", ".prepareuuz889ln", *kept):
        (out / name / "placed").mkdir(parents=True)
        (out / name / "placed" / "features.db").touch()
    (out / ".prepare1234abcd").touch()
    with pytest.raises(FileNotFoundError):
        prepare_capture(tmp_path / "none", out)
    assert sorted(path.name for path in out.iterdir()) == sorted([*kept, ".prepare1234abcd"])


def test_the_folder_is_locked_meanwhile(tmp_path, monkeypatch):
    (tmp_path / "out" / ".prepareuuz889ln").mkdir(parents=True)

    def taken(*_, **__):
        raise OSError("process 4711 is writing there")

    monkeypatch.setattr("gaussray.runtime.lock.lock_output", taken)
    with pytest.raises(OSError, match="4711"), output_lock(tmp_path):
        pass
    with pytest.raises(OSError, match="4711"):
        prepare_capture(tmp_path / "none", tmp_path / "out")
    assert (tmp_path / "out" / ".prepareuuz889ln").is_dir()
