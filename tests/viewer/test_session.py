"""From a request to the picture that `gaussray render` makes, and to a file that says how."""

import threading

import numpy as np
import pytest
import rooms

from gaussray.capture.picture_file import read_stored
from gaussray.cli.main import main
from gaussray.config.compose import compose_config
from gaussray.viewer import preview
from gaussray.viewer.controls import choice_values
from gaussray.viewer.preset import (
    preset_folder,
    preset_names,
    read_preset,
    render_command,
    save_preset,
)
from gaussray.viewer.preview import PreviewRenderer
from gaussray.viewer.session import RenderRequest, ViewerSession
from gaussray.viewer.timing import RenderStatus, StageTimer, status_text


pytestmark = pytest.mark.usefixtures("known_sizes")

PATIENCE = 120


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return rooms.write_scene(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def model(run):
    return rooms.viewer_model(run)


class Screen:
    """What a session has shown and told, and a session that does."""

    def __init__(self, model):
        job = model.job(model.initial_values, model.initial_viewpoint, model.size)
        self.sheets, self.said, self.whole = [], [], threading.Event()
        self.previewer = PreviewRenderer(model.scene, options=job.options, trace=job.trace, keys=3)
        self.session = ViewerSession(model, self.previewer, self.show, self.tell)

    def show(self, sheet, whole):
        self.sheets.append((sheet, whole))
        if whole:
            self.whole.set()

    def tell(self, said):
        self.said.append(said)

    def see(self, request):
        """The whole pictures of a request."""
        self.whole.clear()
        self.session.request(request)
        assert self.whole.wait(PATIENCE), self.said[-3:]
        return dict(self.session.pictures)


@pytest.fixture(scope="module")
def screen(model, known_sizes):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(preview, "staged_capacity", lambda *_: rooms.ROOM)
        patch.setattr(ViewerSession, "_compile_likely_next", lambda *_: None)
        screen = Screen(model)
        yield screen
        screen.session.close()
        screen.previewer.close()


def test_a_wish_is_sketched_and_then_rendered(model, screen):
    seen = screen.see(RenderRequest(model.initial_values, model.initial_viewpoint, window=2.0))
    assert list(seen) == ["camera"] and seen["camera"].shape == (16, 16, 3)
    kinds = [whole for _, whole in screen.sheets]
    assert kinds[0] is False and kinds[-1] is True
    assert screen.sheets[-1][0].shape == (16, 32, 3)
    reading = screen.said[-1]
    assert reading.final and reading.dropped == 0 and reading.size == (16, 16)
    first = next(x for x in screen.said if isinstance(x, RenderStatus) and x.stages)
    assert set(first.stages) == {"tracing", "developing", "encoding"} and first.hits > 0


def test_a_camera_that_cannot_be_is_told_of_and_the_next_one_shown(model, screen):
    broken = model.initial_values | {"aperture.radius": 0.1, "aperture.focus_distance": -1.0}
    screen.session.request(RenderRequest(broken, model.initial_viewpoint))
    for _ in range(PATIENCE * 20):
        if isinstance(screen.said[-1], str):
            break
        threading.Event().wait(0.05)
    assert "aperture.focus_distance must be above 0" in screen.said[-1]
    assert screen.see(RenderRequest(model.initial_values, model.initial_viewpoint))


def test_a_saved_preset_renders_what_was_shown(model, screen, run):
    values = model.initial_values | choice_values("sensor", "filmic") | {"lens.fov": 50.0}
    viewpoint = model.initial_viewpoint._replace(time=0.375)
    seen = screen.see(RenderRequest(values, viewpoint))["camera"]
    folder = run / "presets" / "a film"
    file = save_preset(model, values, viewpoint, folder, seen)
    assert preset_names(run / "presets") == ["a film"]
    assert (read_stored(folder / "picture.png", 16, 16) == seen).all()
    main(["render", f"preset={file}", f"out={run}/film", "quiet=true"])
    (path,) = (run / "film" / "images").rglob("*.png")
    filmed = read_stored(path, 16, 16).astype(int)
    # The pose has been through a matrix of single precision.
    assert np.abs(filmed - seen).max() <= 1 and seen.std() > 10
    assert f"preset={file}" in render_command(folder).replace("'", "")


def test_a_preset_sets_the_page_as_it_was(model, run):
    values = (
        model.initial_values
        | choice_values("lens", "equidistant")
        | choice_values("shutter", "rolling")
    )
    viewpoint = model.initial_viewpoint._replace(time=0.5, position=(0.5, -0.25, -3.0))
    save_preset(model, values, viewpoint, run / "presets" / "b")
    found = read_preset(run / "presets" / "b")
    assert found.values["aperture.focus"] == "sphere"
    assert {**found.values, "aperture.focus": "plane"} == {
        k: list(v) if isinstance(v, tuple) else v for k, v in values.items()
    }
    assert found.viewpoint.position == viewpoint.position and found.viewpoint.time == 0.5
    np.testing.assert_allclose(found.viewpoint.quat, viewpoint.quat, atol=1e-6)


@pytest.mark.parametrize("name", ["../up", "", "a/b", ".hidden", " "])
def test_a_preset_stays_in_its_folder(tmp_path, name):
    assert preset_folder(tmp_path, "a b-1.5") == tmp_path / "a b-1.5"
    with pytest.raises(ValueError, match="a preset's name must start"):
        preset_folder(tmp_path, name)


def test_keys_after_a_preset_win_and_those_before_do_not(model, run):
    save_preset(
        model,
        {**model.initial_values, "lens.fov": 50.0},
        model.initial_viewpoint,
        run / "presets" / "c",
    )
    word = f"preset={run}/presets/c/preset.yaml"
    given = ["out=x", word]
    assert compose_config("render", given).lens.fov == 50.0
    assert compose_config("render", [*given, "lens.fov=70"]).lens.fov == 70
    assert compose_config("render", ["lens.fov=70", *given]).lens.fov == 50.0


def test_the_stages_are_timed_and_told():
    timer = StageTimer()
    assert timer.finish() == 0
    with timer.stage("tracing"):
        pass
    assert timer.stages["tracing"] >= 0 and timer.finish() > 0
    reading = RenderStatus((320, 240), 4, {"tracing": 12.4}, 3.25, 7, False, 2, 9.5)
    said = status_text(reading)
    for part in (
        "9.5 frames/s",
        "320 x 240 pixels",
        "ray tracing 12 ms",
        "3.2 Gaussians",
        "7 list entries",
    ):
        assert part in said
    assert "compiling 2 programs" in said
