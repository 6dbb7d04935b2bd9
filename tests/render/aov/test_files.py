"""Labels as files: beside the pictures, in their lists, and only if they are asked for."""

import dataclasses
import json

import numpy as np
import pytest
import toy

from gaussray.camera.shutter import interlaced_row_times, row_moments
from gaussray.capture.formats.paired import read_capture
from gaussray.dataset.layers import read_layers
from gaussray.dataset.sample_manifest import row_exposure_times
from gaussray.render import dataset
from gaussray.render.aov.files import neighbour_cameras, with_label_files
from gaussray.render.dataset import render_dataset
from gaussray.render.options import DatasetOptions, RenderOptions
from gaussray.render.renderer import Renderer


ASKED = ("depth", "flow_forward", "moving", "sharp")


def film(folder, records, labels=()):
    """Every file that filming leaves, by its path."""
    renderer = Renderer(toy.scene(speed=0), options=RenderOptions(samples=1), trace=toy.TRACE)
    render_dataset(renderer, records, folder, options=DatasetOptions(labels=labels), quiet=True)
    return {p.relative_to(folder).as_posix(): p for p in sorted(folder.rglob("*")) if p.is_file()}


def test_labels_are_written_and_listed_beside_pictures_that_stay_as_they_are(tmp_path, monkeypatch):
    records = toy.records()[:3]
    with monkeypatch.context() as patch:
        patch.setattr(dataset, "Labeller", lambda *_, **__: pytest.fail("nothing was asked for"))
        plain = film(tmp_path / "plain", records)
    assert not any(path.startswith("labels") or "sharp" in path for path in plain)
    assert "labels" not in (tmp_path / "plain" / "transforms.json").read_text()

    found = film(tmp_path / "all", records, ASKED)
    for path in plain.keys() - {"transforms.json", "render.sha256"}:
        assert found[path].read_bytes() == plain[path].read_bytes()
    document = json.loads(found["transforms.json"].read_text())
    assert list(document["info"]["labels"]) == list(ASKED)
    for frame in document["frames"]:
        assert set(frame["labels"]) == {"layers", "moving", "sharp"}
        assert set(frame["labels"].values()) <= found.keys()
    layers = [read_layers(found[frame["labels"]["layers"]]) for frame in document["frames"]]
    assert all(set(x) == {"depth", "flow_forward.x", "flow_forward.y"} for x in layers)
    # The last frame has none behind it; those before it, of a scene that stands still, do.
    flow = [x["flow_forward.x"] for x in layers]
    assert np.isnan(flow[-1]).all() and np.nanmax(np.abs(flow[0])) < 1e-3
    capture = read_capture(tmp_path / "all")
    assert len(capture.views) == 3 and len(capture.effects["sharp"]) == 3

    gone = found[document["frames"][1]["labels"]["layers"]]
    before = read_layers(gone)
    gone.unlink()
    again = film(tmp_path / "all", records, ASKED)
    assert again.keys() == found.keys()
    np.testing.assert_equal(read_layers(gone), before)
    with pytest.raises(ValueError, match="holds pictures of another scene, camera or option"):
        film(tmp_path / "all", records)


def test_neighbours_are_those_in_time_of_the_same_camera():
    records = toy.records()
    near = neighbour_cameras(records[::-1])
    first, second, third = records[:3]
    assert near[first.file_path] == (None, second.camera)
    assert near[second.file_path] == (first.camera, third.camera)
    assert near[third.file_path] == (second.camera, None)
    assert with_label_files(records, ()) == records


@pytest.mark.parametrize("first", ["even", "odd"])
def test_global_twins_of_fields_and_tables_have_the_least_and_the_median_moment(first):
    fields = interlaced_row_times(toy.SIZE, 0.1, first)
    table = np.random.default_rng(3).permutation(np.linspace(-0.1, 0.1, toy.SIZE))
    for row_times in (fields, table):
        camera = toy.rolling(toy.camera(), readout=0.02)
        shutter = dataclasses.replace(camera.shutter, row_times=toy.single(row_times))
        camera = dataclasses.replace(camera, shutter=shutter)
        moments = np.sort(row_moments(shutter, (toy.SIZE, toy.SIZE)))
        record = dataclasses.replace(toy.records()[0], camera=camera)
        _, *twins = with_label_files([record], ("global_first", "global_middle"))
        for twin, expected in zip(twins, (moments[0], moments[toy.SIZE // 2]), strict=True):
            np.testing.assert_allclose(twin.camera.shutter.row_offset, expected, rtol=1e-6)
            assert twin.camera.shutter.row_times is None
        # The velocities of carla_rs are those of this moment.
        assert row_exposure_times(twins[0].camera) == [min(row_exposure_times(camera))]
