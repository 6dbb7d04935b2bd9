"""The damaged files of experiments/hostile are what they are said to be."""

import io
import json
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from experiments.hostile import clouds, fuzz, mutate, pictures, settings
from experiments.hostile.fuzz import outcome
from experiments.hostile.reader import Reader, saved, text
from gaussray.io.safe.arrays import read_npz


ROOT = Path(__file__).resolve().parents[1]
ENTRIES = {"a.npy": saved(np.arange(6.0)), "é.npy": b"x", "b.npy": b""}


@pytest.mark.parametrize("deflated", [True, False])
def test_an_archive_is_a_whole_zip_file(deflated):
    with zipfile.ZipFile(io.BytesIO(mutate.packed(ENTRIES, deflated))) as archive:
        assert archive.testzip() is None
        assert {name: archive.read(name) for name in archive.namelist()} == ENTRIES
        method = zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED
        assert {entry.compress_type for entry in archive.infolist()} == {method}


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("json", text({"frames": [{"time": 0.5}]})),
        ("npz", mutate.packed(ENTRIES, deflated=False)),
        ("png", pictures.picture(".png")),
        ("text", b"1 PINHOLE 4 3\n"),
    ],
)
def test_the_same_dice_damage_alike_and_nearly_always(kind, content):
    def made():
        return [mutate.damaged(np.random.default_rng(i), content, kind) for i in range(100)]

    first = made()
    assert first == made()
    assert sum(one != content for one in first) > 80


def test_a_header_is_damaged_as_the_json_that_it_is(tmp_path):
    told = text({"format": "x", "info": {"a": [1, 2]}}).decode()
    content = mutate.packed({"header.npy": saved(np.array(told))}, deflated=False)
    parsed = 0
    for i in range(200):
        (tmp_path / "a.npz").write_bytes(mutate.damaged_npz(np.random.default_rng(i), content))
        try:
            header = json.loads(str(read_npz(tmp_path / "a.npz")["header"]))
        except (ValueError, KeyError, RecursionError):
            continue
        parsed += header != json.loads(told)
    assert parsed > 10


def test_whole_files_are_accepted_and_outcomes_told_apart(tmp_path):
    for reader in (clouds.READERS["points-ply"], settings.READERS["yaml"]):
        for files in reader.samples():
            assert outcome(reader, files, tmp_path, {}) == ("accepted", "")

    def fails(error):
        def read(folder):
            raise error

        return outcome(Reader(list, read, {}), {}, tmp_path, {})[0]

    assert fails(ValueError(f"{tmp_path}: no file")) == "refused"
    assert fails(ValueError("no file")) == "unclear"
    assert fails(ValueError(f"{tmp_path}: {'a' * 9999}")) == "unclear"
    assert fails(json.JSONDecodeError(str(tmp_path), "", 0)) == "unclear"
    assert fails(KeyError(f"{tmp_path}")) == "crashed"
    assert fails(MemoryError()) == "memory"


class Process:
    """One that works on as many inputs as it is looked at, then ends so, or stands still."""

    def __init__(self, board, inputs, exitcode, *, ends=True):
        self.board, self.left, self.exitcode, self.ends = board, inputs, exitcode, ends

    def is_alive(self):
        return self.left > 0 or not self.ends

    def join(self, seconds=None):
        self.left -= 1
        self.board[0] += self.left > 0

    def kill(self):
        self.left, self.ends = 0, True


def test_a_process_that_dies_or_stands_still_is_known(monkeypatch):
    monkeypatch.setattr(fuzz, "SECONDS", 0.05)
    board, never = np.zeros(2, np.int64), float("inf")
    assert fuzz.watched(Process(board, 3, 0), board, never) == ""
    assert fuzz.watched(Process(board, 3, -9), board, never) == "killed"
    assert fuzz.watched(Process(board, 3, 0, ends=False), board, never) == "hung"
    unfinished = Process(board, 10**6, 0)
    assert fuzz.watched(unfinished, board, time.monotonic()) == "" and not unfinished.is_alive()


# For the life of a process, so in one of its own.
SPRINGS = """
import os, pathlib, pickle, subprocess, sys
from experiments.hostile.trap import Trap
folder = pathlib.Path(sys.argv[1])
(folder / "a").write_text("a")
os.chdir(folder)
trap = Trap(folder)
open("/etc/passwd").close()
assert not trap.sprung
deeds = {
    "": lambda: ((folder / "a").read_text(), open("a").close(), open("./b", "w").close()),
    "open /etc/passwd": lambda: open("/etc/passwd").close(),
    "open /etc/hosts": lambda: os.close(os.open(b"../../../../../../../../etc/hosts", os.O_RDONLY)),
    "subprocess.Popen": lambda: subprocess.run(["true"]),
    "os.system": lambda: os.system("true"),
    "pickle.find_class": lambda: pickle.loads(b"cos\\ngetcwd\\n."),
}
for said, deed in deeds.items():
    with trap:
        deed()
    assert trap.sprung.startswith(said) and bool(trap.sprung) == bool(said), (said, trap.sprung)
"""


def test_the_trap_knows_what_leads_out_of_the_folder(tmp_path):
    command = [sys.executable, "-c", SPRINGS, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
