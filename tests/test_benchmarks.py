"""Every benchmark runs, says all that it should, and is drawn."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from toy import single

from benchmarks import (
    bench_deformation,
    bench_disk,
    bench_first,
    bench_grid,
    bench_pictures,
    bench_reconstruct,
    bench_render,
    bench_scaling,
    bench_trace,
    bench_worst,
    exact,
    peer,
    record,
    trade,
)
from benchmarks.problem import cameras, dynamic_room
from gaussray.camera.camera import project
from gaussray.camera.lens.perspective import Pinhole
from gaussray.scene.scene import at


pytestmark = pytest.mark.ci


SMALL = ["--side", "16", "--backend", "array"]
ROOM = "200"
PARTS = {"grid": (bench_grid.main, ["--gaussians", ROOM, "--keys", "1"])}
FRAMES = {
    "trace": (bench_trace.main, ["--gaussians", ROOM, "--k", "8"]),
    "render": (bench_render.main, ["--room", ROOM, "--effects", "pinhole"]),
    "scaling": (
        bench_scaling.main,
        ["--axes", "hits", "--base", ROOM, "--spread", "1"],
    ),
    "worst": (bench_worst.main, ["--count", ROOM, "--cases", "size"]),
    "trade": (trade.main, ["--axes", "half", "--quick", "--room", ROOM]),
}
# What a picture is compared in, and at least how near it then is (dB): rounding alone, or cut-offs.
TRACED = {"trace": 80, "render": 80, "scaling": 80, "worst": 80, "trade": 40}
slow = pytest.mark.slow


def run(scripts, folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(record, "RESULTS", folder)
        for main, arguments in scripts.values():
            main(arguments + SMALL)


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    """The folder of the lines of the scripts that measure a part of what a picture takes."""
    folder = tmp_path_factory.mktemp("traced")
    run(PARTS, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(record, "RESULTS", folder)
        bench_deformation.main(["--gaussians", "50", "--keys", "1"])
    return folder


@pytest.fixture(scope="module")
def framed(tmp_path_factory):
    """The folder of the lines of the scripts that measure pictures."""
    folder = tmp_path_factory.mktemp("framed")
    run(FRAMES, folder)
    return folder


def lines_of(folder, bench):
    return [json.loads(line) for line in (folder / f"{bench}.jsonl").read_text().splitlines()]


@pytest.fixture
def results(bench, request):
    """The folder that has the lines of a script."""
    return request.getfixturevalue("framed" if bench in FRAMES else "traced")


def benches(names):
    return [pytest.param(name, marks=slow if name in FRAMES else ()) for name in names]


@pytest.mark.parametrize("bench", benches([*PARTS, *FRAMES, "deformation"]))
def test_lines_have_every_figure(results, bench):
    for line in lines_of(results, bench):
        assert set(record.KEYS) <= set(line)
        assert line["bench"] == bench
        assert line["run_s_min"] <= line["run_s_median"] and line["fps"] > 0
        assert line["direction"] in ("forward", "forward_backward")


@pytest.mark.parametrize("bench", benches(TRACED))
def test_pictures_are_near_the_exact_ones(results, bench):
    for line in lines_of(results, bench):
        assert line["dropped"] == 0 and line["backend"] == "array"
        assert line["psnr_vs_exact"] > TRACED[bench] and line["max_error"] < 0.1


@slow
def test_a_second_process_measures_the_same_picture(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench_first, "RESULTS", tmp_path)
    bench_first.main(["--gaussians", "200", "203", "--side", "16"])
    few, more = lines_of(tmp_path, "first")
    assert few["rows"] == more["rows"] >= 203
    assert min(few[name] for name in ("import_s", "first_s", "second_s")) > 0
    assert "first_s" in capsys.readouterr().out


@slow
def test_every_kind_of_file_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "RESULTS", tmp_path)
    bench_disk.main(["--frames", "8", "--gaussians", ROOM, *SMALL])
    lines = lines_of(tmp_path, "disk")
    assert {line["kind"] for line in lines} == {"png", "exr", "video", "labels"}
    for line in lines:
        assert set(record.KEYS) <= set(line)
        assert min(line[name] for name in ("one_thread", "all_threads", "kilobytes")) > 0
        assert line["fps"] == pytest.approx(line["data_set"])


def test_what_a_fit_does_with_pictures_is_timed_by_part(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "RESULTS", tmp_path)
    arguments = ["--cameras", "2", "--times", "4", "--side", "64", "--backend", "array"]
    bench_pictures.main(arguments)
    lines = lines_of(tmp_path, "pictures")
    assert [line["part"] for line in lines] == ["read", "motion", "medians", "points"]
    for line in lines:
        assert line["pictures"] == 8 and line["megapixels"] == pytest.approx(64**2 / 1e6)
        # All bytes of all pictures, in the seconds of the part.
        total = 8 * 64**2 * 3 / 1e9
        assert line["gigabytes_per_s"] == pytest.approx(total / line["seconds"])


def test_exponent_of_a_power_law():
    x = np.array([1.0, 3.0, 10.0])
    assert bench_scaling.exponent(x, 5 * x**0.7) == pytest.approx(0.7)


def test_what_moves_in_the_room_moves_and_keeps_its_shape():
    scene = dynamic_room(400, degree=1)
    assert scene.static.count + scene.moving.count == 400
    assert scene.moving.harmonics.shape == (40, 4, 3)
    begin, end = (np.asarray(jax.jit(at)(scene, single(t)).mean) for t in (0, 0.5))
    assert np.array_equal(begin[:360], end[:360])
    moved = np.linalg.norm(end[360:] - begin[360:], axis=1)
    assert 0.1 < np.median(moved) < 2


def test_exact_pixels_follow_the_shutter():
    scene, views = dynamic_room(100, moving=1.0), cameras(8)
    chosen = np.arange(64)
    instant, rolling = (
        exact.picture(scene, views[name], chosen, samples=1)
        for name in ("pinhole", "rolling_shutter")
    )
    assert np.abs(instant - rolling).max() > 0.01


@slow
def test_report_draws_what_was_measured(framed, tmp_path, capsys):
    report = pytest.importorskip("benchmarks.report", reason="matplotlib is an extra")
    report.main(["--results", str(framed), "--out", str(tmp_path)])
    made = {path.name for path in tmp_path.iterdir()}
    assert made == {"trade.png", "scaling.png", "effects.png", "tables.md", "report.html"}
    for bench in FRAMES:
        assert f"### {bench} on" in capsys.readouterr().out + (tmp_path / "tables.md").read_text()


def test_the_latest_line_of_a_measurement_counts():
    report = pytest.importorskip("benchmarks.report", reason="matplotlib is an extra")
    lines = [{"bench": "trace", "k": 4, "fps": 1}, {"bench": "trace", "k": 8, "fps": 2}]
    assert report.latest([*lines, lines[0] | {"fps": 3}]) == [lines[1], lines[0] | {"fps": 3}]


def test_the_front_is_what_nothing_beats_in_both():
    report = pytest.importorskip("benchmarks.report", reason="matplotlib is an extra")
    exactness, speed = np.array([3.0, 2.0, 1.0, 2.0]), np.array([1.0, 5.0, 4.0, 3.0])
    assert set(report.front(exactness, speed)) == {0, 1}


def test_larger_and_fainter_gaussians_are_as_dense():
    scene = dynamic_room(100)
    wide = bench_scaling.spread(scene, 2.0).static
    before = scene.static.opacity * scene.static.scale[:, 0] * scene.static.scale[:, 1]
    np.testing.assert_allclose(wide.opacity * wide.scale[:, 0] * wide.scale[:, 1], before, 1e-6)


def test_cameras_of_the_peer_see_points_where_ours_do():
    camera = cameras(64)["pinhole"]
    lens = Pinhole((40.0, 44.0), (30.0, 33.0), (0.1, -0.05, 0.01, -0.02, 0.03, 0.01, 0.0, 0.02))
    camera = dataclasses.replace(camera, lens=lens)
    view = peer.peer_view(camera)
    places = np.random.default_rng(0).uniform(-1, 1, (20, 3)) + [0, 0, -0.4]
    x, y, z = view.camera_from_world[:3] @ np.concatenate([places, np.ones((20, 1))], axis=1).T
    k = view.radial
    p1, p2 = view.tangential
    x, y = x / z, y / z
    square = x**2 + y**2
    radial = (1 + square * (k[0] + square * (k[1] + square * k[2]))) / (
        1 + square * (k[3] + square * (k[4] + square * k[5]))
    )
    bent = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
            y * radial + 2 * p2 * x * y + p1 * (square + 2 * y**2),
            np.ones(20),
        ]
    )
    seen = (view.intrinsics @ bent)[:2].T
    ours = [project(camera, single(place)) for place in places]
    np.testing.assert_allclose(seen, ours, atol=1e-3)


def test_where_gsplat_is_not_installed_nothing_is_added():
    scene = dynamic_room(200)
    assert peer.scene_columns(scene, cameras(16)["pinhole"], 1.0) == {} or peer.usable()


@slow
def test_every_effect_and_every_knob_can_be_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(record, "RESULTS", tmp_path)
    bench_render.main(["--room", ROOM, *SMALL])
    trade.main(["--quick", "--room", ROOM, *SMALL])
    effects = {line["effect"] for line in lines_of(tmp_path, "render")}
    assert effects == set(bench_render.ROOM)
    assert {line["axis"] for line in lines_of(tmp_path, "trade")} == set(trade.AXES)


@slow
def test_steps_of_a_reconstruction_are_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(record, "RESULTS", tmp_path)
    bench_reconstruct.main(["--steps", "25", "--stages", "coarse", "--kernels", "3"])
    bench_reconstruct.main(["--steps", "25", "--room", "2000", "--rays", "1024", "4096"])
    lines = lines_of(tmp_path, "reconstruct_step")
    assert [line["rays"] for line in lines[1:]] == [1024, 4096]
    assert lines[1]["gaussians"] == 2000 and lines[1]["effect"] == "fine"
    assert all(set(record.KEYS) <= set(line) for line in lines) and lines[0]["dropped"] == 0
