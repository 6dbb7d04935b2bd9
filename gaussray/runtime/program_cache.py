"""A bounded cache of compiled programs, which releases the memory of those that it forgets."""

import functools
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from importlib.metadata import version
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax


_P = ParamSpec("_P")
_R = TypeVar("_R")


def quick_compilation() -> dict[str, bool] | None:
    """Options of a compiler for CPUs that takes half the time, for code that may run a tenth
    slower; None where the installed version of JAX may not know them."""
    known = version("jaxlib").startswith("0.10.") and jax.default_backend() == "cpu"
    return {"xla_cpu_use_fusion_emitters": False} if known else None


@functools.cache
def loops_for_sums() -> dict[str, str] | None:
    """Options of a compiler for CPUs that sums over few numbers in loops of its own: by its library
    (YNNPACK) the sum over three numbers of each of 20,000 Gaussians takes 25 times as long. None
    for other devices, and where the installed version of XLA does not know the library."""
    options = {"xla_cpu_experimental_ynn_fusion_type": ""}
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return None
    return options


def looped_jit(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """`eqx.filter_jit` with `loops_for_sums`, which are found at the first call: only then are the
    devices known."""
    jit: Any = eqx.filter_jit  # Its types leave out the options that it hands on to `jax.jit`.
    compiled = functools.cache(lambda: jit(function, compiler_options=loops_for_sums()))

    @functools.wraps(function)
    def looped(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        return compiled()(*args, **kwargs)

    return looped


class ProgramCache:
    """Decorates a function that makes compiled programs: it keeps the `most` used last.

    A forgotten program gives back its memory mappings, of which Linux allows a process 65,530; a
    program for a CPU takes up to 1,000 of them.
    """

    def __init__(self, most: int):
        self.most = most
        self._programs: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, make: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(make)
        def program(*key: Hashable) -> Any:
            with self._lock:
                if key not in self._programs:
                    self._programs[key] = make(*key)
                self._programs.move_to_end(key)
                if len(self._programs) > self.most:
                    _, forgotten = self._programs.popitem(last=False)
                    forgotten.clear_cache()
                return self._programs[key]

        return program
