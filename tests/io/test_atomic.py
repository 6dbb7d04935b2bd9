"""Files are whole or not there, and what could not be written is named."""

import errno

import pytest

from gaussray.io.atomic import PART, atomic_path, remove_partial_files


def full():
    """What the system says of a full disk: no file is named."""
    return OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_told_with_the_file_which_stays_as_it_was(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("before")
    with pytest.raises(OSError, match="a.txt: cannot be written: No space left") as found:
        with atomic_path(path) as partial:
            partial.write_text("aft")
            raise full()
    assert found.value.__cause__.errno == errno.ENOSPC
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError, match="other.txt"), atomic_path(tmp_path / "a.txt"):
        (tmp_path / "other.txt").read_text()


def test_what_killed_processes_left_goes_and_nothing_else(tmp_path):
    left, users = tmp_path / f".a.123{PART}.npz", tmp_path / ".mine.part1.rar"
    left.touch()
    users.touch()
    remove_partial_files(tmp_path)
    assert list(tmp_path.iterdir()) == [users]
