"""Values of the wrong kind are refused by their names."""

import dataclasses

import numpy as np
import pytest

from gaussray.io.validate import check_field_types
from gaussray.reconstruct.options import FitOptions


@dataclasses.dataclass
class Some:
    count: int = 1
    share: float = 0.5
    on: bool = True
    name: str = "a"
    more: tuple = ()


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"count": 1.5}, "some.count must be a whole number, got 1.5."),
        ({"count": True}, "some.count must be a whole number, got True."),
        ({"share": "a"}, "some.share must be a number, got 'a'."),
        ({"on": 1}, "some.on must be true or false, got 1."),
        ({"name": None}, "some.name must be a text, got None."),
    ],
)
def test_a_field_of_another_type_is_named(change, rule):
    with pytest.raises(ValueError, match=rule):
        check_field_types("some", Some(**change))


def test_numbers_of_numpy_and_whole_numbers_are_numbers():
    check_field_types("some", Some(count=np.int32(3), share=2, more=[1]))
    check_field_types("some", Some(share=np.float32(0.1), on=np.bool_(False)))


def test_options_of_a_fit_are_checked():
    options = FitOptions()
    # The tests' type checker would refuse it before.
    object.__setattr__(options, "coarse", 10.5)
    with pytest.raises(ValueError, match="fit.coarse must be a whole number, got 10.5."):
        options.__check_init__()
