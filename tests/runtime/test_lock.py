"""Of two processes one writes into a folder, and one that was killed holds none."""

import os
import signal
import subprocess
import sys

import pytest

from gaussray.runtime.lock import FILE, alone, holds_out, release, take


HOLDER = """
import sys, time
from gaussray.alone import take
take(sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def none_held():
    """No test leaves a folder to the next one."""
    yield
    release()


def test_another_process_is_named_and_once_it_is_killed_holds_nothing(tmp_path):
    words = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline()
        with pytest.raises(OSError, match=f"process {other.pid} on .* is writing there. Wait"):
            take(tmp_path)
        other.send_signal(signal.SIGKILL)
        other.wait()
    assert (tmp_path / FILE).exists()
    with alone(tmp_path):
        assert (tmp_path / FILE).read_text().split()[0] == str(os.getpid())
    assert not (tmp_path / FILE).exists()


def test_a_process_may_hold_its_folder_several_times_over(tmp_path):
    with alone(tmp_path):
        with alone(tmp_path):
            pass
        assert (tmp_path / FILE).exists()


def test_parts_of_a_folder_are_held_apart(tmp_path):
    take(tmp_path, "0/2")
    take(tmp_path, "1/2")
    assert len(list(tmp_path.iterdir())) == 2
    release()
    assert not list(tmp_path.iterdir())


def test_a_folder_in_which_nothing_was_written_goes_again(tmp_path):
    with alone(tmp_path / "new"):
        assert (tmp_path / "new").is_dir()
    assert not (tmp_path / "new").exists()


def test_a_function_holds_the_folder_it_is_given(tmp_path):
    @holds_out
    def write(number, out):
        return number, (out / FILE).exists()

    assert write(3, out=tmp_path) == (3, True)
    assert not (tmp_path / FILE).exists()


def test_a_file_in_the_folders_place_is_told(tmp_path):
    (tmp_path / "a").touch()
    with pytest.raises(OSError, match="out=.*a: cannot be written"):
        take(tmp_path / "a")
