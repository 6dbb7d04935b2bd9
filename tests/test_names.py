"""Every public name means one thing in the whole package."""

import ast
import collections
import pathlib


PACKAGE = pathlib.Path(__file__).parents[1] / "gaussray"
# `main` starts a module that runs as a command; T is a type variable; MODELS is what the registry
# of lenses reads from every lens.
PROTOCOL = {"main", "T", "MODELS"}


def public_names(path: pathlib.Path) -> set[str]:
    """Functions, classes and constants that a module defines for others."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                names.add(name)
            case ast.Assign(targets=targets):
                names |= {target.id for target in targets if isinstance(target, ast.Name)}
                names |= {x.id for t in targets if isinstance(t, ast.Tuple) for x in t.elts}
            case ast.AnnAssign(target=ast.Name(id=name)):
                names.add(name)
    return {name for name in names if not name.startswith("_")}


def defined_twice() -> dict[str, list[str]]:
    """The modules of each public name that more than one module defines."""
    modules = collections.defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in public_names(path) - PROTOCOL:
            modules[name].append(str(path.relative_to(PACKAGE)))
    return {name: places for name, places in modules.items() if len(places) > 1}


def test_a_public_name_is_defined_in_one_module():
    twice = defined_twice()
    assert not twice, "\n".join(f"{name}: {', '.join(m)}" for name, m in sorted(twice.items()))
