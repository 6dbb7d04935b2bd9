"""What machines do, during each work: one clear message, and after it the work goes on.

`python -m experiments.faults.machine [--out DIR]`; full and read-only disks are small ones that are
mounted for the occasion, which takes root.
"""

import argparse
import contextlib
import io
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from experiments.faults.kill import contents, prepare
from experiments.faults.toy import records, words_of, write_capture
from gaussray.cli import main as command
from gaussray.dataset.manifest import write_manifest


# What is called over and over during a work, and at which call something happens.
MOMENTS = {
    "reconstruct": ("gaussray.reconstruct.log.RunLog.record", 30),
    "render": ("gaussray.render.dataset.write_picture", 6),
    "samples": ("gaussray.render.dataset.write_picture", 6),
    "evaluate": ("gaussray.evaluate.pipeline.write_image", 4),
}
# Of memory, for frames that need more.
GIGABYTES = 12
HOLDER = """
import sys, time
from gaussray.runtime.lock import lock_output
lock_output(sys.argv[1])
print("held", flush=True)
time.sleep(600)
"""
LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]),) * 2)
from gaussray.cli import main
main(sys.argv[2:])
"""


def said(words: list[str]) -> tuple[int, list[str]]:
    """Exit code and lines on stderr of a command, in this process."""
    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        try:
            command(words)
            code = 0
        except SystemExit as stop:
            code = int(stop.code or 0)
        except BaseException as error:
            code = 1
            print(f"{type(error).__name__}: {error}", file=err)
    return code, err.getvalue().splitlines()


@contextlib.contextmanager
def happens(work: str, act: Callable[[], Any]) -> Iterator[None]:
    """Something happens once in the middle of a work."""
    name, at = MOMENTS[work]
    calls = [0]
    with contextlib.ExitStack() as stack:
        patch = mock.patch(name, autospec=True)
        real = patch.get_original()[0]

        def call(*args, **kwargs):
            calls[0] += 1
            if calls[0] == at:
                act()
            return real(*args, **kwargs)

        stack.enter_context(patch).side_effect = call
        yield


class Machine:
    """A capture, a small disk, and what each work leaves if nothing happens."""

    def __init__(self, folder: Path, works: list[str]):
        self.folder, self.capture, self.disk = folder, folder / "capture", folder / "disk"
        self.works = works
        self.disk.mkdir(parents=True)
        write_capture(self.capture)
        self.whole: dict[str, Any] = {}
        self.rows: list[tuple[str, bool]] = []
        for work in self.works:
            with self.mounted() as out:
                code, lines = said(words_of(work, self.capture, out))
                if code:
                    raise SystemExit(f"{work}: {lines}")
                self.whole[work] = contents(out)

    @contextlib.contextmanager
    def mounted(self) -> Iterator[Path]:
        """A folder on a disk of 16 MB."""
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16m", "tmpfs", self.disk], check=True)
        try:
            yield self.disk / "run"
        finally:
            subprocess.run(["umount", self.disk], check=True)

    def fill(self) -> None:
        with contextlib.suppress(OSError), (self.disk / "ballast").open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass

    def lock(self) -> None:
        """A read-only view before the disk, which itself is busy."""
        subprocess.run(["mount", "--bind", self.disk, self.disk], check=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", self.disk], check=True)

    def unlock(self) -> None:
        subprocess.run(["umount", "-l", self.disk], check=True)

    def told(self, case: str, lines: list[str], held: bool, why: str = "") -> None:
        line = " ".join(lines).replace(str(self.folder), "DIR").replace("|", "/")
        self.rows.append((case, held))
        print(f"| {case} | {'held' if held else 'FAILED' + why} | {line[:300]} |", flush=True)

    def interrupted(self, fault: str, work: str, act: Callable, undo: Callable) -> None:
        """Something happens in the middle; then it is undone, and the same command ends."""
        with self.mounted() as out:
            words = words_of(work, self.capture, out)
            with happens(work, lambda: act(out)):
                code, lines = said(words)
            clear = code == 2 and len(lines) == 1 and str(self.folder) in lines[0]
            undo(out)
            again, more = said(words)
            same = again == 0 and contents(out) == self.whole[work]
            why = "" if clear else f": code {code}"
            why += "" if same else f"; again: {again} {' '.join(more)[:200]}"
            self.told(f"{fault}, {work}", lines, clear and same, why)

    def disks(self) -> None:
        """Full, read-only, and gone."""
        room = self.disk / "ballast"
        for work in self.works:
            self.interrupted("disk full", work, lambda _: self.fill(), lambda _: room.unlink())
            self.interrupted("read-only", work, lambda _: self.lock(), lambda _: self.unlock())
            self.interrupted("out removed", work, shutil.rmtree, lambda _: None)

    def no_folder(self) -> None:
        """A file in the folder's place."""
        out = self.folder / "file"
        out.touch()
        for work in self.works:
            code, lines = said(words_of(work, self.capture, out))
            held = code == 2 and len(lines) == 1 and "cannot be written" in lines[0]
            self.told(f"a file called as out, {work}", lines, held, f": code {code}")

    def pictures(self) -> None:
        """Pictures and scenes that go while they are in use."""
        copy = self.folder / "copy"
        for work, name in (("reconstruct", "images"), ("evaluate", "images"), ("render", "run")):
            if work not in self.works:
                continue
            shutil.copytree(self.capture, copy)
            out = self.folder / f"without_{name}_{work}"
            words = words_of(work, copy, out)
            if work == "reconstruct":
                words.append("fit.segment=2")
            with happens(work, lambda name=name: shutil.rmtree(copy / name)):
                code, lines = said(words)
            clear = code == 2 and len(lines) == 1 and str(copy) in lines[0]
            # What is read already is not missed.
            held = clear or (code == 0 and work == "render")
            self.told(f"{name} removed, {work}", lines, held, f": code {code}")
            shutil.rmtree(copy)

    def clock(self) -> None:
        """A clock that goes back a day with every look."""
        if "reconstruct" not in self.works:
            return
        now = [time.time()]

        def earlier() -> float:
            now[0] -= 86400
            return now[0]

        with self.mounted() as out, mock.patch("time.time", earlier):
            code, lines = said(words_of("reconstruct", self.capture, out))
            held = code == 0 and contents(out) == self.whole["reconstruct"]
            self.told("clock goes back, reconstruct", lines, held, f": code {code}")

    def two(self) -> None:
        """A folder that another process holds, and one that it held when it was killed."""
        for work in self.works:
            with self.mounted() as out:
                held = out / "takes" / "000000" if work == "samples" else out
                words = [sys.executable, "-c", HOLDER, str(held)]
                other = subprocess.Popen(words, stdout=subprocess.PIPE)
                assert other.stdout is not None and other.stdout.readline()
                code, lines = said(words_of(work, self.capture, out))
                named = code == 2 and len(lines) == 1 and f"process {other.pid}" in lines[0]
                other.send_signal(signal.SIGKILL)
                other.wait()
                again, more = said(words_of(work, self.capture, out))
                same = again == 0 and contents(out) == self.whole[work]
            self.told(f"two processes, {work}", lines, named and same, f": {code} {again} {more}")

    def memory(self) -> None:
        """Less memory than the work needs, of the host and of the device."""
        for case, side in (("host", 40000), ("device", 6000)):
            large = self.folder / f"{case}_large"
            shutil.copytree(self.capture / "run", large / "run")
            write_manifest(large / "run" / "cameras.json", records(side))
            words = words_of("render", large, self.folder / case)
            words += ["render.memory=1e6", "render.samples=64", "limits.picture=2000"]
            run = subprocess.run(
                [sys.executable, "-c", LIMITED, str(GIGABYTES * 10**9), *words],
                stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
            lines, code = run.stderr.strip().splitlines() or [""], run.returncode
            held = code == 2 and "out of memory" in lines[-1]
            self.told(
                f"{GIGABYTES} GB of memory, {side} x {side} pixels",
                lines[-1:],
                held,
                f": code {code}",
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="an empty folder; else a temporary one")
    parser.add_argument("--cases", default="disks,no_folder,pictures,clock,two,memory")
    parser.add_argument("--works", default=",".join(MOMENTS))
    chosen = parser.parse_args()
    folder = (chosen.out or Path(tempfile.mkdtemp(prefix="faults_"))).absolute()
    prepare(folder)
    machine = Machine(folder, chosen.works.split(","))
    print("| case | | what was said |\n|---|---|---|", flush=True)
    for name in chosen.cases.split(","):
        getattr(machine, name)()
    held = sum(held for _, held in machine.rows)
    print(f"{len(machine.rows)} cases tried, {held} held, {len(machine.rows) - held} failed")
    raise SystemExit(held < len(machine.rows))


if __name__ == "__main__":
    main()
