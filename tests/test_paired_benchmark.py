"""The paired benchmark without Blender: what it plans to film, and the table of what was scored."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.paired_benchmark import table
from experiments.paired_benchmark.plan import EFFECTS, PRESETS, plan
from experiments.paired_benchmark.stage import FRAMES, READOUT, Rig
from gaussray.camera.camera import camera_rays
from gaussray.capture.formats.paired import read_capture


RIG = Rig((2.5, 2.0), (0.8, 2.4), (0.0, 0.0, 1.0), 65.0, 0.05, 2.5)


def few_cameras(name):
    """A preset as it is in time, with few cameras to read."""
    return replace(PRESETS[name], cameras=5, held_cameras=1)


def capture(folder, preset):
    images, files = plan(preset, RIG, EFFECTS, {"scene": "test"}, 0)
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content))
    (folder / "points3d.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "end_header\n0 0 0 1 2 3\n"
    )
    return images, read_capture(folder)


@pytest.fixture(
    scope="module",
    params=[pytest.param(x, marks=() if x == "tiny" else pytest.mark.slow) for x in PRESETS],
)
def planned(request, tmp_path_factory):
    """A preset, its pictures and its capture."""
    preset = few_cameras(request.param)
    return preset, *capture(tmp_path_factory.mktemp(request.param), preset)


def test_a_plan_is_a_paired_capture(planned):
    preset, images, found = planned
    assert set(found.effects) == set(EFFECTS) - {"pinhole"}
    assert len(found.views) == preset.cameras * preset.frames
    assert len({image.path for image in images}) == len(images)
    assert len(images) == len(found.views) + sum(map(len, found.effects.values()))
    train = [view for view in found.views if view.split == "train"]
    learnt, seen = {view.camera_name for view in train}, {view.time for view in train}
    assert len(learnt) == preset.cameras - preset.held_cameras
    assert len(seen) == preset.frames - preset.held_frames
    assert len(train) == len(learnt) * len(seen)
    # Whoever holds out the ends asks for motion beyond what was learnt.
    assert {0.0, 1.0} <= seen


def test_rows_of_a_rolling_shutter_see_blenders_instants_and_only_the_clip(planned):
    preset, _, found = planned
    views = found.effects["rolling_shutter"]
    rows = np.array([0, preset.size // 3, preset.size - 1])
    pixel = jnp.asarray(np.stack([np.zeros(3), rows], axis=-1), jnp.float32)
    for view in (views[0], views[-1]):
        frame = view.time * (FRAMES - 1)
        half = jnp.full((3, 5), 0.5)
        expected = (frame + READOUT * ((rows + 1) / preset.size - 0.5)) / (FRAMES - 1)
        time = np.asarray(camera_rays(view.camera, pixel, half).time)
        # Single precision over a clip of length 1.
        np.testing.assert_allclose(time, expected, atol=3e-7)
        assert expected.min() >= 0 and expected.max() <= 1 + 1e-12


def test_a_capture_is_described_by_its_pinhole_pictures(tmp_path):
    preset = few_cameras("tiny")
    capture(tmp_path, preset)
    assert table.described(tmp_path) == {"width": 128, "height": 128, "pictures": 5 * 14}


def test_a_preset_that_leaves_nothing_to_learn_from_is_refused():
    tiny = PRESETS["tiny"]
    assert tiny.problem() is None
    assert "--frames" in replace(tiny, frames=3).problem()
    assert "cameras" in replace(tiny, held_cameras=tiny.cameras - 3).problem()
    assert "--held-frames" in replace(tiny, held_frames=tiny.frames).problem()


def scores(psnr, **more):
    return {"psnr": psnr, "ssim": 0.9, "fps": 10.0, **more}


def report(shift):
    parts = {"train": scores(30 + shift), "held_out_cameras": scores(28 + shift, psnr_moving=20.0)}
    parts["train"] |= {"flicker": 0.5 + shift, "flicker_truth": 0.25}
    return {
        "effects": {
            "pinhole": scores(29 + shift, parts=parts),
            "fisheye": scores(26 + shift, psnr_circle=27 + shift, ssim_circle=0.8),
            "rolling_shutter, 1 row a chunk": scores(25 + shift),
        },
        "scene": {"gaussians": 10, "moving": 2},
        "versions": {"device": "cpu"},
        "capture": {"width": 8, "height": 8, "pictures": 4},
        "seconds": 90.0,
        "stored": 2_000_000,
    }


def test_the_table_has_means_and_the_worst_scene_beside_the_papers_figures():
    reports = {"one": report(0), "two": report(-2)}
    text = table.tables(reports)
    lines = {
        tuple(cell.strip() for cell in line.split("|")[1:3]): line for line in text.split("\n")
    }
    own = lines["pinhole", "gaussray, training views"]
    assert "29.00" in own and "28.00 two" in own
    assert "| -0.50 (0.25) |" in own
    assert "27.00 | 0.900" in lines["pinhole", "gaussray, held-out cameras"]
    assert "26.00 | 0.800" in lines["fisheye, inside the disc", "gaussray"]
    assert "24.00" in lines["rolling shutter, 1 row a chunk", "gaussray"]
    assert "32.80" in lines["pinhole", "*4D-GRT*"]
    assert "28.89" in lines["fisheye, inside the disc", "*4D-GRT*"]
    assert "| gaussray | 1.5 min | 2.0 |" in text
    del reports["two"]["effects"]["rolling_shutter, 1 row a chunk"]
    text = table.tables(reports)
    assert "| rolling shutter, 1 row a chunk | gaussray (1 of 2 scenes) | 25.00 |" in text


def test_seconds_of_fitting_count_every_run(tmp_path):
    clock = [1.0, 5.0, 9.5, 0.5, 4.0]  # stopped after 9.5 s, then resumed for 4
    (tmp_path / "m.jsonl").write_text("".join(f'{{"seconds": {s}}}\n' for s in clock))
    assert table.seconds(tmp_path / "m.jsonl") == 13.5
