"""The CUDA kernels on a CPU: compiled by a C++ compiler, thread after thread (one_thread.h)."""

import ctypes
import hashlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np

from gaussray.runtime import cuda
from gaussray.tracer import kernel, options


HEADER = Path(__file__).with_suffix(".h")
COMPILER = shutil.which("g++") if sys.platform == "linux" else None
KERNELS = "gather", "sift", "forward", "backward"
# Bytes at which CUDA reads four floats at once.
ALIGNED = 16


def run_on_a_cpu(patch, folder):
    """Launch kernels by this module instead of XLA.

    Args:
        patch: a monkeypatch.
        folder: for libraries, one for each set of macros.
    """

    def launch(name, code, operands, results, *, blocks, threads, sums=()):
        def on_host(operands, sums):
            return _launched(folder, name, code, operands, results, sums, blocks, threads)

        shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in (*results, *sums)]
        return jax.pure_callback(
            on_host, tuple(shapes), tuple(operands), tuple(sums), vmap_method="sequential"
        )

    patch.setattr(cuda, "available", lambda: True)
    patch.setattr(options, "on_cpu_kernel", lambda *_: False)
    # Macros instead of PTX; sizes in it are replaced by others as ever.
    patch.setattr(kernel, "ptx", lambda source, macros: json.dumps(macros | _numbers(kernel)))
    patch.setattr(kernel, "launch", launch)


def _numbers(kernel):
    return {name: f"NUMBER_OF_{name}" for name in kernel._NUMBERS}


def _launched(folder, name, code, operands, results, sums, blocks, threads):
    """Results, then what the kernel made of the sums."""
    library = _library(folder, code)
    given = [_aligned(np.asarray(x)) for x in (*operands, *sums)]
    made = [_aligned(np.zeros(x.shape, x.dtype)) for x in results]
    places = [x.ctypes.data for x in (*given, *made)]
    function = getattr(library, f"launch_{name}")
    function.restype = ctypes.c_bool
    ended = function(blocks, threads, (ctypes.c_void_p * len(places))(*places))
    if not ended:
        raise RuntimeError(f"{name}: threads wait for one another for ever")
    return (*made, *given[len(operands) :])


def _aligned(array):
    room = np.zeros(array.nbytes + ALIGNED, np.uint8)
    start = -room.ctypes.data % ALIGNED
    copy = room[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


def _library(folder, code):
    """The kernels for a set of macros, compiled once."""
    macros = json.loads(code)
    path = folder / f"{hashlib.sha1(code.encode()).hexdigest()}.so"
    if not path.exists():
        source = path.with_suffix(".cpp")
        source.write_text(_source(macros))
        assert COMPILER is not None
        # Otherwise libraries share what their templates call static, whose size differs.
        options = ("-std=c++17", "-O1", "-w", "-shared", "-fPIC", "-fno-gnu-unique")
        subprocess.run([COMPILER, *options, "-o", str(path), str(source)], check=True)
    return ctypes.CDLL(str(path))


def _source(macros):
    """The kernels as C++: without PTX, and with a function that launches each."""
    text = kernel._SOURCE.read_text()
    # Sizes are read by PTX there.
    start, end = text.index("#define NUMBER(NAME)"), text.index("#define ALL ")
    text = text[:start] + text[end:]
    text = re.sub(r'asm\("rcp.approx.*', "y = 1 / x;", text)
    parts = [f"#define {name} {_literal(value)}" for name, value in macros.items()]
    parts += [f'#include "{HEADER}"', text]
    for name in KERNELS:
        found = re.search(rf"__global__ void [^;{{]*?\b{name}\(([^)]*)\)\s*{{", text)
        assert found is not None
        kinds = [word.rsplit("*", 1)[0] + "*" for word in found[1].split(",")]
        arguments = ", ".join(f"({kind.strip()})at[{i}]" for i, kind in enumerate(kinds))
        parts.append(
            f'extern "C" bool launch_{name}(int blocks, int threads, void **at) {{\n'
            f"  return run(blocks, threads, [=] {{ {name}({arguments}); }});\n}}"
        )
    return "\n".join(parts)


def _literal(value):
    return f"{value!r}f" if isinstance(value, float) else value
