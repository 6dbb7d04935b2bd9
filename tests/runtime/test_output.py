"""Text whose reader has gone is dropped, and the work goes on."""

import subprocess
import sys

import pytest

from gaussray.runtime.output import emit, first_of, listed_names, minutes_text


# Says that it works, waits until nobody reads any more, goes on, and leaves a file.
WORK = """
import sys, pathlib
from gaussray.runtime.progress import Progress, say
say("first")
sys.stdin.readline()
bar = Progress("work", 3, write=None)
for done in range(1, 4):
    say("more")
    bar.report(done)
pathlib.Path(sys.argv[1]).write_text("done")
"""
FRAMES = [f"{k:05d}.jpg" for k in range(65)]
EVEN = "0, 2, 4, 6, 8, 10, 12, 14"


def test_work_goes_on_after_its_reader_has_gone(tmp_path):
    command = [sys.executable, "-c", WORK, str(tmp_path / "result")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as work:
        assert work.stdout.readline() == "first\n"
        work.stdout.close()
        work.stderr.close()
        work.stdin.write("\n")
        work.stdin.close()
        assert work.wait(60) == 0
    assert (tmp_path / "result").read_text() == "done"


@pytest.mark.parametrize("words", [["render", "--help=all"], ["--completion"]])
def test_a_closed_pipe_is_no_error_of_the_program(words):
    code = "from gaussray.cli.main import program; program()"
    command = [sys.executable, "-c", code, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        program.stdout.close()
        assert program.stderr.read() == b""
        assert program.wait(60) == 0


def test_text_is_there_at_once(capsys):
    emit("one\n", sys.stdout)
    emit("two\n", sys.stderr)
    assert capsys.readouterr() == ("one\n", "two\n")


def test_of_many_names_the_first_are_told():
    assert first_of(["a"]) == "a" and first_of([]) == ""
    assert first_of(["a", "b", "c"]) == "a, b, c"
    assert first_of(["a", "b", "c", "d"]) == "a, b, c ..." and first_of("ab", most=1) == "a ..."


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        (range(28), "00000.jpg to 00027.jpg"),
        ([0, 1, 5, 6, 7], "00000.jpg, 00001.jpg, 00005.jpg to 00007.jpg"),
        ([3], "00003.jpg"),
    ],
)
def test_neighbours_are_a_range(numbers, told):
    assert listed_names([FRAMES[k] for k in numbers], FRAMES) == told


def test_what_is_not_told_is_counted():
    everyone = [str(k) for k in range(40)]
    assert listed_names(everyone[0:16:2], everyone) == EVEN
    assert listed_names(everyone[0:18:2], everyone) == f"{EVEN} and 1 other"
    assert listed_names([*everyone[0:16:2], *everyone[20:30]], everyone) == f"{EVEN} and 10 others"
    # Without an order nothing is a range.
    assert listed_names(everyone[:10]) == "0, 1, 2, 3, 4, 5, 6, 7 and 2 others"


@pytest.mark.parametrize(
    ("minutes", "said"),
    [(1.0, "1 minute"), (1.5, "1.5 minutes"), (0.25, "0.25 minutes"), (9.96, "10 minutes")]
    + [(4.8, "4.8 minutes"), (30.4, "30 minutes")],
)
def test_minutes_below_ten_have_a_decimal(minutes, said):
    assert minutes_text(minutes) == said
