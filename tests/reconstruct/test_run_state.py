"""Whether a run is unfinished or finished is read off its files."""

import pytest

from gaussray.reconstruct.run_state import (
    CHECKPOINT_FILE,
    REQUIREMENT_FILE,
    has_checkpoint,
    is_finished,
)


@pytest.mark.parametrize(
    ("files", "unfinished", "finished"),
    [
        ((), False, False),
        ((CHECKPOINT_FILE,), True, False),
        (("scene.npz", CHECKPOINT_FILE), True, False),
        (("scene.npz", REQUIREMENT_FILE, CHECKPOINT_FILE), True, False),
        (("scene.npz",), False, False),
        (("scene.npz", REQUIREMENT_FILE), False, True),
    ],
)
def test_the_files_of_a_run_tell_its_state(tmp_path, files, unfinished, finished):
    for name in files:
        (tmp_path / name).touch()
    assert (has_checkpoint(tmp_path), is_finished(tmp_path)) == (unfinished, finished)
