"""Camera paths of the viewer: smooth through the keyframes, and rendered as they were previewed."""

import shlex
from types import SimpleNamespace

import numpy as np
import pytest
import rooms

from gaussray.camera.trajectory import Trajectory
from gaussray.capture.frames import read_image
from gaussray.capture.paths import read_path
from gaussray.cli.main import main
from gaussray.viewer.camera_path import (
    path_command,
    path_trajectory,
    save_path,
    turntable,
    viewpoint_at,
)
from gaussray.viewer.path_panel import PathPanel
from gaussray.viewer.preset import save_preset
from gaussray.viewer.viewpoint import Viewpoint, viewing_direction


pytestmark = pytest.mark.usefixtures("known_sizes")

KEYFRAMES = [
    Viewpoint((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -3.0), 0.0),
    Viewpoint((0.8, 0.0, 0.6, 0.0), (0.5, 0.25, -3.0), 0.0),
    Viewpoint((1.0, 0.0, 0.0, 0.0), (1.0, 0.0, -2.5), 0.0),
]


def test_a_path_passes_its_keyframes_at_even_times():
    path = path_trajectory(KEYFRAMES, (2.0, 6.0))
    for k, keyframe in enumerate(KEYFRAMES):
        seen = viewpoint_at(path, k / 2)
        assert seen.time == pytest.approx(2.0 + 2.0 * k)
        np.testing.assert_allclose(seen.position, keyframe.position, atol=1e-6)
        np.testing.assert_allclose(seen.quat, keyframe.quat, atol=1e-6)


def test_a_scene_of_one_time_has_a_path_too():
    path = path_trajectory(KEYFRAMES, (3.0, 3.0))
    np.testing.assert_allclose(viewpoint_at(path, 1.0).position, (1.0, 0.0, -2.5), atol=1e-6)


def test_one_keyframe_is_no_path():
    with pytest.raises(ValueError, match="at least two keyframes, got 1"):
        path_trajectory(KEYFRAMES[:1], (0.0, 1.0))


def test_a_file_holds_the_same_path(tmp_path):
    path = path_trajectory(KEYFRAMES, (0.0, 1.0))
    time, quat, position = read_path(save_path(tmp_path, path))
    again = Trajectory(time, quat, position, "spline")
    for fraction in (0.0, 0.3, 0.8, 1.0):
        one, other = viewpoint_at(path, fraction), viewpoint_at(again, fraction)
        np.testing.assert_allclose(one.position, other.position, atol=1e-5)
        np.testing.assert_allclose(one.quat, other.quat, atol=1e-5)


def test_a_turntable_keeps_its_distance_and_looks_at_the_middle():
    target, up = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
    keyframes = turntable(KEYFRAMES[0], target, up)
    path = path_trajectory(keyframes, (0.0, 1.0))
    for fraction in np.linspace(0, 1, 31):
        seen = viewpoint_at(path, float(fraction))
        away = target - np.asarray(seen.position)
        assert np.linalg.norm(away) == pytest.approx(4.0, rel=1e-3)
        assert viewing_direction(seen) @ away == pytest.approx(4.0, rel=1e-3)
        assert seen.position[1] == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_allclose(keyframes[0].position, keyframes[-1].position, atol=1e-4)


def test_the_command_renders_the_path(tmp_path, capsys):
    run = rooms.write_scene(tmp_path / "run")
    model = rooms.viewer_model(run)
    first = model.initial_viewpoint
    moved = first._replace(position=(first.position[0] + 0.3, *first.position[1:]))
    path = path_trajectory([first, moved], model.times[:2])
    folder = tmp_path / "my path"
    save_preset(model, model.initial_values, viewpoint_at(path, 0.0), folder, size=(12, 12))
    save_path(folder, path)
    main([*shlex.split(path_command(folder, 3))[1:], "quiet=true", "report=false"])
    pictures = sorted((folder / "film" / "images").rglob("*.png"))
    assert len(pictures) == 3
    levels = [read_image(file, 12, 12) for file in pictures]
    assert np.abs(levels[0] - levels[-1]).max() > 0.05


class Handle(SimpleNamespace):
    """A control that keeps its value and its callbacks."""

    def on_click(self, callback):
        self.callback = callback

    on_update = on_click


class Gui:
    """The controls of a panel, by label."""

    def __init__(self):
        self.controls = {}

    def _add(self, label, value=None, **_):
        return self.controls.setdefault(label, Handle(value=value, content=label))

    add_button = add_checkbox = add_number = add_markdown = _add

    def click(self, label):
        self.controls[label].callback(None)


def test_the_panel_records_previews_and_exports(tmp_path):
    model, gui, moves = rooms.viewer_model(rooms.write_scene(tmp_path / "run")), Gui(), []
    page = SimpleNamespace(
        model=model, values=model.initial_values, viewpoint=model.initial_viewpoint, size=(12, 12),
        out=tmp_path / "presets", handles={"name": Handle(value="tour")},
        move_to=moves.append, refresh=lambda: None,
    )  # fmt: skip
    panel = PathPanel(page, gui)
    gui.click("Export path")
    assert "at least two keyframes, got 0" in panel.text.content
    gui.click("Add keyframe")
    page.viewpoint = page.viewpoint._replace(position=(1.0, 0.0, -3.0))
    gui.click("Add keyframe")
    assert panel.text.content == "2 keyframes."
    panel.advance()
    assert not moves
    gui.controls["preview"].value = True
    gui.click("preview")
    panel.advance()
    assert len(moves) == 1 and moves[0].time == pytest.approx(model.times[0], abs=0.2)
    gui.click("Export path")
    assert f"trajectory.steps={round(4 * model.fps)}" in panel.text.content
    assert (tmp_path / "presets" / "tour" / "path.json").is_file()
    gui.click("Turntable")
    assert panel.text.content == "25 keyframes."
    gui.click("Remove last keyframe")
    assert len(panel.keyframes) == 24
    gui.click("Remove all keyframes")
    assert panel.keyframes == []
