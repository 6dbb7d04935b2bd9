"""CUDA C++ inside a JAX program: compiled when it is traced, launched by XLA."""

import ctypes
import functools
import glob
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array

from gaussray.runtime.program_files import kept_text


# XLA's own way to launch PTX. An attribute of the call for each thing a launch needs.
_TARGET = "__gpu$xla.gpu.ptx"


def available() -> bool:
    """Whether JAX's default backend is a CUDA device, XLA launches PTX (from 0.8 on) and CUDA's
    run-time compiler is installed."""
    recent = jax.__version_info__ >= (0, 8)
    return recent and jax.default_backend() == "gpu" and _nvrtc() is not None


@functools.cache
def _nvrtc() -> ctypes.CDLL | None:
    """CUDA's run-time compiler: it comes with JAX's CUDA wheels, or with the toolkit."""

    def version(path: str) -> int:
        match = re.search(r"\.so\.(\d+)", path)
        return int(match.group(1)) if match else 0

    libraries = [
        path for place in sys.path for path in glob.glob(f"{place}/nvidia/*/lib/libnvrtc.so*")
    ]
    for path in [*sorted(libraries, key=version, reverse=True), "libnvrtc.so.13", "libnvrtc.so.12"]:
        try:
            return ctypes.CDLL(path)
        except OSError:
            continue
    return None


def ptx(source: Path, macros: Mapping[str, int | float]) -> str:
    """The PTX of a CUDA C++ file, for the default device.

    Args:
        source: the file.
        macros: values of its macros by name; floats become single-precision literals.
    """
    capability = jax.local_devices()[0].compute_capability.replace(".", "")
    defined = tuple(f"-D{k}={_literal(v)}" for k, v in macros.items())
    target = (f"--gpu-architecture=compute_{capability}", "--device-as-default-execution-space")
    return _compiled(source, (*target, "--std=c++17", *defined))


def _literal(value: int | float) -> str:
    return f"{value!r}f" if isinstance(value, float) else str(value)


@functools.lru_cache(maxsize=64)
def _compiled(source: Path, options: tuple[str, ...]) -> str:
    """The PTX of a file, from disk where an earlier process has made it."""
    library = _nvrtc()
    if library is None:
        raise ImportError(
            "trace.backend=kernel needs NVIDIA's run-time compiler libnvrtc: pip install "
            "-e '.[cuda]', or choose trace.backend=array."
        )
    major, minor = ctypes.c_int(), ctypes.c_int()
    library.nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
    text = source.read_text()
    key = "ptx", source.name, text, options, major.value, minor.value
    return kept_text(key, lambda: _ptx_of(library, source, text, options))


def _ptx_of(library: ctypes.CDLL, source: Path, text: str, options: tuple[str, ...]) -> str:
    program = ctypes.c_void_p()

    def read(kind: str) -> str:
        size = ctypes.c_size_t()
        getattr(library, f"nvrtcGet{kind}Size")(program, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        getattr(library, f"nvrtcGet{kind}")(program, buffer)
        return buffer.value.decode()

    arguments = (ctypes.c_char_p * len(options))(*(option.encode() for option in options))
    name = source.name.encode()
    library.nvrtcCreateProgram(ctypes.byref(program), text.encode(), name, 0, None, None)
    try:
        if library.nvrtcCompileProgram(program, len(options), arguments):
            raise RuntimeError(f"{source} does not compile:\n{read('ProgramLog')}")
        return read("PTX")
    finally:
        library.nvrtcDestroyProgram(ctypes.byref(program))


def launch(
    name: str,
    code: str,
    operands: Sequence[Array],
    results: Sequence[jax.ShapeDtypeStruct],
    *,
    blocks: int,
    threads: int,
    sums: Sequence[Array] = (),
) -> Sequence[Array]:
    """Results of the kernel `name(operands..., sums..., results...)`, then what it made of `sums`.

    The kernel writes every element of its results, and adds to its sums in place. (A sum is an
    operand that shares its memory with a result at the end of the list, which the kernel does not
    declare.)

    Args:
        name: name of the kernel in the code.
        code: PTX that holds the kernel (`ptx`).
        operands: arrays that the kernel reads.
        results: shapes and types of the arrays that it writes.
        blocks: number of thread blocks of the launch.
        threads: number of threads of a block.
        sums: values to which the kernel adds.

    Raises:
        TypeError: an array is not of 32-bit floats or integers, which is what kernels read.
    """
    wrong = [x.dtype for x in (*operands, *sums, *results) if x.dtype not in (np.float32, np.int32)]
    if wrong:
        raise TypeError(f"{name}: kernels take float32 and int32 arrays, got {wrong[0]}.")
    operand_count, result_count = len(operands), len(results)
    call = jax.ffi.ffi_call(
        _TARGET,
        (*results, *(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in sums)),
        vmap_method="sequential",
        input_output_aliases={operand_count + i: result_count + i for i in range(len(sums))},
    )
    total = operand_count + len(sums)
    out = call(
        *operands,
        *sums,
        name=name,
        kernel_type="ptx",
        kernel_data=code,
        grid_x=np.int32(blocks),
        grid_y=np.int32(1),
        grid_z=np.int32(1),
        block_x=np.int32(threads),
        block_y=np.int32(1),
        block_z=np.int32(1),
        shared_mem_bytes=np.int32(0),
        output_indices=tuple(range(total, total + result_count + len(sums))),
    )
    return tuple(out)
