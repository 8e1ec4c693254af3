"""Hooks of MkDocs for the docs site: equations, and pages that are not in docs/.

The pages can also be read in the repository. There an equation is a fence ```math, a formula in the
text is LaTeX between dollars, a subscript in a docstring is `J_c`, and a link to a file outside of
docs/ is relative. On the site equations and formulas are MathML, which browsers show without a
script, a subscript is lowered, and each such file has a page. The site also has the pages of
`docs.reference_pages` and the notebook.
"""

from __future__ import annotations

import base64
import json
import posixpath
import re
from html import unescape
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.superfences import SuperFencesException

from docs.reference_pages import pages

ROOT = Path(__file__).parents[1]
# Files outside of docs/ with a page that is not their source.
_PAGES = {
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "examples/two_runs.ipynb": "notebook.md",
}
# J_c, ω_f, s̈_ref, C_𝒜: a letter with its marks, and a short subscript.
_SUBSCRIPT = re.compile(
    r"((?<![\w/.])[^\W\d_][\u0300-\u036f]*|\))_([A-Za-z0-9𝒜ρ]{1,4}(?:,[a-z])?)(?![A-Za-z0-9_])"
)
# A formula between dollars, in the markup of pymdownx.arithmatex.
_FORMULA = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', re.DOTALL)
_TAG = re.compile(r"(<[^>]*>)")
_VERBATIM = re.compile(r"<(/?)(?:code|pre|math|script|style|h\d)\b")
_OUTSIDE = re.compile(r"\]\(((?:\.\./)+[^)#\s]+)")
_LANGUAGES = {".py": "python", ".toml": "toml", ".yaml": "yaml", ".yml": "yaml", ".md": "markdown"}


def on_config(config: MkDocsConfig) -> None:
    """Register `mathml` as the formatter of fences named math."""
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "math", "format": mathml}]


def mathml(source: str, *arguments: Any, display: str = "block", **options: Any) -> str:
    """Convert an equation in LaTeX to MathML; an exception for LaTeX that stays unconverted."""
    markup: str = convert(source, display=display)
    if "\\" in markup or re.search("&(?!#)|mathvariant", markup):
        raise SuperFencesException(
            f"expected LaTeX that MathML can show, got an equation with other parts: {source}; "
            "try without environments such as \\begin{aligned}"
        )
    # A norm has no mate to stretch with if it has an exponent.
    markup = markup.replace("<mo>&#x02016;", '<mo stretchy="false">&#x02016;')
    # Browsers take the alignment of a column from its style only.
    return re.sub(r'columnalign="(\w+)"', r'style="text-align: \1"', markup)


def on_files(files: Files, *, config: MkDocsConfig) -> None:
    """Add the pages that are made, and one for every file outside of docs/ that a page links to."""
    texts = {page: _text_of(ROOT / path) for path, page in _PAGES.items()}
    for page, text in {**pages(), **texts}.items():
        files.append(File.generated(config, page, content=text))
    for page in list(files.documentation_pages()):
        for link in _OUTSIDE.findall(page.content_string):
            path = _linked(page.src_uri, link)
            if path is not None and files.get_file_from_path(_page_of(path)) is None:
                files.append(File.generated(config, _page_of(path), content=_source_page(path)))


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace links out of docs/ by links to the pages of `on_files`."""

    def led(found: re.Match[str]) -> str:
        path = _linked(page.file.src_uri, found[1])
        if path is None:
            return found[0]
        folder = posixpath.dirname(page.file.src_uri)
        return f"]({posixpath.relpath(_page_of(path), folder or '.')}"

    return _OUTSIDE.sub(led, markdown)


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Convert the formulas in the text to MathML, and lower the subscripts of other letters."""
    return with_subscripts(with_formulas(html))


def with_formulas(html: str) -> str:
    """Convert the formulas that stood between dollars to MathML within the line."""
    return _FORMULA.sub(lambda found: mathml(unescape(found[1]), display="inline"), html)


def with_subscripts(html: str) -> str:
    """Lower the subscripts of letters in the running text: `J_c` becomes J with a lowered c."""
    parts, verbatim = [], 0
    for part in _TAG.split(html):
        if tag := _VERBATIM.match(part):
            verbatim += -1 if tag[1] else 1
        is_text = not verbatim and not part.startswith("<")
        parts.append(_SUBSCRIPT.sub(r"\1<sub>\2</sub>", part) if is_text else part)
    return "".join(parts)


def notebook_page(path: Path) -> str:
    """Return the Markdown of a notebook with its outputs: text, and pictures within the page."""
    lines = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        lines.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                picture = base64.b64encode(base64.b64decode(data["image/png"])).decode()
                lines.append(f"![output of the cell](data:image/png;base64,{picture})")
            elif text := "".join(output.get("text", data.get("text/plain", []))):
                lines.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(lines) + "\n"


def _text_of(path: Path) -> str:
    """Return the text of a page outside of docs/, with the links of a page in docs/."""
    if path.suffix == ".ipynb":
        return notebook_page(path)
    text = path.read_text(encoding="utf-8")
    return re.sub(r"\]\((?!\w+:|#)(?:docs/)?([^)]+)\)", _moved_link, text)


def _moved_link(found: re.Match[str]) -> str:
    return f"]({found[1]})" if found[0].startswith("](docs/") else f"](../{found[1]})"


def _linked(page: str, link: str) -> str | None:
    """The path in the repository of a link on a page; None if it is missing or within docs/."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link))
    outside = not path.startswith(("docs/", "../"))
    return path if outside and (ROOT / path).exists() else None


def _page_of(path: str) -> str:
    return _PAGES.get(path, f"source/{path}.md")


def _source_page(path: str) -> str:
    file = ROOT / path
    if file.is_dir():
        text = "\n".join(sorted(each.name for each in file.iterdir() if each.name[0] not in "._"))
    else:
        text = file.read_text(encoding="utf-8")
    language = _LANGUAGES.get(file.suffix, "text")
    head = "search: {exclude: true}\nhide: [navigation, toc]"
    return f"---\n{head}\n---\n# {path}\n\n``````{language}\n{text}\n``````\n"
