"""Samples of a distribution: each follows from its index alone, whatever was rendered before."""

import dataclasses
import hashlib
import json
import os
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest
import toy

from gaussray.camera.film import Film
from gaussray.camera.shutter import Shutter
from gaussray.capture.picture_file import read_stored
from gaussray.color import srgb_encode
from gaussray.dataset.images import write_image
from gaussray.dataset.manifest import FrameRecord, write_manifest
from gaussray.dataset.sample_manifest import read_frames, read_samples
from gaussray.render.job import RenderJob
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.randomize import generate
from gaussray.render.randomize.distributions import draw_values, read_distributions
from gaussray.render.randomize.generate import (
    draw_sample,
    generate_samples,
    refuse_other_samples,
)
from gaussray.render.randomize.options import DrawOptions
from gaussray.report import write_page
from gaussray.report.dataset import SHOWN
from gaussray.scene.store import save_scene


RADIUS = read_distributions({"aperture": {"radius": {"uniform": [0.0, 1.0]}}})
SCENE = toy.scene(speed=0)
RUN = pathlib.Path(__file__).parents[2] / "six_samples.py"
# Half a level of an 8-bit picture, and rounding.
LEVEL = 0.6 / 255
# Single precision of times of about 1.
ROUNDING = 1e-6


def make_job(values):
    """A job of one frame; radii above 0.8 are impossible."""
    radius = possible(values)["aperture.radius"]
    camera = dataclasses.replace(toy.camera(), time=toy.single(radius))
    record = FrameRecord("images/pinhole/cam_0/0000.png", camera, "cam_0", "test")
    job = RenderJob(SCENE, [record], RenderOptions(samples=1), toy.TRACE, DatasetOptions())
    return {"aperture": {"radius": radius}, "far": float("inf")}, job


def possible(values):
    """The values if they are."""
    if values["aperture.radius"] > 0.8:
        raise ValueError(f"aperture.radius must be at most 0.8, got {values['aperture.radius']}.")
    return values


def drawn_at(index, **options):
    """The sample that an index has become, without a job."""
    told = DrawOptions(**{"redraws": 50, **options})
    return draw_sample(index, RADIUS, lambda values: (possible(values), None), options=told)


def first_drawn(index, seed=0):
    """What was drawn for an index, be it possible or not."""
    return draw_values(seed, index, 0, RADIUS)


@pytest.fixture
def filmed(monkeypatch):
    """Folders that were filmed, by a camera that is quick."""
    folders = []

    def render(renderer, records, out, **_):
        folders.append(out)
        film = records[0].camera.film
        light = np.full((film.height, film.width, 3), float(records[0].camera.time))
        write_image(out / records[0].file_path, light)
        write_manifest(out / "transforms.json", records)
        return out

    monkeypatch.setattr(generate, "render_dataset", render)
    return folders


def made(out, of=RADIUS, make=make_job, **options):
    told = DrawOptions(**{"redraws": 50, **options})
    return generate_samples(out, of, make, options=told, quiet=True)


def contents(out):
    """All files by their paths."""
    files = (path for path in out.rglob("*") if path.is_file())
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


def test_a_manifest_lists_samples_by_their_index_with_what_was_drawn(tmp_path, filmed):
    assert made(tmp_path, count=12, seed=3) == 0
    samples = list(read_samples(tmp_path))
    assert [one["index"] for one in samples] == list(range(12))
    for index, one in enumerate(samples):
        expected = drawn_at(index, seed=3)
        radius = expected.values["aperture.radius"]
        assert one["drawn"] == expected.values
        assert one["parameters"] == {"aperture": {"radius": radius}, "far": "infinity"}
        assert (one["seed"], one["attempt"]) == (3, expected.attempt)
        assert one["frames"][0]["time"] == pytest.approx(one["drawn"]["aperture.radius"])
    assert len({one["drawn"]["aperture.radius"] for one in samples}) == 12
    assert {one["scene_sha256"] for one in samples} == {samples[0]["scene_sha256"]}
    commit = samples[0]["git"]
    assert commit is None or re.fullmatch("[0-9a-f]{40}(-dirty)?", commit)
    frames = list(read_frames(tmp_path))
    assert all((tmp_path / frame["file_path"]).is_file() for frame in frames)
    assert [frame["take"]["index"] for frame in frames] == list(range(12))


def test_the_manifest_grows_with_every_sample(tmp_path, filmed, monkeypatch):
    lengths, write_sample = [], generate.write_sample

    def counted(folder, *parts):
        manifest = tmp_path / "manifest.jsonl"
        lengths.append(len(manifest.read_text().splitlines()) if manifest.exists() else 0)
        write_sample(folder, *parts)

    monkeypatch.setattr(generate, "write_sample", counted)
    made(tmp_path, count=4)
    assert lengths == [0, 1, 2, 3]


def test_a_contact_sheet_shows_the_first_ten_samples_before_the_others(tmp_path, filmed):
    assert made(tmp_path, count=25, shard="0/2") == 12
    assert not (tmp_path / "preview.png").exists()
    made(tmp_path, count=25, shard="1/2")
    sheet = read_stored(tmp_path / "preview.png", 5 * 260, 2 * 260)
    for i, one in enumerate(list(read_samples(tmp_path))[:10]):
        row, column = divmod(i, 5)
        middle = sheet[260 * row + 130, 260 * column + 130] / 255
        expected = srgb_encode(np.full(3, one["drawn"]["aperture.radius"], np.float32))
        np.testing.assert_allclose(middle, expected, atol=LEVEL)


def test_progress_counts_frames_from_the_beginning(tmp_path, filmed, capsys):
    generate_samples(tmp_path, RADIUS, make_job, options=DrawOptions(count=3, redraws=50))
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("render")]
    assert lines[0].startswith("render 0/3") and lines[-1].startswith("render 3/3")


def test_a_page_shows_samples_and_how_they_are_distributed(tmp_path, filmed):
    made(tmp_path, count=30, seed=3)
    text = write_page("dataset", tmp_path).read_text()
    radii = [one["drawn"]["aperture.radius"] for one in read_samples(tmp_path)]
    assert text.count("data:image/") == SHOWN and "NaN" not in text
    assert ">aperture.radius<" in text and f">{np.median(radii):.4g}<" in text
    assert text == write_page("dataset", tmp_path).read_text()


def test_a_page_shows_samples_without_an_effect(tmp_path, filmed):
    def plain(values):
        told, job = make_job(values)
        (record,) = job.records
        camera = dataclasses.replace(record.camera, film=Film(toy.SIZE, toy.SIZE))
        return told, job._replace(records=[dataclasses.replace(record, camera=camera)])

    made(tmp_path, make=plain, count=1)
    (sample,) = read_samples(tmp_path)
    assert "effect" not in sample["frames"][0]
    assert "0 · pinhole" in write_page("dataset", tmp_path).read_text()


def test_shards_in_any_order_leave_what_one_process_leaves(tmp_path, filmed):
    made(tmp_path / "whole", count=7)
    assert made(tmp_path / "parts", count=7, shard="2/3") == 5
    assert made(tmp_path / "parts", count=7, shard="0/3") == 2
    assert [one["index"] for one in read_samples(tmp_path / "parts")] == [0, 2, 3, 5, 6]
    assert made(tmp_path / "parts", count=7, shard="1/3") == 0
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")
    assert len(filmed) == 14
    # A share without a sample.
    assert made(tmp_path / "parts", count=7, shard="8/9") == 0 and len(filmed) == 14


def test_what_is_there_is_kept_and_more_samples_leave_the_first_as_they_are(tmp_path, filmed):
    made(tmp_path, count=3)
    before = contents(tmp_path)
    made(tmp_path, count=3)
    assert len(filmed) == 3
    made(tmp_path, count=5)
    assert len(filmed) == 5
    after = contents(tmp_path)
    assert after["manifest.jsonl"].startswith(before.pop("manifest.jsonl"))
    assert after["preview.png"] != before.pop("preview.png")
    assert before.items() <= after.items()


def test_a_smaller_number_leaves_the_samples_of_a_larger_one_listed(tmp_path, filmed):
    made(tmp_path, count=4)
    before = contents(tmp_path)["manifest.jsonl"]
    assert made(tmp_path, count=2) == 0
    assert contents(tmp_path)["manifest.jsonl"] == before


def test_samples_of_other_values_are_refused_before_anything_is_written(tmp_path, filmed):
    told = DrawOptions(redraws=50, count=2)
    refuse_other_samples(tmp_path, RADIUS, make_job, told)
    made(tmp_path, count=2)
    refuse_other_samples(tmp_path, RADIUS, make_job, told)
    other = DrawOptions(redraws=50, count=2, seed=1)
    with pytest.raises(ValueError, match="other values of seed, .*drawn.aperture.radius, "):
        refuse_other_samples(tmp_path, RADIUS, make_job, other)


def test_a_sample_of_another_distribution_or_scene_is_refused(tmp_path, filmed):
    made(tmp_path, count=2)
    with pytest.raises(ValueError, match="made with other values of .*seed, "):
        made(tmp_path, count=2, seed=1)

    def elsewhere(values):
        parameters, job = make_job(values)
        return parameters, job._replace(scene=toy.scene(speed=0.5))

    with pytest.raises(
        ValueError, match="takes/000000/take.json: .* other values of scene_sha256. Choose"
    ):
        made(tmp_path, count=2, make=elsewhere)
    assert len(filmed) == 2


def test_an_impossible_sample_is_refused_by_index_and_key_before_anything_is_filmed(
    tmp_path, filmed
):
    radii = [first_drawn(index, seed=1)["aperture.radius"] for index in range(20)]
    wrong = next(i for i, radius in enumerate(radii) if radius > 0.8)
    assert wrong > 0
    message = (
        f"sample {wrong} is impossible: aperture.radius must be at most 0.8, got {radii[wrong]}"
    )
    with pytest.raises(ValueError, match=re.escape(message)):
        made(tmp_path, count=20, seed=1, redraws=0)
    assert not filmed


def test_a_sample_that_is_drawn_anew_says_how_often_and_leaves_the_others():
    found = [drawn_at(index) for index in range(200)]
    again = [one for one in found if one.attempt]
    # A fifth is impossible at first: three deviations of how many that are.
    assert abs(len(again) - 40) < 3 * (200 * 0.2 * 0.8) ** 0.5
    for one in found:
        assert (first_drawn(one.index) == one.values) == (one.attempt == 0)
    with pytest.raises(ValueError, match="sample 0 is impossible in 3 attempts: aperture.radius"):
        never = read_distributions({"aperture": {"radius": {"uniform": [0.9, 1.0]}}})
        draw_sample(0, never, make_job, options=DrawOptions(redraws=2))


def test_another_draw_is_advised():
    def refuse(values):
        raise ValueError("lens must be a pinhole.")

    drawn = read_distributions({"lens": {"fov": {"choice": [1, 2]}}})
    with pytest.raises(ValueError, match=r"sample 0 is impossible: .* dataset.redraws draws such"):
        draw_sample(0, drawn, refuse, options=DrawOptions())


def test_times_of_rows_are_those_of_the_shutter(tmp_path, filmed):
    def rolling(direction, offset, step):
        def make(values):
            parameters, job = make_job({"aperture.radius": 0.5})
            numbers = (toy.single(x) for x in (offset, step, 0.1))
            shutter = Shutter(*numbers, direction=direction)
            camera = dataclasses.replace(toy.camera(time=0.5, width=24), shutter=shutter)
            return parameters, job._replace(
                records=[dataclasses.replace(job.records[0], camera=camera)]
            )

        return make

    lines = {"top_to_bottom": 16, "bottom_to_top": 16, "right_to_left": 24}
    for direction, count in lines.items():
        made(tmp_path / direction, make=rolling(direction, -0.2, 0.01), count=1)
        (frame,) = read_frames(tmp_path / direction)
        expected = 0.5 - 0.2 + 0.01 * np.arange(count)
        expected = expected if direction == "top_to_bottom" else expected[::-1]
        np.testing.assert_allclose(frame["row_times"], expected, atol=ROUNDING)
    made(tmp_path / "global", make=rolling("top_to_bottom", 0.1, 0.0), count=1)
    (frame,) = read_frames(tmp_path / "global")
    np.testing.assert_allclose(frame["row_times"], [0.6], atol=ROUNDING)


def killed(folder, out, at, camera):
    """Runs the command until it is about to move its file number `at` into place; the files that
    were there then, and when they were written."""
    run = subprocess.run(
        [sys.executable, RUN, folder, out, str(at), camera],
        capture_output=True, text=True, check=False,
        env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(folder / "compiled")},
    )  # fmt: skip
    assert run.returncode == (-9 if at else 0), run.stderr
    files = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    halves = [path for path in files if ".part" in path.name]
    assert len(halves) >= bool(at), "a kill leaves at least the file that it interrupts"
    finished = {path: files[path] for path in files if path not in halves}
    return finished if at else files


@pytest.mark.ci
@pytest.mark.parametrize("camera", ["quick", pytest.param("real", marks=pytest.mark.slow)])
def test_a_data_set_that_was_killed_twice_is_that_of_an_undisturbed_run(tmp_path, camera):
    save_scene(tmp_path / "scene.npz", toy.scene(speed=0))
    write_manifest(tmp_path / "cameras.json", toy.records())
    whole = killed(tmp_path, tmp_path / "whole", 0, camera)
    first = killed(tmp_path, tmp_path / "broken", 9, camera)
    second = killed(tmp_path, tmp_path / "broken", 13, camera)
    last = killed(tmp_path, tmp_path / "broken", 0, camera)
    pictures = [path for path in last if path.suffix == ".exr"]
    assert len(pictures) == len([path for path in whole if path.suffix == ".exr"]) == 12
    kept = [path for path in pictures if path in first or path in second]
    assert 0 < len([path for path in pictures if path in first]) < len(kept) < 12
    assert all(last[path] == {**second, **first}[path] for path in kept)
    # The page names its folder.
    one, two = ({k: hashlib.sha256(v).hexdigest() for k, v in contents(tmp_path / name).items()
                 if k != "report.html"} for name in ("whole", "broken"))  # fmt: skip
    assert one == two
    lines = (tmp_path / "broken" / "manifest.jsonl").read_text().splitlines()
    assert [json.loads(line)["index"] for line in lines] == list(range(6))
