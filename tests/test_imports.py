"""What benchmarks, experiments and the package import from gaussray exists, in functions too."""

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[1]
FILES = sorted(
    file
    for folder in ("gaussray", "benchmarks", "experiments")
    for file in (ROOT / folder).rglob("*.py")
)


def imported(file):
    """Module and name of each `from gaussray... import name` anywhere in a file."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            if node.module.split(".")[0] in ("gaussray", "benchmarks", "experiments"):
                yield from ((node.module, alias.name) for alias in node.names)


def exists(module, name):
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        # Of an extra that is not installed.
        return error.name.split(".")[0] not in ("gaussray", "benchmarks", "experiments")
    if hasattr(found, name):
        return True
    return hasattr(found, "__path__") and importlib.util.find_spec(f"{module}.{name}") is not None


@pytest.mark.parametrize("folder", ["gaussray", "benchmarks", "experiments"])
def test_every_imported_name_exists(folder):
    named = {
        (module, name): file
        for file in FILES
        if file.relative_to(ROOT).parts[0] == folder
        for module, name in imported(file)
    }
    assert named
    assert [f"{named[pair]}: {pair}" for pair in named if not exists(*pair)] == []
