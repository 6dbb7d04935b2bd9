"""Generates a randomised dataset: samples of camera parameters, drawn, checked and rendered."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from gaussray.dataset.manifest import FrameRecord
from gaussray.dataset.sample_manifest import (
    SAMPLE_FILE,
    VERSION,
    append_to_manifest,
    is_complete,
    sample_folder,
    write_sample,
    write_sample_manifest,
)
from gaussray.io.atomic import remove_partial_files
from gaussray.render.aov.labeller import PICTURE_LABELS
from gaussray.render.dataset import render_dataset
from gaussray.render.develop import without_unused_seed
from gaussray.render.job import RenderJob
from gaussray.render.randomize.clearance import ObstructedError
from gaussray.render.randomize.distributions import draw_values
from gaussray.render.randomize.options import DrawOptions
from gaussray.render.randomize.preview import PREVIEWED, write_preview
from gaussray.render.renderer import Renderer
from gaussray.runtime.lock import output_lock
from gaussray.runtime.progress import Progress
from gaussray.runtime.provenance import array_digest
from gaussray.scene.scene import Scene
from gaussray.scene.segmented import Clip


# Scenes and settings whose renderers are kept.
_RENDERERS = 8
# How often a camera that stands in an object is drawn again.
_OBSTRUCTED_REDRAWS = 100


class Sample(NamedTuple):
    """One sample of the distributions.

    Args:
        index: its index.
        attempt: the first possible attempt, from 0.
        values: the drawn values.
        parameters: all parameters of the configuration.
        job: the job that renders it.
    """

    index: int
    attempt: int
    values: dict[str, Any]
    parameters: dict[str, Any]
    job: RenderJob


# Distributions by their keys, each as the configuration has it.
Distributions = Mapping[str, Mapping[str, Any]]
# From drawn values to all parameters and the job; a ValueError where no camera can be set so.
MakeJob = Callable[[Mapping[str, Any]], tuple[dict[str, Any], RenderJob]]


def draw_sample(
    index: int, distributions: Distributions, make_job: MakeJob, *, options: DrawOptions
) -> Sample:
    """Draw the sample of an index. It depends on the seed and the index alone.

    Args:
        index: index of the sample.
        distributions: distribution of every key.
        make_job: makes parameters and job of drawn values.
        options: seed and number of attempts. Cameras in objects have at least 101 attempts.

    Raises:
        ValueError: All attempts have drawn values that are impossible.
    """
    for attempt in itertools.count():
        values = draw_values(options.seed, index, attempt, distributions)
        try:
            return Sample(index, attempt, values, *make_job(values))
        except ObstructedError as error:
            if attempt < max(options.redraws, _OBSTRUCTED_REDRAWS):
                continue
            remedy = "Draw places that are free, or allow such cameras by dataset.clearance=0."
            raise _impossible(index, attempt, error, remedy) from error
        except ValueError as error:
            if attempt < options.redraws:
                continue
            remedy = "If that depends on what is drawn, dataset.redraws draws such samples again."
            raise _impossible(index, attempt, error, remedy) from error
    raise AssertionError("there is at least one attempt")


def _impossible(index: int, attempt: int, error: ValueError, remedy: str) -> ValueError:
    attempts = f" in {attempt + 1} attempts" if attempt else ""
    return ValueError(f"sample {index} is impossible{attempts}: {error} {remedy}")


def generate_samples(
    out: Path,
    distributions: Distributions,
    make_job: MakeJob,
    *,
    options: DrawOptions,
    devices: int | None = None,
    quiet: bool = False,
) -> int:
    """Render the samples of this shard into `out`.

    All samples of the shard are checked before the first one is rendered. Finished samples are kept
    and interrupted ones continued; a finished one with other values is an error. The manifest of
    the dataset grows by a line with every sample, and is sorted by index at the end. `preview.png`
    shows the first ten samples as soon as they exist.

    Args:
        out: folder of the dataset.
        distributions: distribution of every key.
        make_job: makes parameters and job of drawn values.
        options: number of samples, seed, shard.
        devices: number of devices; None is all.
        quiet: whether to print no progress.

    Returns:
        The number of samples, of all shards, that are still missing.

    Raises:
        ValueError: A sample is impossible, or the folder holds a sample with other values.
    """
    frames = _frame_counts(distributions, make_job, options, quiet)
    progress = Progress("render", sum(frames.values()), quiet=quiet, anew=True)
    progress.report(0, "compiling")
    shared, done = SharedRenderers(devices), itertools.count(1)
    # Samples of an interrupted run, whose lines may not be in the manifest.
    write_sample_manifest(out, options.count)
    for number, index in enumerate(frames, 1):
        sample = draw_sample(index, distributions, make_job, options=options)
        note = f"sample {number}/{len(frames)}  {sample.job.records[0].effect}"
        left = itertools.islice(done, len(sample.job.records))

        def finished(record: FrameRecord, note: str = note, left: Iterator[int] = left) -> None:
            # Ground truth pictures are no frames of the sample.
            if record.effect not in PICTURE_LABELS:
                progress.report(next(left), note)

        with output_lock(out / sample_folder(index)):
            if _render(out, sample, options.seed, shared, finished):
                append_to_manifest(out, index)
        for kept in left:
            progress.report(kept, note)
        if index < PREVIEWED:
            write_preview(out, options.count)
    return write_sample_manifest(out, options.count)


def _frame_counts(
    distributions: Distributions, make_job: MakeJob, options: DrawOptions, quiet: bool
) -> dict[int, int]:
    """The number of frames of every sample of this shard; a ValueError if one is impossible."""
    counts, progress = {}, Progress("check", len(options.indices), quiet=quiet, patience=1.0)
    for index in options.indices:
        sample = draw_sample(index, distributions, make_job, options=options)
        counts[index] = len(sample.job.records) if sample.job else 0
        progress.report(len(counts), "cameras")
    return counts


class SharedRenderers:
    """Scene hashes and renderers that samples share, with measured lists and compiled programs."""

    def __init__(self, devices: int | None):
        self._devices = devices
        # The scene is kept with its hash, so that no other object gets its id.
        self._hashes: dict[int, tuple[Scene | Clip, str]] = {}
        self._renderers: dict[tuple, tuple[Scene | Clip, Renderer]] = {}

    def scene_hash(self, scene: Scene | Clip) -> str:
        """SHA-256 of all arrays of a scene."""
        if id(scene) not in self._hashes:
            self._hashes[id(scene)] = scene, array_digest(scene).hexdigest()
        return self._hashes[id(scene)][1]

    def renderer(self, job: RenderJob) -> Renderer:
        """The renderer for the scene and the settings of a job."""
        key = id(job.scene), job.options, job.trace
        if key not in self._renderers:
            if len(self._renderers) == _RENDERERS:
                self._renderers.pop(next(iter(self._renderers)))
            self._renderers[key] = job.scene, job.renderer(self._devices)
        return self._renderers[key][1]


def refuse_other_samples(
    out: Path, distributions: Distributions, make_job: MakeJob, options: DrawOptions
) -> None:
    """Refuse a folder whose first sample of this shard was made with other values.

    Args:
        out: folder of the dataset.
        distributions: distribution of every key.
        make_job: makes parameters and job of drawn values.
        options: number of samples, seed, shard.

    Raises:
        ValueError: It was; the message names the keys.
    """
    index = next(
        (k for k in options.indices if (out / sample_folder(k) / SAMPLE_FILE).is_file()), None
    )
    if index is not None:
        sample = draw_sample(index, distributions, make_job, options=options)
        if sample.job:
            scene_hash = array_digest(sample.job.scene).hexdigest()
            is_complete(out / sample_folder(index), _facts(sample, options.seed, scene_hash))


def _facts(sample: Sample, seed: int, scene_hash: str) -> dict[str, Any]:
    """What a sample is made of, for its line."""
    return {
        "version": VERSION,
        "index": sample.index,
        "folder": sample_folder(sample.index),
        "seed": seed,
        "attempt": sample.attempt,
        "drawn": sample.values,
        "parameters": sample.parameters,
        "scene_sha256": scene_hash,
    }


def _render(
    out: Path,
    sample: Sample,
    seed: int,
    shared: SharedRenderers,
    finished: Callable[[FrameRecord], object],
) -> bool:
    """Render a sample, and write its line last: the line marks it as finished.

    Returns:
        Whether it was rendered; it may have been there already.
    """
    folder, job = out / sample_folder(sample.index), sample.job
    facts = _facts(sample, seed, shared.scene_hash(job.scene))
    if is_complete(folder, facts):
        return False
    remove_partial_files(folder, deep=True)
    sensor = without_unused_seed(job.dataset.sensor)
    options = dataclasses.replace(job.dataset, sensor=sensor)
    renderer = shared.renderer(job)
    render_dataset(renderer, job.records, folder, options=options, quiet=True, on_picture=finished)
    write_sample(folder, facts, job.records)
    return True
