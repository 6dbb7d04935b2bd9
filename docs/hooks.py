"""What the site is made of beside the pages: formulas, the experiments, tables of keys."""

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.preprocessors import Preprocessor
from mkdocs.structure.files import File

from gaussray.config.schema import choices, groups, keys
from gaussray.io.sample_data import sample


ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```math\n(.*?)\n```$", re.M | re.S)
INLINE = re.compile(r"\$`(.+?)`\$")
# Pages and pictures of the repository that live beside what they are about.
BESIDE = ("experiments/*/*.md", "experiments/*/*/*.md", "experiments/*/*.png", "benchmarks/**/*.md",
          "benchmarks/figures/*.png", "gaussray/dataset/sample_manifest.md")  # fmt: skip
# Files that pages link to and a site does not show: their names stay, without a link.
SHOWN = {".md", ".png", ".js", ".css"}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)#\s]+)(#[^)]*)?\)")
VERBS = ("render", "reconstruct")


class Formulas(Preprocessor):
    """TeX as MathML: ```math is a line of its own, $`x`$ stands in the text, as on GitHub."""

    def run(self, lines):
        text = BLOCK.sub(lambda m: self._stored(m[1], "block"), "\n".join(lines))
        return INLINE.sub(lambda m: self._stored(m[1], "inline"), text).split("\n")

    def _stored(self, tex, display):
        return self.md.htmlStash.store(convert(tex, display=display))


class MathExtension(Extension):
    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        # Before blocks of code (25), after line ends are all alike (30).
        md.preprocessors.register(Formulas(md), "formulas", 27)


def on_config(config):
    config.markdown_extensions.append(MathExtension())
    return config


def on_files(files, config):
    """The experiments' pages and pictures become the site's; keys, changes and tour are made."""
    for pattern in BESIDE:
        for path in sorted(ROOT.glob(pattern)):
            name = path.relative_to(ROOT).as_posix()
            files.append(File.generated(config, name, abs_src_path=str(path)))
    files.append(
        File.generated(config, "changelog.md", content=(ROOT / "CHANGELOG.md").read_text())
    )
    files.append(File.generated(config, "keys.md", content=key_tables()))
    files.append(File.generated(config, "tour.md", content=tour()))
    return files


def on_page_markdown(markdown, page, config, files):
    """Links as the repository has them become those of the site, where all lies in one folder."""
    inside = page.file.src_uri.rpartition("/")[0]

    def place(match):
        picture, text, target, anchor = match.groups()
        if re.match(r"[a-z]+:", target):
            return match[0]
        if not inside:
            target = target.removeprefix("../")
        # The site has the pages of docs/ at its top.
        target = re.sub(r"^((?:\.\./)*)docs/", r"\1", target)
        if Path(target).suffix not in SHOWN:
            return text
        return f"{picture}[{text}]({target}{anchor or ''})"

    return LINK.sub(place, markdown)


def key_tables() -> str:
    """Every key of the two stages, as the configuration's own files have them."""
    lines = ["# All keys", "", "Made from the files in `conf/`, by group; the default comes first. "
             "`gaussray VERB --help=all` prints the same.", ""]  # fmt: skip
    told = set()
    for verb in VERBS:
        lines += [f"## gaussray {verb}", ""]
        for group in ("", *groups(verb)):
            if group in told:
                continue
            told |= {group} if group else set()
            some = [(n, k) for n, k in keys(verb).items() if n.rpartition(".")[0] == group]
            lines += _table(verb, group, some) if some else []
    return "\n".join(lines)


def _table(verb, group, some):
    head = [f"### {group}", ""] if group else []
    if group and len(choices(group)) > 1:
        first = groups(verb)[group]
        rest = ", ".join(f"`{x}`" for x in choices(group) if x != first)
        head += [f"Choices: `{group}={first}`, {rest}.", ""]
    rows = [f"| `{name}` | `{_safe(key.default) or ' '}` | {_safe(html.escape(key.meaning))} |"
            for name, key in some]  # fmt: skip
    return [*head, "| key | default | |", "|---|---|---|", *rows, ""]


def _safe(text):
    return text.replace("|", "\\|")


def tour() -> str:
    """The notebook as a page: text as text, cells as code."""
    path = ROOT / "experiments" / "tour.py"
    assert sample("scene").is_dir() and path.is_file()
    cells = re.split(r"^# %%(.*)\n", path.read_text(), flags=re.M)[1:]
    parts = []
    for kind, body in zip(cells[::2], cells[1::2], strict=True):
        text = body.strip("\n")
        if "markdown" in kind:
            parts.append(
                "\n".join(line.removeprefix("#").removeprefix(" ") for line in text.split("\n"))
            )
        else:
            parts.append(f"```python\n{text}\n```")
    return "\n\n".join(parts)
