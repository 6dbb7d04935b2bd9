"""One process at a time writes into an output folder; a killed process leaves no lock."""

import os
import subprocess
import sys

import pytest

from gaussray.runtime.lock import (
    LOCK_FILE,
    lock_output,
    locks_output,
    output_lock,
    release_locks,
)


HOLDER = """
import sys, time
from gaussray.runtime.lock import lock_output
lock_output(sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""
COUNTER = """
import pathlib, sys
from gaussray.runtime.lock import output_lock
count = pathlib.Path(sys.argv[1]) / "count"
for _ in range(200):
    while True:
        try:
            with output_lock(sys.argv[1]):
                count.write_text(str(int(count.read_text()) + 1))
                break
        except OSError as error:
            assert "is writing there" in str(error), error
"""


@pytest.fixture(autouse=True)
def no_lock_left():
    """No test leaves a lock to the next one."""
    yield
    release_locks()


def test_the_error_names_the_other_process_and_its_death_frees_the_folder(tmp_path):
    words = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline()
        with pytest.raises(OSError, match=f"process {other.pid} on .* is writing there. Wait"):
            lock_output(tmp_path)
        other.kill()
        other.wait()
    assert (tmp_path / LOCK_FILE).exists()
    with output_lock(tmp_path):
        assert (tmp_path / LOCK_FILE).exists()
    assert not list(tmp_path.iterdir())


@pytest.mark.ci
def test_of_processes_that_take_turns_no_two_hold_the_lock_at_once(tmp_path):
    """A lost update would leave the sum too small: removal of the file must not split the lock."""
    (tmp_path / "count").write_text("0")
    words = [sys.executable, "-c", COUNTER, str(tmp_path)]
    others = [subprocess.Popen(words) for _ in range(3)]
    assert [other.wait(timeout=120) for other in others] == [0, 0, 0]
    assert (tmp_path / "count").read_text() == "600"
    assert [path.name for path in tmp_path.iterdir()] == ["count"]


def test_a_process_may_lock_its_folder_several_times(tmp_path):
    with output_lock(tmp_path):
        with output_lock(tmp_path):
            pass
        assert (tmp_path / LOCK_FILE).exists()


def test_parts_of_a_folder_have_locks_of_their_own(tmp_path):
    paths = {lock_output(tmp_path, "0/2"), lock_output(tmp_path, "1/2")}
    assert len(paths) == 2 and all(path.exists() for path in paths)
    release_locks()
    assert not list(tmp_path.iterdir())


def test_a_folder_made_for_the_lock_goes_if_it_stays_empty(tmp_path):
    with output_lock(tmp_path / "new"):
        assert (tmp_path / "new").is_dir()
    assert not (tmp_path / "new").exists()


def test_a_decorated_function_locks_its_output_folder(tmp_path):
    @locks_output
    def write(number, out):
        return number, (out / LOCK_FILE).exists()

    assert write(3, out=tmp_path) == (3, True)
    assert not list(tmp_path.iterdir())


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "a").touch()
    with pytest.raises(OSError, match="out=.*a: cannot be written"):
        lock_output(tmp_path / "a")
    assert os.listdir(tmp_path) == ["a"]


def test_a_file_system_without_locks_goes_without(tmp_path, monkeypatch):
    def refused(self, *_, **__):
        raise OSError(37, "No locks available")

    monkeypatch.setattr("gaussray.runtime.lock.FileLock.acquire", refused)
    with output_lock(tmp_path):
        (tmp_path / "a").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
