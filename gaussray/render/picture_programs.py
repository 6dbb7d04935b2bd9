"""A picture in stages, each a program of its own: camera, motion, lists, march, mean.

Only the first stage knows the camera, so that all cameras share the programs of the others, which
take most of the compilation. Every device of a mesh runs each stage on arguments of its own (their
leading axis); no device waits for another.
"""

import dataclasses
import functools
from collections.abc import Callable, Hashable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jax.tree_util import PyTreeDef
from jaxtyping import Array, Float, Int

from gaussray.camera.rays import Rays
from gaussray.render.camera_layout import CameraLayout
from gaussray.render.compiled import ProgramSettings, apply_weight, merge_reports, picture_values
from gaussray.render.frame_times import even_key_times, frame_span, key_times
from gaussray.render.list_sizes import enlarge_program_capacity
from gaussray.render.options import RenderOptions
from gaussray.render.parts import Part
from gaussray.render.samples import sample_points, sample_rays
from gaussray.runtime.program_cache import ProgramCache, quick_compilation
from gaussray.runtime.stored_programs import KeptProgram
from gaussray.scene.deformation import register_machine_code
from gaussray.tracer.composite import Pixels
from gaussray.tracer.motion import scene_motion
from gaussray.tracer.options import TraceOptions, on_cpu_kernel, on_kernel
from gaussray.tracer.prepare import Prepared, prepare
from gaussray.tracer.trace import (
    Report,
    find_candidates,
    make_lists_known,
    march_function,
    march_lists,
)
from gaussray.tracer.traverse import Candidates, Capacity


# Leaves of a scene; with a leading axis of devices the numbers of a camera and a part of a picture.
StageArguments = tuple[list[Any], np.ndarray, Part]


class SampleSums(eqx.Module):
    """Sums over samples.

    Args:
        pixels: traced rays by lens (one, or one per colour channel), times the weights of the rays.
        weight: weights of the rays; None is 1.
        report: the trace's report.
    """

    pixels: Pixels
    weight: Float[Array, "lenses slots"] | None
    report: Report


def uses_stages(options: RenderOptions, trace: TraceOptions) -> bool:
    """Whether pictures are rendered in stages.

    Args:
        options: not if they imitate splatting: Gaussians then depend on the camera.
        trace: options of the tracer; not with the CUDA kernels.
    """
    return not options.imitates_splatting and not on_kernel(trace, jnp.float32)


def render_staged(
    structure: PyTreeDef,
    layout: CameraLayout,
    settings: ProgramSettings,
    arguments: StageArguments,
) -> tuple[Array, Report]:
    """Render a part on every device: red, green, blue, coverage and mean distance, and a report.

    Args:
        structure: structure of the scene.
        layout: layout of the camera's numbers.
        settings: list sizes, key states, options and devices.
        arguments: leaves of the scene, numbers of the camera and part of the picture.
    """
    stages = _PicturePrograms(structure, layout, settings)
    leaves, row, part = arguments
    motion, sums = None, None
    for sample in range(settings.options.samples):
        rays, times = stages.camera(row, part, np.int32(sample))
        motion = stages.motion(leaves, times) if motion is None else motion
        lists, skipped = stages.lists(motion, rays)
        sample_sums = stages.march(motion, rays, lists, skipped)
        sums = sample_sums if sums is None else stages.add(sums, sample_sums)
    return stages.mean(sums, part.slot, np.float32(settings.options.samples))


def measure_staged(
    structure: PyTreeDef,
    layout: CameraLayout,
    settings: ProgramSettings,
    arguments: StageArguments,
) -> list[int]:
    """Measure the list sizes that the first sample of a part needs.

    Args:
        structure, layout, settings, arguments: as for `render_staged`; list sizes grow from these.
    """
    leaves, row, part = arguments
    while True:
        stages = _PicturePrograms(structure, layout, settings)
        stages.expect(arguments)
        rays, times = stages.camera(row, part, np.int32(0))
        lists, _ = stages.lists(stages.motion(leaves, times), rays)
        needed = np.asarray(lists.needed)
        needed = [int(n) for n in needed.reshape(-1, needed.shape[-1]).max(axis=0)]
        if not np.asarray(lists.dropped).any():
            return needed
        capacity = enlarge_program_capacity(settings.capacity, needed, staged=True)
        settings = dataclasses.replace(settings, capacity=capacity)


class _PicturePrograms:
    """The programs of a picture, each shared with all pictures that it is the same for."""

    def __init__(self, structure: PyTreeDef, layout: CameraLayout, settings: ProgramSettings):
        mesh, trace, capacity = settings.mesh, settings.trace, settings.capacity
        if on_cpu_kernel(trace, jnp.float32):
            # Machine code makes room for the longest list when that is known.
            capacity = dataclasses.replace(capacity, slots=capacity.pairs)
        samples = settings.options.samples
        self.camera = camera_program(layout, samples, mesh)
        sizes = settings.keys, capacity.transient
        self.motion = motion_program(structure, trace, sizes, mesh, settings.quick)
        self.lists = lists_program(trace, capacity, mesh, settings.quick)
        self.march = _march_program(trace, capacity.slots, mesh)
        self.add, self.mean = _add_program(mesh), _mean_program(mesh)
        self._one_device, self._samples = mesh is None or mesh.size == 1, samples

    def expect(self, arguments: StageArguments) -> None:
        """Begin to compile all programs, or to read them, at the same time."""
        if not self._one_device:
            return
        leaves, row, part = arguments
        camera = self.camera.expect(row, part, np.int32(0))
        if camera is None:
            return
        rays, times = camera
        motion = self.motion.expect(leaves, times)
        lists, skipped = self.lists.expect(motion, rays)
        sums = self.march.expect(motion, rays, lists, skipped)
        if self._samples > 1:
            self.add.expect(sums, sums)
        self.mean.expect(sums, part.slot, np.float32(self._samples))


@ProgramCache(48)
def camera_program(
    layout: CameraLayout, samples: int, mesh: Mesh | None
) -> Callable[..., tuple[Rays, tuple[Array, Array]]]:
    """(numbers of a camera, part, index of a sample) -> rays, by lens and slot; the time of the
    part's row, and the first and last time of the frame.

    Args:
        layout, samples: layout of the camera's numbers, number of samples of a pixel.
        mesh: as for `on_devices`.
    """

    def run(row: Array, part: Part, sample: Int[Array, ""]):
        camera = layout.camera(row)
        u = jax.lax.dynamic_slice_in_dim(sample_points(part, samples), sample, 1)
        mask = None
        if part.share is not None:
            mask = jax.lax.dynamic_slice_in_dim(part.share.mask, sample, 1)
        colors = camera.chromatic
        lenses = [None] if colors is None else [colors[0], colors[1], colors[2]]
        rays = [sample_rays(camera, part.pixel, u, mask, lens) for lens in lenses]
        rays = jax.tree.map(lambda *x: jnp.concatenate(x), *rays)
        return rays, (key_times(camera, part, 0), frame_span(camera, part))

    return on_devices(run, mesh, (layout, samples), common=(2,))


@ProgramCache(12)
def motion_program(
    structure: PyTreeDef,
    trace: TraceOptions,
    sizes: tuple[int, int],
    mesh: Mesh | None,
    quick: bool,
) -> Callable[..., Prepared]:
    """(leaves of a scene, times) -> the scene across these times, sorted into a grid.

    Args:
        structure, trace: structure of the scene, options of the tracer.
        sizes: number of key states (0: one, for the part's row), places for alive transients.
        mesh, quick: as for `on_devices`.
    """
    keys, transient = sizes
    capacity = Capacity((), 0, 0, transient)

    def run(leaves: list[Array], times: tuple[Array, Array]) -> Prepared:
        scene, (key_time, span) = jax.tree.unflatten(structure, leaves), times
        if keys:
            key_time = even_key_times(span, keys)
        motion = scene_motion(scene, key_time, scene.time_range)
        return prepare(motion, span, options=trace, capacity=capacity)

    key = structure, trace, sizes
    return on_devices(run, mesh, key, common=(0,), quick=quick, needs=register_machine_code)


@ProgramCache(12)
def lists_program(
    trace: TraceOptions, capacity: Capacity, mesh: Mesh | None, quick: bool
) -> Callable[..., tuple[Candidates, Array]]:
    """(scene, rays) -> the Gaussians that every bundle may meet; how many are not finite.

    Args:
        trace, capacity: options of the tracer, sizes of its lists.
        mesh, quick: as for `on_devices`.
    """

    def run(scene: Prepared, rays: Rays) -> tuple[Candidates, Array]:
        return find_candidates(scene, rays, options=trace, capacity=capacity)

    needs = functools.partial(make_lists_known, trace, jnp.float32)
    return on_devices(run, mesh, (trace, capacity), quick=quick, needs=needs)


@ProgramCache(12)
def _march_program(trace: TraceOptions, slots: int, mesh: Mesh | None) -> Callable[..., SampleSums]:
    """(scene, rays, lists, Gaussians that are not finite) -> what the rays see."""

    def run(scene: Prepared, rays: Rays, lists: Candidates, skipped: Array) -> SampleSums:
        pixels, hits = march_lists(scene.motion, rays, lists, options=trace, slots=slots)
        if rays.weight is not None:
            pixels = apply_weight(pixels, rays.weight)
        return SampleSums(pixels, rays.weight, Report(lists.needed, lists.dropped, skipped, hits))

    compile_march, kind = (
        functools.partial(march_function, trace, jnp.float32),
        on_cpu_kernel(trace, jnp.float32),
    )
    return on_devices(run, mesh, (trace, slots, kind), needs=compile_march)


@ProgramCache(4)
def _add_program(mesh: Mesh | None) -> Callable[[SampleSums, SampleSums], SampleSums]:
    def run(one: SampleSums, other: SampleSums) -> SampleSums:
        reports = jax.tree.map(lambda *x: jnp.stack(x), one.report, other.report)
        sums = (one.pixels, one.weight), (other.pixels, other.weight)
        pixels, weight = jax.tree.map(jnp.add, *sums)
        return SampleSums(pixels, weight, merge_reports(reports))

    return on_devices(run, mesh, ())


@ProgramCache(4)
def _mean_program(mesh: Mesh | None) -> Callable[..., tuple[Array, Report]]:
    """(sums, slots of the pixels, number of samples) -> values of the pixels, report."""

    def run(sums: SampleSums, slot: Array, samples: Float[Array, ""]) -> tuple[Array, Report]:
        both = sums.pixels, sums.weight
        pixels, weight = jax.tree.map(lambda x: (x / samples.astype(x.dtype))[:, slot], both)
        return picture_values(pixels, weight), sums.report

    return on_devices(run, mesh, (), common=(2,))


def on_devices(
    function: Callable,
    mesh: Mesh | None,
    key: tuple[Hashable, ...],
    common: tuple[int, ...] = (),
    quick: bool = False,
    needs: Callable[[], Any] = lambda: None,
) -> KeptProgram:
    """Compile a function that every device of a mesh runs on its own arguments.

    Args:
        function, key: the function, and what it was made for.
        mesh: the devices; None is one device.
        common: positions of arguments that all devices share; others have a leading axis of them.
        quick: whether it is compiled quickly; it may then run a tenth slower.
        needs: as for `KeptProgram`.
    """
    compiler = quick_compilation() if quick else None
    key = (function.__qualname__, *key, mesh)

    def one_device(*arguments):
        local = (
            x if i in common else jax.tree.map(lambda leaf: leaf[0], x)
            for i, x in enumerate(arguments)
        )
        return jax.tree.map(lambda x: x[None], function(*local))

    if mesh is None or mesh.size == 1:
        return KeptProgram(one_device, key, compiler, needs)

    split = PartitionSpec(mesh.axis_names[0])

    def on_all_devices(*arguments):
        specs = tuple(PartitionSpec() if i in common else split for i in range(len(arguments)))
        spread: Callable = jax.shard_map(
            one_device, mesh=mesh, in_specs=specs, out_specs=split, check_vma=False
        )
        return spread(*arguments)

    return KeptProgram(on_all_devices, key, compiler, needs)
