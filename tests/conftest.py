"""Double precision for every test, shapes checked at run time, ranks never promoted in silence."""

import copy
import gc
import importlib.metadata
import importlib.util
import os
import pathlib
import subprocess
import sys


# What is compiled is kept from run to run of the tests, and the user's own cache left alone.
COMPILED = pathlib.Path(__file__).parents[1] / ".pytest_cache" / "compiled"
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(COMPILED))
# A small program loads five times faster than it compiles, and there are thousands of them.
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# XLA's older way to emit code for a CPU compiles in half the time, and programs that are not cut
# into parts for threads, of which the workers of the tests leave none idle, in six sevenths of
# that. A version that does not know a flag ends the process, so only those that were tried are
# told. Flags are part of a program's key in the cache: a worker, which inherits them, must not add
# them again.
FLAGS = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
flags = os.environ.get("XLA_FLAGS", "")
if importlib.metadata.version("jaxlib").startswith("0.10.") and FLAGS not in flags:
    os.environ["XLA_FLAGS"] = f"{flags} {FLAGS}".strip()

import filelock  # noqa: E402
import host_arrays  # noqa: E402
import jax  # noqa: E402
import pytest  # noqa: E402
from jax._src.interpreters import mlir  # noqa: E402


if importlib.util.find_spec("beartype"):
    from jaxtyping import install_import_hook

    install_import_hook("gaussray", "type_checker.checked")

# The files that take longest, longest first.
LONG = (
    "render/test_picture.py",
    "tracer/test_cpu_march.py",
    "tracer/test_transient.py",
    "reconstruct/test_pipeline.py",
    "reconstruct/initialize/stereo/test_matching.py",
    "reconstruct/initialize/test_body_tracking.py",
    "test_docs.py",
    "reconstruct/test_scaled_motion.py",
    "reconstruct/test_previous_version.py",
    "render/test_focal_derivative.py",
    "runtime/test_stored_programs.py",
    "render/aov/test_labeller.py",
    "tracer/test_trace.py",
    "tracer/test_traverse.py",
    "prepare/test_pipeline.py",
    "test_torch.py",
    "camera/test_wide_lenses.py",
    "render/randomize/test_generate.py",
    "cli/test_main.py",
    "render/randomize/test_clearance.py",
    "reconstruct/test_camera_refinement.py",
    "calibrate/test_residuals.py",
    "viewer/test_preview.py",
    "prepare/test_sync.py",
    "runtime/test_windows.py",
    "test_benchmarks.py",
    "camera/test_lens.py",
    "cli/test_commands.py",
    "dataset/test_manifest.py",
    "reconstruct/test_transient_motion.py",
    "render/test_renderer.py",
    "tracer/test_kernel.py",
    "reconstruct/simplify/test_candidate.py",
    "reconstruct/simplify/test_prune.py",
)
# Room for what the largest module compiles.
MAPPINGS = 45_000


class SharedContext:
    """A function that makes contexts, each for this many calls: one keeps what constants were
    written in it."""

    CALLS = 100

    def __init__(self, make):
        self.make, self.calls = make, 0

    def __call__(self):
        if self.calls % self.CALLS == 0:
            self.context = self.make()
        self.calls += 1
        return self.context


jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
# Most programs run once: XLA without its optimisations, and operations without where they stand.
jax.config.update("jax_disable_most_optimizations", True)
jax.config.update("jax_traceback_in_locations_limit", 0)
if importlib.metadata.version("jax").startswith("0.10."):
    # JAX writes every program in a context of MLIR of its own, which holds megabytes as long as
    # the program lives and takes as long to make as half a small program to compile: those that
    # follow one another share one.
    mlir.make_ir_context = SharedContext(mlir.make_ir_context)
# Arrays that are made of numbers of the host outside of `jit` are made on the host: JAX would
# compile a program for each shape, which was half of all programs.
host_arrays.install()
# What JAX keeps of each program lives long: the garbage collector need not look at it often.
gc.set_threshold(50_000, 20, 20)


# Compiles the machine code of the tracer on a CPU, as `machine_code_once` does.
COMPILE = """
import sys, filelock
with filelock.FileLock(sys.argv[1]):
    from gaussray.tracer.cpu import lists as cpu_lists, march as cpu_march
    cpu_march.register_forward()
    cpu_march.register_backward()
    cpu_lists.register_lists()
"""
COMPILING = pytest.StashKey[subprocess.Popen]()


def pytest_configure(config):
    """While workers collect the tests, the process that started them compiles machine code, so
    that they load it and need not compile it each."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        COMPILED.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-c", COMPILE, str(COMPILED / "machine_code.lock")]
        config.stash[COMPILING] = subprocess.Popen(command, cwd=COMPILED.parents[1])


def pytest_unconfigure(config):
    if COMPILING in config.stash:
        config.stash[COMPILING].wait()


@pytest.fixture(scope="session", autouse=True)
def machine_code_once():
    """One process compiles machine code; others that need it wait, and load it."""
    from gaussray.runtime import machine_code

    COMPILED.mkdir(parents=True, exist_ok=True)
    lock, entry = filelock.FileLock(COMPILED / "machine_code.lock"), machine_code.entry

    def compiled(function):
        with lock:
            return entry(function)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine_code, "entry", compiled)
        yield


def pytest_collection_modifyitems(items):
    """The files that take longest come first, so that all processes end together; tests marked
    `gpu` are skipped where JAX sees no CUDA device."""
    tests = pathlib.Path(__file__).parent
    rank = {str(pathlib.Path(name)): place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: rank.get(os.path.relpath(item.path, tests), len(LONG)))
    if jax.default_backend() == "gpu":
        return
    skip = pytest.mark.skip(reason="no CUDA device")
    for item in items:
        if "gpu" in item.keywords:
            item.add_marker(skip)


def pytest_collection_finish():
    """Modules and tests live to the end: the garbage collector need not look at them again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def own_programs():
    """Programs are traced: a test may have replaced what a kept one was made of."""
    from gaussray.runtime import jit_cache

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jit_cache, "keep_machine_code", lambda *_: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def parsed_once():
    """The files of conf/ are parsed once, not for each of the hundreds of commands that compose
    them."""
    from hydra._internal.config_repository import ConfigRepository

    parse, parsed = ConfigRepository.load_config, {}

    def load_config(self, config_path):
        if len(self.sources) > 3:  # Hydra's own, conf/ and the schema: a test added a folder
            return parse(self, config_path)
        if config_path not in parsed:
            parsed[config_path] = parse(self, config_path)
        return copy.deepcopy(parsed[config_path])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConfigRepository, "load_config", load_config)
        yield


@pytest.fixture(scope="module", autouse=True)
def few_mappings():
    """Forget compiled programs before they are too many: each holds mappings of memory, of which
    Linux allows a process 65,530, and XLA crashes beyond them. The others stay, and the garbage
    collector need not look at them again."""
    yield
    maps = pathlib.Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MAPPINGS:
        jax.clear_caches()
        gc.unfreeze()
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module")
def optimized_programs():
    """XLA with its optimisations, for modules in which running takes longer than compiling."""
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", True)


@pytest.fixture(scope="module")
def known_sizes():
    """Lists with room for every toy: nothing is measured, and scenes that differ in numbers alone
    share what is compiled. Where they are too short after all, they grow as ever."""
    from gaussray.reconstruct import step_setup
    from gaussray.reconstruct.block_sizes import BlockSizes
    from gaussray.reconstruct.simplify import candidate_meter
    from gaussray.render import renderer as render
    from gaussray.tracer.options import grid_levels
    from gaussray.tracer.traverse import Capacity

    def room(trace, transients, dtype):
        briefly = 64 if transients is not None else 0
        return Capacity((512,) * grid_levels(trace, dtype), 512, 64, briefly)

    def of_stages(structure, layout, settings, arguments, dtype):
        scene = jax.tree.unflatten(structure, arguments[0])
        return room(settings.trace, scene.transient, dtype)

    def of_program(scene, camera, part, *, settings):
        return room(settings.trace, scene.transient, camera.time.dtype)

    def of_candidate(motion, rays, *, options, headroom):
        return room(options, motion.transient, rays.time.dtype)

    def of_block(state, views, batches, *_, options, mesh, keys, growth):
        sizes = room(options.trace, state.parameters.transient, views.time.dtype)
        return BlockSizes(sizes, mesh, keys)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render, "staged_capacity", of_stages)
        patch.setattr(render, "single_program_capacity", of_program)
        patch.setattr(step_setup, "measure_sizes", of_block)
        patch.setattr(candidate_meter, "measure", of_candidate)
        yield
