"""From a wish to the picture that `gaussray render` makes, and to a file that says how."""

import threading

import numpy as np
import pytest
import rooms

from gaussray.capture.frames import read_stored
from gaussray.cli.main import main
from gaussray.config.compose import compose_config
from gaussray.viewer import preview as module
from gaussray.viewer.controls import chosen
from gaussray.viewer.preset import command, folder_of, presets, read_preset, save_preset
from gaussray.viewer.preview import Sketcher
from gaussray.viewer.session import Session, Wish
from gaussray.viewer.timing import Meter, Reading, sentence


pytestmark = pytest.mark.usefixtures("quick_compilation", "known_sizes")

PATIENCE = 120


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return rooms.write_scene(tmp_path_factory.mktemp("run"))


@pytest.fixture(scope="module")
def studio(run):
    return rooms.studio(run)


class Screen:
    """What a session has shown and told, and a session that does."""

    def __init__(self, studio):
        shot = studio.shot(studio.begin, studio.stance, studio.size)
        self.sheets, self.said, self.whole = [], [], threading.Event()
        self.sketcher = Sketcher(studio.scene, options=shot.options, trace=shot.trace, keys=3)
        self.session = Session(studio, self.sketcher, self.show, self.tell)

    def show(self, sheet, whole):
        self.sheets.append((sheet, whole))
        if whole:
            self.whole.set()

    def tell(self, said):
        self.said.append(said)

    def see(self, wish):
        """The whole pictures of a wish."""
        self.whole.clear()
        self.session.wish(wish)
        assert self.whole.wait(PATIENCE), self.said[-3:]
        return dict(self.session.pictures)


@pytest.fixture(scope="module")
def screen(studio, quick_compilation, known_sizes):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "measure", lambda *_, **__: rooms.ROOM)
        patch.setattr(Session, "_anticipate", lambda *_: None)
        screen = Screen(studio)
        yield screen
        screen.session.close()
        screen.sketcher.close()


def test_a_wish_is_sketched_and_then_rendered(studio, screen):
    seen = screen.see(Wish(studio.begin, studio.stance, window=2.0))
    assert list(seen) == ["effect"] and seen["effect"].shape == (16, 16, 3)
    kinds = [whole for _, whole in screen.sheets]
    assert kinds[0] is False and kinds[-1] is True
    assert screen.sheets[-1][0].shape == (16, 32, 3)
    reading = screen.said[-1]
    assert reading.whole and reading.dropped == 0 and reading.size == (16, 16)
    first = next(x for x in screen.said if isinstance(x, Reading) and x.stages)
    assert set(first.stages) == {"tracing", "developing", "encoding"} and first.hits > 0


def test_a_camera_that_cannot_be_is_told_of_and_the_next_one_shown(studio, screen):
    broken = studio.begin | {"aperture.radius": 0.1, "aperture.focus_distance": -1.0}
    screen.session.wish(Wish(broken, studio.stance))
    for _ in range(PATIENCE * 20):
        if isinstance(screen.said[-1], str):
            break
        threading.Event().wait(0.05)
    assert "aperture.focus_distance must be above 0" in screen.said[-1]
    assert screen.see(Wish(studio.begin, studio.stance))


def test_a_saved_preset_renders_what_was_shown(studio, screen, run):
    values = studio.begin | chosen("sensor", "filmic") | {"lens.fov": 50.0}
    stance = studio.stance._replace(time=0.375)
    seen = screen.see(Wish(values, stance))["effect"]
    folder = run / "presets" / "a film"
    file = save_preset(studio, values, stance, folder, seen)
    assert presets(run / "presets") == ["a film"]
    assert (read_stored(folder / "picture.png", 16, 16) == seen).all()
    main(["render", f"preset={file}", f"out={run}/film", "quiet=true"])
    (path,) = (run / "film" / "images").rglob("*.png")
    filmed = read_stored(path, 16, 16).astype(int)
    # The pose has been through a matrix of single precision.
    assert np.abs(filmed - seen).max() <= 1 and seen.std() > 10
    assert f"preset={file}" in command(folder).replace("'", "")


def test_a_preset_sets_the_page_as_it_was(studio, run):
    values = studio.begin | chosen("lens", "equidistant") | chosen("shutter", "rolling")
    stance = studio.stance._replace(time=0.5, place=(0.5, -0.25, -3.0))
    save_preset(studio, values, stance, run / "presets" / "b")
    found = read_preset(run / "presets" / "b")
    assert found.values["aperture.focus"] == "sphere"
    assert {**found.values, "aperture.focus": "plane"} == {
        k: list(v) if isinstance(v, tuple) else v for k, v in values.items()
    }
    assert found.stance.place == stance.place and found.stance.time == 0.5
    np.testing.assert_allclose(found.stance.quat, stance.quat, atol=1e-6)


@pytest.mark.parametrize("name", ["../up", "", "a/b", ".hidden", " "])
def test_a_preset_stays_in_its_folder(tmp_path, name):
    assert folder_of(tmp_path, "a b-1.5") == tmp_path / "a b-1.5"
    with pytest.raises(ValueError, match="a preset's name must be"):
        folder_of(tmp_path, name)


def test_keys_after_a_preset_win_and_those_before_do_not(studio, run):
    save_preset(studio, {**studio.begin, "lens.fov": 50.0}, studio.stance, run / "presets" / "c")
    word = f"preset={run}/presets/c/preset.yaml"
    given = ["out=x", word]
    assert compose_config("render", given).lens.fov == 50.0
    assert compose_config("render", [*given, "lens.fov=70"]).lens.fov == 70
    assert compose_config("render", ["lens.fov=70", *given]).lens.fov == 50.0


def test_the_stages_are_timed_and_told():
    meter = Meter()
    assert meter.finish() == 0
    with meter.stage("tracing"):
        pass
    assert meter.stages["tracing"] >= 0 and meter.finish() > 0
    reading = Reading((320, 240), 4, {"tracing": 12.4}, 3.25, 7, False, 2, 9.5)
    said = sentence(reading, 16)
    for part in ("9.5 frames/s", "320 x 240 px", "tracing 12", "k = 16", "7 dropped"):
        assert part in said
    assert "compiling 2 programs" in said
