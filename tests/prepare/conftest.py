"""Fixtures of the tests of `gaussray prepare`."""

import pytest
from quads import textures


@pytest.fixture(scope="session")
def painted():
    return textures()
