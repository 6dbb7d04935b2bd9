"""A data set of pictures: read back, kept, and scored against itself."""

import dataclasses
import json
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray.camera.aperture import Aperture, Rim
from gaussray.camera.camera import camera_rays
from gaussray.camera.focus_pull import FocusPull
from gaussray.camera.sensor.sensor import SensorOptions
from gaussray.camera.sensor.vignetting import transmission
from gaussray.camera.shake import Shake
from gaussray.camera.shutter import interlaced_row_times
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.picture_file import read_stored
from gaussray.color import srgb_decode
from gaussray.dataset.images import write_image
from gaussray.dataset.layers import read_layers
from gaussray.evaluate import pipeline as evaluation
from gaussray.evaluate.options import EvaluateOptions
from gaussray.evaluate.pipeline import evaluate
from gaussray.render import dataset, dataset_files, develop
from gaussray.render.dataset import render_dataset
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.parts import PIXEL, RAY, SAMPLE
from gaussray.render.renderer import Renderer


ONE = RenderOptions(samples=1)
# Half a code of each picture; sRGB values are up to 2.3 times as far apart in light.
CODES = (0.5 + 0.5 * 2.3) / 255
# Room for one picture that waits to be written.
SCARCE = toy.SIZE**2 * 3

shoot = jax.jit(camera_rays)


def renderer(scene, options=ONE):
    return Renderer(scene, options=options, trace=toy.TRACE)


def test_a_data_set_reads_back_is_kept_and_scores_against_itself(tmp_path):
    scene = toy.scene()
    records = toy.with_effect(toy.records())
    toy.write_paired(tmp_path, scene)
    capture = read_capture(tmp_path)
    assert len(capture.views) == 12 and len(capture.effects["rolling_shutter"]) == 1
    pixel, middle = toy.single([[0, 0], [15, 3], [4, 15]]), jnp.full((3, 5), 0.5, jnp.float32)
    found = [*capture.views, *capture.effects["rolling_shutter"]]
    for record, view in zip(records, found, strict=True):
        ours, read = (shoot(c, pixel, middle) for c in (record.camera, view.camera))
        for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(read), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-5)
    assert (tmp_path / "pinhole_cam_3.mp4").is_file()

    kept = tmp_path / records[0].file_path
    before, gone = kept.stat().st_mtime_ns, tmp_path / records[1].file_path
    content = gone.read_bytes()
    gone.unlink()
    toy.write_paired(tmp_path, scene)
    assert kept.stat().st_mtime_ns == before
    assert gone.read_bytes() == content

    with pytest.raises(ValueError, match="holds pictures of another scene, camera or option"):
        render_dataset(renderer(scene, RenderOptions(samples=2)), records, tmp_path, quiet=True)

    # Who ran out of memory goes on with less.
    gone.unlink()
    less = dataclasses.replace(ONE, memory=8 * toy.SIZE * (RAY + SAMPLE + PIXEL) / 1e9)
    render_dataset(renderer(scene, less), records, tmp_path, quiet=True)
    assert kept.stat().st_mtime_ns == before and gone.is_file()

    report = evaluate(
        scene, capture, tmp_path / "scores", options=EvaluateOptions(split="all"), render=ONE,
        trace=toy.TRACE, quiet=True,
    )  # fmt: skip
    assert report["frames"] == 13 and set(report["effects"]) == {"pinhole", "rolling_shutter"}
    for row in report["effects"].values():
        assert row["psnr"] is None or row["psnr"] > 45
    text = (tmp_path / "scores" / "report.json").read_text()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_scores_whose_pictures_vanish_are_not_called_done(tmp_path, monkeypatch):
    toy.write_paired(tmp_path, toy.scene())
    capture, write = read_capture(tmp_path), evaluation.write_image

    def vanishes(path, picture):
        write(path, picture)
        if path.name == "cam_3_0.0000.png":
            path.unlink()

    monkeypatch.setattr(evaluation, "write_image", vanishes)
    with pytest.raises(OSError, match="1 of 12 files .*cam_3_0.0000.png. The same command"):
        evaluate(
            toy.scene(), capture, tmp_path / "scores", options=EvaluateOptions(split="all"),
            render=ONE, trace=toy.TRACE, quiet=True,
        )  # fmt: skip
    assert not (tmp_path / "scores" / "report.json").exists()


def test_manifests_record_the_samples_that_an_error_took(tmp_path):
    records = toy.records(times=(0.5,), cameras=("cam_3",))
    options = RenderOptions(samples=2, error=1e-9, samples_most=8)
    render_dataset(renderer(toy.scene(speed=0), options), records, tmp_path, quiet=True)
    (view,) = read_capture(tmp_path).views
    assert view.samples == 8
    told = json.loads((tmp_path / records[0].file_path).with_suffix(".json").read_text())
    assert told["samples"] == 8 and told["error"] >= 0


@pytest.mark.slow
def test_sensors_labels_and_added_samples_go_together_and_read_back(tmp_path):
    """Two frames of a clipped, pulled, interlaced and shaken camera, with all that can be asked."""
    number = toy.single
    pull = FocusPull(number([0.0, 1.0]), number([2.0, 4.0]), "smooth")
    rim = Rim(number(0.1), number(0.2))
    aperture = Aperture(number(0.1), pull, number(0), number(1), rim=rim)
    shake = Shake(*map(number, (0.01, 0.01, 0.1, 3)))

    def changed(record):
        camera = record.camera
        table = number(interlaced_row_times(toy.SIZE, 0.1))
        shutter = dataclasses.replace(camera.shutter, row_times=table, trigger=number(0.02))
        path = dataclasses.replace(camera.trajectory, shake=shake)
        camera = dataclasses.replace(camera, aperture=aperture, shutter=shutter, trajectory=path)
        return dataclasses.replace(record, camera=camera)

    records = [changed(r) for r in toy.records(times=(0.0, 0.5), cameras=("cam_3",))]
    sensor = SensorOptions(chromatic=(1.01, 1.0, 0.99), full_well=1000.0)
    options = RenderOptions(samples=2, error=1e-9, samples_most=8)
    stored = DatasetOptions(sensor, labels=("time", "flow_forward", "valid", "sharp"))
    render_dataset(renderer(toy.scene(), options), records, tmp_path, options=stored, quiet=True)
    capture = read_capture(tmp_path)
    (twins,) = capture.effects.values()
    assert [view.samples for view in (*capture.views, *twins)] == [8] * 4
    for record, view in zip(records, capture.views, strict=True):
        ours, read = jax.device_get((record.camera, view.camera))
        assert jax.tree.structure(ours) == jax.tree.structure(read)
        for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(read), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6)
        path = tmp_path / record.file_path.replace("images", "labels")
        layers = read_layers(path.with_suffix(".exr"))
        assert np.isfinite(layers["flow_forward.x"]).any() == (record is records[0])
        expected = float(ours.time) + 0.02 + interlaced_row_times(toy.SIZE, 0.1)
        np.testing.assert_allclose(layers["time"], np.tile(expected[:, None], toy.SIZE), atol=1e-6)


def test_what_cannot_be_written_stops_the_run_and_what_was_written_stays(tmp_path, monkeypatch):
    records, write = toy.records()[:4], develop.write_image

    def refuse(path, color):
        if path == tmp_path / records[2].file_path:
            raise OSError(f"{path}: the picture cannot be written: no space left")
        write(path, color)

    monkeypatch.setattr(develop, "write_image", refuse)
    monkeypatch.setattr(dataset, "BACKLOG", SCARCE)
    with pytest.raises(OSError, match="the picture cannot be written: no space left"):
        render_dataset(renderer(toy.scene()), records, tmp_path, quiet=True)
    assert all((tmp_path / record.file_path).exists() for record in records[:2])
    assert not (tmp_path / "transforms.json").exists()
    monkeypatch.setattr(develop, "write_image", write)
    render_dataset(renderer(toy.scene()), records, tmp_path, quiet=True)
    assert len(read_capture(tmp_path).views) == 4


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_pictures_are_those_of_light_that_is_written_from_the_host(tmp_path, suffix):
    records = [
        dataclasses.replace(one, file_path=str(Path(one.file_path).with_suffix(f".{suffix}")))
        for one in toy.records()[:3]
    ]
    render_dataset(renderer(toy.scene()), records, tmp_path / "data", quiet=True)
    frames = renderer(toy.scene()).render_frames(record.camera for record in records)
    for record, frame in zip(records, frames, strict=True):
        path = tmp_path / "host" / record.file_path
        write_image(path, frame.color)
        assert (tmp_path / "data" / record.file_path).read_bytes() == path.read_bytes()


def videos_of(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.mp4"))}


def test_videos_are_the_same_from_memory_and_from_files(tmp_path, monkeypatch):
    # Frames of one camera after another's, and of all cameras at a time.
    records = toy.records()
    mixed = sorted(records, key=lambda record: float(record.camera.time))
    render_dataset(renderer(toy.scene()), records, tmp_path / "memory", quiet=True)
    expected = videos_of(tmp_path / "memory")
    assert len(expected) == len(toy.CAMERAS)
    with monkeypatch.context() as patch:
        patch.setattr(dataset_files, "read_stored", lambda *_: pytest.fail("it is in memory"))
        render_dataset(renderer(toy.scene()), mixed, tmp_path / "mixed", quiet=True)
    assert videos_of(tmp_path / "mixed") == expected
    monkeypatch.setattr(dataset_files, "MOST_KEPT", 0)
    render_dataset(renderer(toy.scene()), records, tmp_path / "files", quiet=True)
    assert videos_of(tmp_path / "files") == expected
    # After an interruption, frames that were there come from their files.
    for path in (tmp_path / "memory").glob("*.mp4"):
        path.unlink()
    (tmp_path / "memory" / records[1].file_path).unlink()
    monkeypatch.undo()
    render_dataset(renderer(toy.scene()), records, tmp_path / "memory", quiet=True)
    assert videos_of(tmp_path / "memory") == expected


@pytest.mark.parametrize("number", [0, 5])
def test_a_picture_that_cannot_be_written_ends_all_threads_and_leaves_no_part(
    tmp_path, monkeypatch, number
):
    records = toy.records()

    def refuse(path, picture):
        if path == tmp_path / records[number].file_path:
            raise OSError(f"{path}: no space left")
        develop.write_picture(path, picture)

    monkeypatch.setattr(dataset, "write_picture", refuse)
    with pytest.raises(OSError, match="no space left"):
        render_dataset(renderer(toy.scene()), records, tmp_path, quiet=True)
    assert not [path for path in tmp_path.rglob("*") if ".part" in path.name]
    assert not (tmp_path / "transforms.json").exists()
    assert not [one for one in threading.enumerate() if one.name.startswith("video")]


def test_a_video_that_cannot_be_written_is_told_when_the_pictures_are_there(tmp_path, monkeypatch):
    def refuse(path, frames, fps):
        next(iter(frames))
        raise OSError(f"{path}: the video cannot be written")

    monkeypatch.setattr(dataset_files, "write_video", refuse)
    records = toy.records()
    with pytest.raises(OSError, match="mp4: the video cannot be written"):
        render_dataset(renderer(toy.scene()), records, tmp_path, quiet=True)
    assert all((tmp_path / record.file_path).exists() for record in records)


def test_light_that_is_not_finite_stops_the_run(tmp_path, monkeypatch):
    def broken(record, values, sensor):
        return develop.develop_picture(record, values.reshape(-1, 5).at[7].set(jnp.nan), sensor)

    monkeypatch.setattr(dataset, "develop_picture", broken)
    with pytest.raises(ValueError, match="a picture stored in 8 bits must be finite, got 3 "):
        render_dataset(renderer(toy.scene()), toy.records()[:2], tmp_path, quiet=True)


def filmed(folder, records, sensor, info=None):
    """The stored values of each record's picture, filmed with a sensor."""
    options = DatasetOptions(sensor, info=info or {})
    render_dataset(renderer(toy.scene(speed=0)), records, folder, options=options, quiet=True)
    size = toy.SIZE, toy.SIZE
    return {r.file_path: read_stored(folder / r.file_path, *size) for r in records}


def test_noise_is_that_of_a_picture_whatever_is_filmed_before_it(tmp_path):
    noise = SensorOptions(full_well=500.0, read_noise=4.0, seed=2)
    records = toy.records()[:4]
    first = filmed(tmp_path / "a", records, noise)
    again = filmed(tmp_path / "b", records[:0:-1], noise)
    assert len(again) == 3
    for path, picture in again.items():
        np.testing.assert_array_equal(picture, first[path])
    # Two pictures of one camera of what stands still, and one picture with another seed.
    still = [first[r.file_path] for r in records[:2]]
    assert np.mean(still[0] == still[1]) < 0.5
    other = filmed(tmp_path / "c", records[:1], SensorOptions(full_well=500.0, read_noise=4.0))
    assert np.mean(other[records[0].file_path] == still[0]) < 0.5


def test_a_sensor_is_noted_and_none_leaves_everything_as_it_was(tmp_path, monkeypatch):
    records = toy.records()[:2]
    with monkeypatch.context() as patch:
        patch.setattr(develop, "_develop", lambda *_, **__: pytest.fail("there is no sensor"))
        filmed(tmp_path / "none", records, SensorOptions())
    document = json.loads((tmp_path / "none" / "transforms.json").read_text())
    assert "info" not in document and "color_space" not in document
    note = (tmp_path / "none" / "render.sha256").read_text()
    render_dataset(renderer(toy.scene(speed=0)), records, tmp_path / "none", quiet=True)
    assert (tmp_path / "none" / "render.sha256").read_text() == note

    sensor = SensorOptions(exposure=-1.0, vignetting=(-0.2, 0.0, 0.0), tone="linear", seed=9)
    filmed(tmp_path / "sensor", records, sensor, {"physical": {"given": {"f_number": 2.0}}})
    capture = read_capture(tmp_path / "sensor")
    info = json.loads((tmp_path / "sensor" / "transforms.json").read_text())["info"]
    assert info["physical"] == {"given": {"f_number": 2.0}}
    assert (info["sensor"]["exposure"], info["sensor"]["seed"]) == (-1.0, 9)
    # Codes in proportion to the light are read back as the light they are.
    light, dark = (decoded(read_capture(tmp_path / name).views[0]) for name in ("none", "sensor"))
    assert capture.views[0].color_space == "linear"
    share = 0.5 * transmission(
        records[0].camera.lens, records[0].camera.film, toy.single(0), toy.single(sensor.vignetting)
    )
    np.testing.assert_allclose(dark, light * np.asarray(share)[..., None], atol=CODES)
    with pytest.raises(ValueError, match="holds pictures of another scene, camera or option"):
        filmed(tmp_path / "sensor", records, SensorOptions())


def decoded(view):
    """The linear light of a picture."""
    stored = read_stored(view.image, toy.SIZE, toy.SIZE) / 255
    return stored if view.color_space == "linear" else srgb_decode(stored)
