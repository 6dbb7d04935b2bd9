"""Which pictures are fitted is said; a capture without any is refused with the remedy."""

import dataclasses
from pathlib import Path

import pytest
import toy

from gaussray.capture.errors import CaptureError
from gaussray.capture.formats.paired import read_capture
from gaussray.capture.selection import Selection, selected
from gaussray.cli.main import main
from gaussray.reconstruct import reconstruct
from gaussray.reconstruct.data.training_split import (
    demand_training_pictures,
    division_sentence,
)


pytestmark = pytest.mark.usefixtures("known_sizes")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, known_sizes):
    return toy.write_capture(tmp_path_factory.mktemp("capture"), toy.scene())


def divided(capture, held):
    """The capture with its first pictures held out."""
    views = [
        dataclasses.replace(view, split="test" if i < held else "train")
        for i, view in enumerate(capture.views)
    ]
    return dataclasses.replace(capture, views=views)


def test_the_sentence_counts_pictures_and_names_cameras_reason_and_remedy(folder):
    capture = read_capture(folder)
    count = len(capture.views)
    one = division_sentence(divided(capture, 1), False)
    name = capture.views[0].camera_name
    assert one.startswith(f"Fits {count - 1} of {count} pictures and holds out 1 to score")
    assert f"(camera {name})" in one
    assert "format or files say" in one and "capture.test=[] fits all" in one
    assert "as capture.test says" in division_sentence(divided(capture, 1), True)
    none = division_sentence(divided(capture, 0), False)
    assert none.startswith(f"Fits all {count} pictures.") and "capture.test=[CAMERA]" in none
    assert "truth_frames" not in none
    # What capture.frames leaves out can score it.
    some = division_sentence(divided(capture, 0), False, [0, -1, 2])
    assert some.startswith(none) and "truth_frames=[1,-1,2] evaluate.split=all" in some


def test_of_a_single_camera_instants_are_held_out(folder):
    capture = read_capture(folder)
    name = capture.views[0].camera_name
    views = [v for v in divided(capture, 0).views if v.camera_name == name]
    single = dataclasses.replace(capture, views=views)
    all_of_it = division_sentence(single, False)
    assert "capture.frames=[0,-1,2]" in all_of_it and "capture.test" not in all_of_it
    assert f"truth={folder} truth_frames=[1,-1,2] evaluate.split=all" in all_of_it
    assert "truth_frames=[4,9,4] evaluate.split=all" in division_sentence(single, False, [2, 9, 4])
    # Halfway between instants that were fitted.
    assert "truth_frames=[10,400,20] evaluate" in division_sentence(single, False, [0, 400, 20])
    assert "truth_frames=[2,-1,3] evaluate" in division_sentence(single, False, [1, -1, 3])
    # Of few instants, as they are selected; after one alone there is none.
    last = len(views) - 1
    for frames, count, told in (
        ([0, last, last], 2, f"truth_frames=[{last // 2},{last},{last}] evaluate"),
        ([0, 0, 1], 1, ""),
        ([2, 2, 1], 1, ""),
    ):
        few = selected(single, Selection(frames=tuple(frames)))
        sentence = division_sentence(few, False, frames)
        assert sentence.startswith(f"Fits all {count} pictures of a single camera.")
        assert told in sentence and ("evaluate" in sentence) == bool(told)
        with pytest.raises(CaptureError, match="its single camera cannot be held out"):
            demand_training_pictures(divided(few, count), frames)
    assert "truth_frames=[2,3,4] evaluate" in division_sentence(single, False, [0, 3, 4])
    with pytest.raises(CaptureError, match=r"its single camera .* capture.frames=\[0,-1,2\]"):
        demand_training_pictures(divided(single, len(views)))
    with pytest.raises(CaptureError, match=r"truth_frames=\[4,9,4\] evaluate.split=all"):
        demand_training_pictures(divided(single, len(views)), [2, 9, 4])
    spaced = dataclasses.replace(single, folder=Path("/tmp/my capture"))
    assert "evaluate scene=OUT 'truth=/tmp/my capture' truth" in division_sentence(spaced, False)
    # The instants of both are those of the capture, none in common.
    fitted, scored = (
        {v.time for v in selected(single, Selection(frames=frames)).views}
        for frames in ((0, -1, 2), (1, -1, 2))
    )
    assert fitted | scored == {v.time for v in views} and not fitted & scored


def test_a_capture_of_held_out_pictures_alone_is_refused_before_anything_is_written(
    folder, tmp_path, capsys
):
    capture = read_capture(folder)
    demand_training_pictures(divided(capture, len(capture.views) - 1))
    with pytest.raises(CaptureError, match=r"all \d+ are held out .*capture\.test=\[\] fits all"):
        reconstruct(divided(capture, len(capture.views)), tmp_path / "a", options=toy.SHORT)
    assert not (tmp_path / "a" / "scene.npz").exists()
    words = ["reconstruct", f"capture.path={folder}", f"out={tmp_path / 'b'}", "capture.test=['*']"]
    with pytest.raises(SystemExit) as exit_:
        main(words)
    output = capsys.readouterr()
    assert exit_.value.code == 2
    assert "held out" in output.err and "capture.test=[]" in output.err
    assert "0 pictures" not in output.out + output.err
    assert not (tmp_path / "b").exists()


def test_effects_alone_are_no_pictures_to_fit(folder):
    capture = read_capture(folder)
    alone = dataclasses.replace(capture, views=[], effects={"fisheye": capture.views[:3]})
    with pytest.raises(CaptureError, match="no pinhole pictures.* 3 pictures of camera effects"):
        demand_training_pictures(alone)
