"""Words of a command line that Hydra's grammar has no room for."""

import pytest

from gaussray.config.compose import compose_config


@pytest.mark.parametrize(
    "name",
    [
        "runs/näm",
        "a b (1)",
        "it's (1)",
        "C:\\ä\\b",
        "a (b)\\",
        "é\\'x",
        '(a)"b"',
        "plain/name",
        "файл",
        "a=b c=d",
    ],
)
def test_names_of_folders_may_hold_any_letter(name):
    cfg = compose_config("reconstruct", ["capture.path=DIR", f"out={name}"])
    assert cfg.out == name


def test_a_list_that_does_not_end_is_refused():
    with pytest.raises(ValueError, match=r"no viable alternative at input '\[pose'"):
        compose_config("reconstruct", ["capture.path=DIR", "out=o", "fit.refine=[pose"])
