"""Files that are read in one sitting, functions whose arguments are seen and explained."""

import ast
import pathlib


ROOT = pathlib.Path(__file__).parents[1]
FILES = sorted((ROOT / "gaussray").rglob("*.py"))
LINES, PARAMETERS = 350, 8
# Functions that take any keyword, because any name has a meaning there: attributes of an element of
# HTML, values of a line of JSON, fields of a lens; or because the caller's interface is not ours:
# listeners of JAX, `warnings.showwarning`, and functions that a decorator passes everything on to.
ANY_KEYWORD = {
    ("report/markup.py", "tag"),
    ("runtime/progress.py", "say"),
    ("cli/result.py", "say_result"),
    ("camera/lens/abstract.py", "_replaced"),
    ("runtime/jit_cache.py", "hear"),
    ("runtime/progress.py", "show"),
    ("runtime/lock.py", "locked"),
    ("runtime/program_cache.py", "called"),
    ("runtime/stored_programs.py", "called"),
}


def functions(source):
    """Each function of a module, wherever in it, with its parameters but for self and cls."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            taken = node.args
            names = [a.arg for a in (*taken.posonlyargs, *taken.args, *taken.kwonlyargs)]
            names += [a.arg for a in (taken.vararg, taken.kwarg) if a]
            yield node, [name for name in names if name not in ("self", "cls")]


def crowded(source):
    """Names of functions with more parameters than a reader keeps in mind."""
    return [node.name for node, names in functions(source) if len(names) > PARAMETERS]


def any_keyword(source):
    """Names of functions that take any keyword."""
    return {node.name for node, _ in functions(source) if node.args.kwarg}


def public_functions(source):
    """Public functions of a module and of its public classes, with the names of their parameters,
    but for those that have their docstring from an abstract class."""
    for node in ast.parse(source).body:
        inner = node.body if isinstance(node, ast.ClassDef) else [node]
        for one in inner if not getattr(node, "name", "_").startswith("_") else []:
            if isinstance(one, ast.FunctionDef) and not one.name.startswith("_"):
                names = next(functions(ast.unparse(one)))[1]
                if ast.get_docstring(one):
                    yield one, names


def unexplained(source):
    """Names of public functions of several parameters whose docstring has no list of them."""
    return [
        node.name
        for node, names in public_functions(source)
        if len(names) > 1 and "Args:" not in ast.get_docstring(node)
    ]


def test_public_functions_explain_their_arguments():
    assert [f"{f}: {name}" for f in FILES for name in unexplained(f.read_text())] == []


def test_no_file_is_long():
    lines = {str(f.relative_to(ROOT)): f.read_text().count("\n") for f in FILES}
    assert {name: count for name, count in lines.items() if count > LINES} == {}


def test_no_function_has_many_parameters():
    assert [f"{f.name}: {name}" for f in FILES for name in crowded(f.read_text())] == []


def test_arguments_are_hidden_nowhere():
    found = {
        (f.relative_to(ROOT / "gaussray").as_posix(), name)
        for f in FILES
        for name in any_keyword(f.read_text())
    }
    assert found == ANY_KEYWORD


def test_crowded_functions_and_hidden_arguments_are_found():
    assert crowded("def f(a, b, c, d, /, e, f, *g, h, i): pass") == ["f"]
    assert crowded("class A:\n    def f(self, a, b, c, d, e, f, g, h): pass") == []
    assert any_keyword("def f(a, **how): g(a, **how)") == {"f"}
    assert unexplained('def f(a, b):\n    "Does."') == ["f"]
    assert unexplained('class A:\n    def f(self, a, *, b):\n        "Does."') == ["f"]
    assert unexplained('def f(a, b):\n    """Does.\n\n    Args:\n        a: one.\n    """') == []
    assert unexplained('def f(a):\n    "Does."\n\n\ndef _g(a, b):\n    "Does."') == []
