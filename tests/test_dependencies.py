"""What is installed is known beforehand: pinned ranges, and lock files that keep to them."""

import pathlib
import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


ROOT = pathlib.Path(__file__).parents[1]
# Each lock, and the extras that it is made of.
LOCKS = {"requirements.lock": ("test", "bench", "launch"), "requirements-cuda.lock": ("cuda",)}


@pytest.fixture(scope="module")
def project():
    path = ROOT / "pyproject.toml"
    if not path.is_file():
        pytest.skip("not a checkout")
    return tomllib.loads(path.read_text())["project"]


def pins(path):
    """Versions by name; a package may have one for each version of Python."""
    found = {}
    for line in path.read_text().splitlines():
        if match := re.match(r"([\w.-]+)==([^\s;]+)", line):
            found.setdefault(canonicalize_name(match[1]), []).append(match[2])
    return found


def test_every_dependency_has_a_range_with_two_ends(project):
    extras = [x for listed in project["optional-dependencies"].values() for x in listed]
    for text in (*project["dependencies"], *extras):
        operators = {specifier.operator for specifier in Requirement(text).specifier}
        assert operators >= {">=", "<"}, text


@pytest.mark.parametrize("name", LOCKS)
def test_a_lock_keeps_to_the_ranges(project, name):
    found = pins(ROOT / name)
    extras = [x for extra in LOCKS[name] for x in project["optional-dependencies"][extra]]
    for text in (*project["dependencies"], *extras):
        wanted = Requirement(text)
        versions = found.get(canonicalize_name(wanted.name), [])
        assert versions, f"{name} lacks {text}: make it anew by the command in its first lines"
        assert all(version in wanted.specifier for version in versions), (text, versions)


@pytest.mark.parametrize("name", LOCKS)
def test_every_pin_has_a_hash_and_no_address(name):
    text = (ROOT / name).read_text()
    assert not re.search(r"https?:|file:|git\+|@ |--(extra-)?index|--find-links", text)
    blocks = re.split(r"\n(?=[\w.-]+==)", text)[1:]
    assert len(blocks) > 20 and all("--hash=sha256:" in block for block in blocks)
