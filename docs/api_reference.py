"""Writes docs/reference.md: signatures and docstrings of the library, from its source.

`python docs/api_reference.py`; a test fails while the page is not what this would write.
"""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path


ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference.md"
# Chapters: modules below gaussray, each with the names that are shown (none: all public ones).
CHAPTERS: dict[str, dict[str, tuple[str, ...]]] = {
    "The two stages": {
        "reconstruct.pipeline": ("reconstruct",),
        "reconstruct.options": ("ReconstructOptions", "FitOptions"),
        "render.renderer": ("Renderer",),
        "render.frame": ("Frame",),
        "render.options": ("RenderOptions", "DatasetOptions"),
        "render.dataset": ("render_dataset",),
    },
    "The scene": {
        "scene.scene": ("Scene", "at"),
        "scene.gaussians": ("Gaussians",),
        "scene.deformation": ("Deformation",),
        "scene.planes": ("Planes",),
        "scene.store": ("load_scene", "save_scene"),
    },
    "The camera": {
        "camera.camera": (),
        "camera.film": ("Film",),
        "camera.lens.abstract": (),
        "camera.lens.perspective": (),
        "camera.lens.radial": (),
        "camera.lens.fisheye": (),
        "camera.lens.kannala_brandt": (),
        "camera.lens.division": (),
        "camera.lens.blender_polynomial": (),
        "camera.lens.sphere": (),
        "camera.lens.equirectangular": (),
        "camera.aperture": (),
        "camera.focus_pull": ("FocusPull",),
        "camera.shutter": (),
        "camera.trajectory": (),
        "camera.sensor.sensor": (),
        "camera.rays": (),
        "camera.lens.model": ("LensOptions",),
        "render.rig.lens": ("mounted",),
    },
    "The tracer": {
        "tracer.options": ("TraceOptions",),
        "tracer.trace": ("Report", "trace", "measure"),
        "tracer.response": (),
        "tracer.composite": (),
    },
    "Captures and scores": {
        "capture.capture": ("Capture", "View"),
        "capture.formats.paired": ("read_capture",),
        "evaluate.pipeline": ("EvaluateOptions", "evaluate"),
        "evaluate.metrics": (),
    },
    "PyTorch": {
        "torch.saved": ("SavedFrames",),
        "torch.rendered": ("RenderedFrames",),
        "torch.tensors": ("picture_tensors",),
    },
}


def page() -> str:
    """The text of the page."""
    parts = [
        "# Reference\n\nSignatures and docstrings, written from the source by "
        "`python docs/api_reference.py`. [The Python library](api.md) is the introduction.\n"
    ]
    for title, modules in CHAPTERS.items():
        parts.append(f"## {title}\n")
        for module, names in modules.items():
            parts += _module(module, names)
    return "\n".join(parts)


def _module(module: str, names: tuple[str, ...]) -> Iterator[str]:
    path = ROOT / "gaussray" / (module.replace(".", "/") + ".py")
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and _shown(node, names):
            yield f"### {node.name}\n\n`gaussray.{module}`\n"
            yield _code(_class(node) if isinstance(node, ast.ClassDef) else _function(node))
            yield _text(node)


def _shown(node: ast.ClassDef | ast.FunctionDef, names: tuple[str, ...]) -> bool:
    if names:
        return node.name in names
    return not node.name.startswith("_") and ast.get_docstring(node) is not None


def _class(node: ast.ClassDef) -> str:
    """The class with its fields and the signatures of its public methods."""
    lines = [f"class {node.name}({', '.join(map(ast.unparse, node.bases))}):".replace("()", "")]
    for part in node.body:
        if isinstance(part, ast.AnnAssign) and not ast.unparse(part.target).startswith("_"):
            lines.append(f"    {_field(part)}")
        elif isinstance(part, ast.FunctionDef):
            if part.name in ("__init__", "__call__") or not part.name.startswith("_"):
                lines.append(textwrap.indent(_function(part), "    "))
    return "\n".join(lines)


def _field(part: ast.AnnAssign) -> str:
    """`name: type = default` of a field; `eqx.field(...)` is its default."""
    text, value = f"{ast.unparse(part.target)}: {ast.unparse(part.annotation)}", part.value
    if isinstance(value, ast.Call) and ast.unparse(value.func).endswith("field"):
        known = {word.arg: word.value for word in value.keywords}
        value = known.get("default", known.get("default_factory"))
    return text if value is None else f"{text} = {ast.unparse(value)}"


def _function(node: ast.FunctionDef) -> str:
    """`def name(arguments) -> result`, an argument a line where one line is too short."""
    result = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    short = f"def {node.name}({ast.unparse(node.args)}){result}"
    if len(short) <= 88:
        return short
    arguments = [*map(str, _arguments(node.args))]
    return "\n".join([f"def {node.name}(", *(f"    {word}," for word in arguments), f"){result}"])


def _arguments(args: ast.arguments) -> Iterator[str]:
    """Every argument with its annotation and default, `*` before those by name alone."""
    plain = [*args.posonlyargs, *args.args]
    defaults = [None] * (len(plain) - len(args.defaults)) + list(args.defaults)
    named = list(zip(args.kwonlyargs, args.kw_defaults, strict=True))
    for argument, default in zip(plain, defaults, strict=True):
        yield ast.unparse(argument) + (f" = {ast.unparse(default)}" if default else "")
    if args.vararg or named:
        yield f"*{ast.unparse(args.vararg)}" if args.vararg else "*"
    for argument, default in named:
        yield ast.unparse(argument) + (f" = {ast.unparse(default)}" if default else "")


def _code(text: str) -> str:
    return f"```text\n{text}\n```\n"


def _text(node: ast.ClassDef | ast.FunctionDef) -> str:
    """The docstring as Markdown: `Args:` and the like are lists."""
    lines, heading = [], False
    for line in inspect.cleandoc(ast.get_docstring(node) or "").split("\n"):
        title = re.fullmatch(r"(Args|Returns|Raises|Attributes|Yields):", line)
        if title:
            lines += [f"**{title[1]}**", ""]
        elif heading and re.match(r"    \S", line):
            name, colon, rest = line.strip().partition(": ")
            named = bool(colon) and bool(re.fullmatch(r"\*{0,2}[\w., ]+", name))
            item = f"`{name}`: {rest}" if named else line.strip()
            lines.append(f"* {item}" if named or not lines[-1] else f"  {item}")
        elif heading and line.startswith("        "):
            lines.append(f"  {line.strip()}")
        else:
            lines.append(line)
        heading = bool(title) or (heading and (line.startswith("    ") or not line))
    text = "\n".join(lines)
    # Angle brackets and the like are no HTML.
    return text.replace("<", "&lt;") + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
