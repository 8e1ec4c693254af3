"""Hooks of MkDocs for the docs site: equations, and pages for the sources that pages link to.

The pages can also be read in the repository. There an equation is a fence ```math, and a link to a
file outside of docs/ is relative. On the site an equation is MathML, which browsers show without a
script, and each such file has a page.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from pymdownx.superfences import SuperFencesException

ROOT = Path(__file__).parents[1]
_OUTSIDE = re.compile(r"\]\(((?:\.\./)+[^)#\s]+)")
_LANGUAGES = {".py": "python", ".toml": "toml", ".yaml": "yaml", ".yml": "yaml", ".md": "markdown"}


def on_config(config: MkDocsConfig) -> None:
    """Register `mathml` as the formatter of fences named math."""
    fences = config.mdx_configs.setdefault("pymdownx.superfences", {})
    fences["custom_fences"] = [{"name": "math", "class": "math", "format": mathml}]


def mathml(source: str, *arguments: Any, **options: Any) -> str:
    """Convert an equation in LaTeX to MathML; an exception for LaTeX that stays unconverted."""
    markup: str = convert(source, display="block")
    if "\\" in markup or re.search("&(?!#)", markup):
        raise SuperFencesException(
            f"expected LaTeX that MathML can show, got an equation with other parts: {source}; "
            "try without environments such as \\begin{aligned}"
        )
    # Browsers take the alignment of a column from its style only.
    return re.sub(r'columnalign="(\w+)"', r'style="text-align: \1"', markup)


def on_files(files: Files, *, config: MkDocsConfig) -> None:
    """Add a page for every file outside of docs/ that a page links to."""
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


def _linked(page: str, link: str) -> str | None:
    """The path in the repository of a link on a page; None if it is missing or within docs/."""
    path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link))
    outside = not path.startswith(("docs/", "../"))
    return path if outside and (ROOT / path).exists() else None


def _page_of(path: str) -> str:
    return f"source/{path}.md"


def _source_page(path: str) -> str:
    file = ROOT / path
    if file.is_dir():
        text = "\n".join(sorted(each.name for each in file.iterdir() if each.name[0] not in "._"))
    else:
        text = file.read_text(encoding="utf-8")
    language = _LANGUAGES.get(file.suffix, "text")
    head = "search: {exclude: true}\nhide: [navigation, toc]"
    return f"---\n{head}\n---\n# {path}\n\n``````{language}\n{text}\n``````\n"
