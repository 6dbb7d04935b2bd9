"""A data set of pictures: read back, kept, and scored against itself."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy

from gaussray import filming
from gaussray.camera.camera import camera_rays
from gaussray.capture.calibration import read_capture
from gaussray.evaluate import EvaluateOptions, evaluate
from gaussray.filming import render_dataset
from gaussray.render import RenderOptions


pytestmark = pytest.mark.usefixtures("quick_compilation")

ONE = RenderOptions(samples=1)
# Room for one picture that waits to be written.
SCARCE = toy.SIZE**2 * 3 * 4

shoot = jax.jit(camera_rays)


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
        render_dataset(
            scene, records, tmp_path, options=RenderOptions(samples=2), trace=toy.TRACE, quiet=True
        )

    report = evaluate(
        scene, capture, tmp_path / "scores", options=EvaluateOptions(split="all"), render=ONE,
        trace=toy.TRACE, quiet=True,
    )  # fmt: skip
    assert report["frames"] == 13 and set(report["effects"]) == {"pinhole", "rolling_shutter"}
    for row in report["effects"].values():
        assert row["psnr"] is None or row["psnr"] > 45
    text = (tmp_path / "scores" / "report.json").read_text()
    json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_what_cannot_be_written_stops_the_run_and_what_was_written_stays(tmp_path, monkeypatch):
    records, write = toy.records()[:4], filming.write_image

    def refuse(path, color):
        if path == tmp_path / records[2].file_path:
            raise OSError(f"{path}: the picture cannot be written: no space left")
        write(path, color)

    monkeypatch.setattr(filming, "write_image", refuse)
    monkeypatch.setattr(filming, "BACKLOG", SCARCE)
    with pytest.raises(OSError, match="the picture cannot be written: no space left"):
        render_dataset(toy.scene(), records, tmp_path, options=ONE, trace=toy.TRACE, quiet=True)
    assert all((tmp_path / record.file_path).exists() for record in records[:2])
    assert not (tmp_path / "transforms.json").exists()
    monkeypatch.setattr(filming, "write_image", write)
    render_dataset(toy.scene(), records, tmp_path, options=ONE, trace=toy.TRACE, quiet=True)
    assert len(read_capture(tmp_path).views) == 4
