"""A run that is resumed must be of the pictures that it began with."""

import dataclasses

import equinox as eqx
import pytest
import toy

from gaussray.capture.open import open_capture
from gaussray.capture.selection import Selection, selected
from gaussray.reconstruct.pipeline import reconstruct
from gaussray.reconstruct.same_capture import (
    CAPTURE_FILE,
    demand_same_capture,
    write_capture_facts,
)


@pytest.fixture
def capture(tmp_path):
    return open_capture(toy.write_capture(tmp_path / "capture", toy.scene()))


@pytest.fixture
def out(tmp_path, capture):
    write_capture_facts(tmp_path, capture)
    return tmp_path


def moved(capture):
    """The first camera somewhat aside, in all of its pictures."""

    def aside(view):
        place = view.camera.trajectory.translation + 0.01
        camera = eqx.tree_at(lambda c: c.trajectory.translation, view.camera, place)
        return dataclasses.replace(view, camera=camera)

    return dataclasses.replace(capture, views=[aside(view) for view in capture.views])


def test_the_same_pictures_go_on(out, capture):
    demand_same_capture(out, capture)
    # Nothing is known of a run of an earlier version.
    (out / CAPTURE_FILE).unlink()
    demand_same_capture(out, moved(capture))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: selected(c, Selection(scale=0.5)), r"pixels a picture then, \["),
        (lambda c: selected(c, Selection(frames=(0, 0, 1))), "times then, 1 now"),
        (moved, "as many, with other names, times or cameras"),
    ],
)
def test_other_pictures_are_refused_by_what_differs(out, capture, change, told):
    with pytest.raises(ValueError, match=f"of other pictures .*{told}"):
        demand_same_capture(out, change(capture))


def test_a_run_notes_its_pictures_and_is_not_resumed_with_others(tmp_path, capture, monkeypatch):
    class Stopped(Exception):
        pass

    def stop(*_, **__):
        (tmp_path / "run" / "checkpoint.npz").touch()
        raise Stopped

    monkeypatch.setattr("gaussray.reconstruct.pipeline.fit_plan", stop)
    with pytest.raises(Stopped):
        reconstruct(capture, tmp_path / "run", quiet=True)
    noted = (tmp_path / "run" / CAPTURE_FILE).read_bytes()
    with pytest.raises(ValueError, match="capture.path, and the same capture.frames"):
        reconstruct(moved(capture), tmp_path / "run", resume=True, quiet=True)
    assert (tmp_path / "run" / CAPTURE_FILE).read_bytes() == noted
