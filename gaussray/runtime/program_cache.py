"""A bounded cache of compiled programs, which releases the memory of those that it forgets."""

import functools
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from importlib.metadata import version
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax


# XLA's option by which it compiles and times dozens of kernels in Triton's language for each
# product of matrices: two thirds of what a training step takes to compile. The products are small.
TRITON = "xla_gpu_enable_triton_gemm"
_P = ParamSpec("_P")
_R = TypeVar("_R")


def quick_compilation() -> dict[str, bool] | None:
    """Options of a compiler for CPUs that takes half the time, for code that may run a tenth
    slower; None where the installed version of JAX may not know them."""
    known = version("jaxlib").startswith("0.10.") and jax.default_backend() == "cpu"
    return {"xla_cpu_use_fusion_emitters": False} if known else None


@functools.cache
def step_compiler() -> dict[str, Any] | None:
    """Options of the compiler for programs of training steps; None where the installed version of
    XLA does not know them.

    On a CPU, sums over few numbers are loops of XLA's own: by its library (YNNPACK) the sum over
    three numbers of each of 20,000 Gaussians takes 25 times as long. On a GPU matrices are
    multiplied without `TRITON`.
    """
    on_cpu = jax.default_backend() == "cpu"
    options: dict[str, Any] = {"xla_cpu_experimental_ynn_fusion_type": ""}
    if not on_cpu:
        options = {} if TRITON in os.environ.get("XLA_FLAGS", "") else {TRITON: False}
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return None
    return options


def step_jit(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """`eqx.filter_jit` with the options of `step_compiler`, which are found at the first call: only
    then are the devices known."""
    jit: Any = eqx.filter_jit  # Its types leave out the options that it hands on to `jax.jit`.
    made = functools.cache(lambda: jit(function, compiler_options=step_compiler()))
    lock = threading.Lock()

    @functools.wraps(function)
    def called(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        # Of several threads one makes it: each would compile its own programs.
        with lock:
            compiled = made()
        return compiled(*args, **kwargs)

    return called


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
