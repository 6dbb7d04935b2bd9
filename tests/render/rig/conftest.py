"""What the tests of rigs share."""

import pytest
import toy

from gaussray.capture.formats.paired import read_views
from gaussray.dataset.manifest import write_manifest


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """The views of the toy capture."""
    path = tmp_path_factory.mktemp("rig") / "transforms.json"
    write_manifest(path, toy.records())
    return read_views(path)
