"""What no file may make a reader do: open others elsewhere, run programs, make objects, call out.

Python itself tells of it (its audit events); what libraries of other languages open is not heard.
"""

import os
import sys
from pathlib import Path


FORBIDDEN = (
    *("os.system", "os.exec", "os.fork", "os.posix_spawn", "os.spawn", "subprocess.Popen"),
    *("pickle.find_class", "socket.connect", "socket.bind", "urllib.Request"),
    *("os.symlink", "os.link", "os.chmod", "os.kill"),
)
# What Python, its packages and JAX open of their own accord.
OWN = (
    *(sys.prefix, sys.base_prefix, str(Path(__file__).resolve().parents[2])),
    *("/proc/self", "/sys/", os.devnull),
    *filter(None, [os.environ.get("JAX_COMPILATION_CACHE_DIR")]),
)


class Trap:
    """What was done that is forbidden while it was set, if anything; for the process's life."""

    def __init__(self, folder: Path):
        self.allowed = (str(folder), *OWN)
        self.armed, self.sprung = False, ""
        sys.addaudithook(self._heard)

    def __enter__(self) -> "Trap":
        self.armed, self.sprung = True, ""
        return self

    def __exit__(self, *_: object) -> None:
        self.armed = False

    def _heard(self, event: str, told: tuple) -> None:
        if not self.armed:
            return
        if event in FORBIDDEN:
            self.sprung = f"{event}{told!r:.300}"
        elif event == "open" and isinstance(told[0], str | bytes):
            path = os.path.abspath(os.fsdecode(told[0]))
            if not path.startswith(self.allowed):
                self.sprung = f"open {path:.300}"
