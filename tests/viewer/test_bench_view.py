"""The benchmark of the page's pictures times every stage of them."""

import json

import pytest
import rooms

from benchmarks import bench_view, record
from gaussray.viewer.timing import PREVIEW_STAGES


@pytest.mark.ci
@pytest.mark.usefixtures("known_sizes")
def test_the_page_s_pictures_are_timed(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(record, "RESULTS", tmp_path / "results")
    run = rooms.write_scene(tmp_path / "toy")
    bench_view.main([str(run), *rooms.WORDS, "--widths", "8", "16", "--frames", "2"])
    lines = (tmp_path / "results" / "view.jsonl").read_text().splitlines()
    for line, width in zip(map(json.loads, lines), (8, 16), strict=True):
        assert (line["width"], line["height"], line["rays"]) == (width, width, width**2)
        assert line["scene"] == "toy" and line["dropped"] == 0 and line["hits"] > 0
        assert all(line[stage] > 0 for stage in PREVIEW_STAGES)
        assert line["final_s"] > 0
        assert line["fps"] == pytest.approx(1 / line["latency_s"])
    assert "tracing" in capsys.readouterr().out
