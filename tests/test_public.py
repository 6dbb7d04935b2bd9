"""What `import gaussray` gives, and what it does not load."""

import ast
import importlib.metadata
import inspect
import pathlib
import re
import subprocess
import sys

import pytest

import gaussray


HEAVY = ("hydra", "omegaconf", "OpenImageIO", "skimage", "av", "jaxopt", "numba")
SOURCE = pathlib.Path(gaussray.__file__).read_text()


def test_import_is_light():
    code = f"import gaussray, sys; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "module", ["gaussray.render", "gaussray.tracer.measure", "benchmarks.bench_trace"]
)
def test_rendering_needs_no_package_of_pictures_or_configurations(module):
    code = f"import sys, {module}; print([m for m in {HEAVY} if m in sys.modules])"
    run = {"cwd": pathlib.Path(__file__).parents[1], "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-c", code], check=True, **run)
    assert set(ast.literal_eval(done.stdout)) <= {"numba"}


def test_an_import_of_the_package_alone_loads_nothing():
    code = "import gaussray, sys; print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_every_public_name_is_there_and_is_listed_for_the_type_checker():
    names = set(dir(gaussray))
    assert {name for name in names if not hasattr(gaussray, name)} == set()
    (block,) = (x for x in ast.parse(SOURCE).body if isinstance(x, ast.If))
    typed = {alias.asname for line in block.body for alias in line.names}
    assert typed == names - {"__version__"}


def test_every_public_name_is_in_the_table_of_the_docs():
    page = (pathlib.Path(__file__).parents[1] / "docs/api.md").read_text()
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    told = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert told == set(dir(gaussray)) - {"__version__"}


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="gaussray.*'nothing'"):
        gaussray.nothing  # noqa: B018


def test_stages_are_packages_that_can_be_called():
    for name in ("prepare", "reconstruct", "render", "evaluate", "calibrate"):
        assert callable(getattr(gaussray, name)) and inspect.ismodule(getattr(gaussray, name))
    assert gaussray.render.Renderer is gaussray.Renderer
    assert list(inspect.signature(gaussray.render).parameters)[:2] == ["scene", "camera"]
    with pytest.raises(TypeError, match="scene"):
        gaussray.render()


def test_the_version_is_that_of_the_installed_package():
    assert gaussray.__version__ == importlib.metadata.version("gaussray")
