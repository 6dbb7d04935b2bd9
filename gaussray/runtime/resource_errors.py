"""Error messages for a full disk or exhausted memory: what was requested, and what to change."""

import errno
import os
import re
from collections.abc import Iterator

import jax


try:
    import resource
except ImportError:  # not on Windows
    resource = None

# Keys that reduce the memory of a command, most effective first.
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
    """Whether a full disk or an exhausted quota caused an error."""
    return any(isinstance(e, OSError) and e.errno in _FULL for e in _chain(error))


def is_memory(error: BaseException) -> bool:
    """Whether exhausted memory of the host or of a device caused an error."""
    return any(
        isinstance(e, MemoryError)
        or (isinstance(e, jax.errors.JaxRuntimeError | ValueError) and _exhausted(str(e)))
        or (isinstance(e, OSError) and e.errno == errno.ENOMEM)
        for e in _chain(error)
    )


def memory_message(verb: str, error: BaseException, again: str = "") -> str:
    """The message, one line, of a command that ran out of memory.

    It states the size of the failed request and of the memory, as far as they are known, and which
    keys to lower.

    Args:
        verb: the command, of which `LESS` has the keys.
        error: the error, whose text may name the size of the request.
        again: last sentence of the message: how to resume the command.
    """
    requested = _requested_bytes(str(error))
    text = "out of memory"
    if requested:
        text += f": {requested / 1e9:.3g} GB were requested at once"
    owner, room = _memory_size(error)
    if room:
        text += f" of a {owner} with {room / 1e9:.3g} GB"
    less = LESS.get(verb, "the size of what is read")
    if less.startswith("render.memory") and room:
        less = less.replace("render.memory", f"render.memory to {room / 4e9:.2g}", 1)
    return f"{text}. Lower {less}. {again}".rstrip()


def _exhausted(text: str) -> bool:
    return "RESOURCE_EXHAUSTED" in text or "Out of memory" in text or "bad_alloc" in text


def _requested_bytes(text: str) -> float:
    """The number of bytes that a message of JAX or NumPy names; 0 if it names none."""
    match = re.search(r"([\d.]+) ?(bytes|[KMGTPE]iB)", text)
    if not match:
        return 0.0
    power = 0 if match[2] == "bytes" else 1 + "KMGTPE".index(match[2][0])
    return float(match[1]) * 1024**power


def _memory_size(error: BaseException) -> tuple[str, int]:
    """Whose memory was exhausted ("device" or "host"), and its size in bytes; for the host at most
    the limit of the process, and 0 if unknown."""
    stats = jax.local_devices()[0].memory_stats() or {}
    if stats.get("bytes_limit") and not any(isinstance(e, MemoryError) for e in _chain(error)):
        return "device", int(stats["bytes_limit"])
    names = "SC_PHYS_PAGES", "SC_PAGE_SIZE"
    if resource is None or not set(names) <= set(os.sysconf_names):
        return "host", 0
    pages, size = (os.sysconf(name) for name in names)
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return "host", pages * size if limit == resource.RLIM_INFINITY else min(pages * size, limit)


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
