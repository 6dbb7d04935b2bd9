"""Lower layers never import upper ones, and siblings never import each other."""

import ast
import pathlib

import gaussray


PACKAGE = pathlib.Path(gaussray.__file__).parent
# From the ground up; packages of one line never import each other.
LEVELS = [
    {"geometry", "color", "io"},
    {"runtime"},
    {"scene", "camera"},
    {"tracer", "capture", "dataset"},
    {"reconstruct", "render", "prepare"},
    {"evaluate", "calibrate"},
    {"config", "report"},
    {"viewer", "torch"},
    {"cli"},
]


def level(part):
    """How high a top-level module stands; an unknown one must be given its place above."""
    found = [i for i, parts in enumerate(LEVELS) if part in parts]
    assert found, f"{part} has no place in LEVELS"
    return found[0]


def imported_parts(source):
    """Top-level parts of gaussray that a module imports, wherever in it."""
    names = imported_names(source)
    return [name.split(".")[1] for name in names if name.startswith("gaussray.")]


def imported_modules(source):
    """Top-level modules and packages of any origin that a module imports."""
    return [name.split(".")[0] for name in imported_names(source)]


def imported_names(source):
    """Full names of all modules that a module imports."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports must be absolute"
            if node.module == "gaussray":
                names += [f"gaussray.{name.name}" for name in node.names]
            else:
                names.append(node.module)
    return names


def wrong_imports(path, source):
    own = path.with_suffix("").parts[0]
    return [
        f"{path} imports {other}"
        for other in imported_parts(source)
        if other != own and level(other) >= level(own)
    ]


def test_imports_only_point_down():
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        inside = path.relative_to(PACKAGE)
        if inside.parts[0] not in ("__init__.py", "__main__.py", "conf"):
            wrong += wrong_imports(inside, path.read_text())
    assert not wrong, wrong


def test_omegaconf_and_hydra_are_imported_by_the_configuration_and_the_command_alone():
    importers = {
        path.relative_to(PACKAGE).parts[0]
        for path in PACKAGE.rglob("*.py")
        if set(imported_modules(path.read_text())) & {"hydra", "omegaconf"}
    }
    assert importers <= {"config", "cli"}


def test_the_root_holds_packages_alone():
    loose = {path.stem for path in PACKAGE.glob("*.py")}
    assert loose == {"__init__", "__main__", "geometry", "color"}


def test_upward_and_sideways_imports_are_caught():
    path = pathlib.PurePath("tracer/trace.py")
    assert not wrong_imports(path, "from gaussray.camera.rays import Rays\nimport gaussray.tracer")
    assert wrong_imports(path, "from gaussray.render import Renderer")
    assert wrong_imports(path, "def f():\n    import gaussray.reconstruct.step")
    assert wrong_imports(path, "from gaussray import dataset")
