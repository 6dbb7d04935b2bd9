"""What a killed process left in the output folder is removed by the next one."""

import pytest

from gaussray.prepare import prepare_capture
from gaussray.prepare.leftovers import WORK_PREFIX, mark_work
from gaussray.runtime.lock import LOCK_FILE, output_lock


pytest.importorskip("pycolmap")


def leave(folder):
    """A folder as a killed process leaves it."""
    (folder / "placed").mkdir(parents=True)
    (folder / "placed" / "features.db").touch()
    mark_work(folder)


def test_folders_of_killed_processes_are_removed_and_nothing_else(tmp_path):
    out = tmp_path / "out"
    kept = (".prepare_backups", ".prepare0a_b1c2d", f"{WORK_PREFIX}my_notes", "images")
    for name in kept:
        (out / name / "placed").mkdir(parents=True)
    leave(out / f"{WORK_PREFIX}0a_b1c2d")
    # Of one that was killed before it could write.
    (out / f"{WORK_PREFIX}uuz889ln").mkdir()
    (out / f"{WORK_PREFIX}1234abcd").touch()
    with pytest.raises(FileNotFoundError):
        prepare_capture(tmp_path / "none", out)
    left = sorted(path.name for path in out.iterdir())
    assert left == sorted([*kept, f"{WORK_PREFIX}1234abcd"])


def test_the_folder_is_locked_meanwhile(tmp_path, monkeypatch):
    leave(tmp_path / "out" / f"{WORK_PREFIX}uuz889ln")

    def taken(*_, **__):
        raise OSError("process 4711 is writing there")

    monkeypatch.setattr("gaussray.runtime.lock.lock_output", taken)
    with pytest.raises(OSError, match="4711"), output_lock(tmp_path):
        pass
    with pytest.raises(OSError, match="4711"):
        prepare_capture(tmp_path / "none", tmp_path / "out")
    assert (tmp_path / "out" / f"{WORK_PREFIX}uuz889ln").is_dir()


@pytest.mark.parametrize("owner", [None, "1 elsewhere\n"])
def test_nothing_is_removed_where_there_are_no_locks(tmp_path, monkeypatch, owner):
    """Another process may work in the folder."""
    out = tmp_path / "out"
    leave(out / f"{WORK_PREFIX}uuz889ln")
    if owner is not None:
        (out / LOCK_FILE).with_suffix(".owner").write_text(owner)

    def without(lock, *_, **__):
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("gaussray.runtime.lock.FileLock.acquire", without)
    with pytest.raises(FileNotFoundError):
        prepare_capture(tmp_path / "none", out)
    assert (out / f"{WORK_PREFIX}uuz889ln" / "placed").is_dir()
