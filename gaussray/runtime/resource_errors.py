"""What to say when a disk or a memory is full: what was asked for, and what to change."""

import errno
import os
import re
from collections.abc import Iterator

import jax


try:
    import resource
except ImportError:  # not on Windows
    resource = None

# What makes a verb need less memory, most effective first.
LESS = {
    "reconstruct": "fit.tiles, fit.points, density.growth, capture.scale or fit.memory",
    "demo": "fit.tiles, fit.points or render.memory",
    "render": "render.memory",
    "evaluate": "render.memory",
    "view": "render.memory or view.width",
    "calibrate": "calibrate.frames",
}
_FULL = {errno.ENOSPC, errno.EDQUOT}


def is_full(error: BaseException) -> bool:
    """Whether an error comes of a full disk or a used quota."""
    return any(isinstance(e, OSError) and e.errno in _FULL for e in _chain(error))


def is_memory(error: BaseException) -> bool:
    """Whether an error comes of memory that was not there, the host's or a device's."""
    return any(
        isinstance(e, MemoryError)
        or (isinstance(e, jax.errors.JaxRuntimeError | ValueError) and _exhausted(str(e)))
        or (isinstance(e, OSError) and e.errno == errno.ENOMEM)
        for e in _chain(error)
    )


def memory_message(verb: str, error: BaseException, again: str = "") -> str:
    """One line for a verb that ran out of memory: how much was asked for and was there, as far as
    that is known, and which key to lower."""
    asked = _asked(str(error))
    text = "out of memory"
    if asked:
        text += f": {asked / 1e9:.3g} GB were asked for at once"
    lender, room = _room(error)
    if room:
        text += f" of a {lender} with {room / 1e9:.3g} GB"
    less = LESS.get(verb, "the size of what is read")
    if less.startswith("render.memory") and room:
        less = less.replace("render.memory", f"render.memory to {room / 4e9:.2g}", 1)
    return f"{text}. Lower {less}. {again}".rstrip()


def _exhausted(text: str) -> bool:
    return "RESOURCE_EXHAUSTED" in text or "Out of memory" in text or "bad_alloc" in text


def _asked(text: str) -> float:
    """Bytes, of a message that names them."""
    found = re.search(r"([\d.]+) ?(bytes|[KMGTPE]iB)", text)
    if not found:
        return 0.0
    power = 0 if found[2] == "bytes" else 1 + "KMGTPE".index(found[2][0])
    return float(found[1]) * 1024**power


def _room(error: BaseException) -> tuple[str, int]:
    """Whose memory it was, a device's or the host's, and the bytes that this has, or lends to a
    process; 0 if it does not say."""
    stats = jax.local_devices()[0].memory_stats() or {}
    if stats.get("bytes_limit") and not any(isinstance(e, MemoryError) for e in _chain(error)):
        return "device", int(stats["bytes_limit"])
    names = "SC_PHYS_PAGES", "SC_PAGE_SIZE"
    if resource is None or not set(names) <= set(os.sysconf_names):
        return "host", 0
    pages, size = (os.sysconf(name) for name in names)
    lent = resource.getrlimit(resource.RLIMIT_AS)[0]
    return "host", pages * size if lent == resource.RLIM_INFINITY else min(pages * size, lent)


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
