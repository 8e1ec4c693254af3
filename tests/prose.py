"""Checks the words that people read against the rules of CONTRIBUTING.md: `./deploy/lint prose`.

Reads the Markdown pages and, from the Python sources, the docstrings, the comments, the help texts
and the texts of errors. Prints one line for each place that breaks a rule: file, line, rule, and
the words.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

ROOT = Path(__file__).resolve().parents[1]
MAX_WORDS = 32
# Words that begin a clause, where a docstring needs a verb or a noun.
CLAUSES = {"What", "Where", "When", "Whether", "Why", "How", "Of", "Those", "That", "Until", "If"}
CLAUSES |= {"Who", "Whoever", "Whom", "Whose", "Which"}
PHRASES = {
    r"\b(?:who|what|which|where|when|how)ever\b": "name the person or the thing",
    r"\bwhat (?:is|are|was|were|has|have)\b": "name the thing",
    r"\bso (?:many|much)\b": "give the number, or leave it out",
    r"\bof (?:ours|theirs|its own|their own|one's own)\b": "say whose: the project's, the user's",
    r"\bnobody(?:'s)?\b": "say what there is not: no process, no user",
    r"\bthose that\b": "name the things",
    r"\bfoot in the air\b": "the glossary says swing foot",
    r"\bcapture point\b": "the glossary says DCM",
    r"(?:\b(?:an?|the|its|their|each)|'s) (?:stall|begin)\b": "outage; beginning or start",
    r"\b(?:color|behavior|center|neighbor|meter)s?\b": "British: colour, behaviour, centre …",
    r"\b\w+(?:ptimiz|actoriz|ormaliz|inimiz|aximiz|ynchroniz|ecogniz)\w*\b": "British: -ise",
}
# The value that came, or a computed text that may have it.
_GOT = re.compile(r"\b(?:got|found)\b|…[;:)]?$|, …;")
# Words that begin a comment in which a clause stands for the thing.
LOOSE = {"What", "Whatever", "How", "Of", "Which"}
# Prose of other people, and results that commands write.
SKIPPED = ("docs/results", "docs/benchmarks", "docs/figures", "LICENSE")


@dataclass(frozen=True)
class Text:
    """Words at a place. Docstrings and comments, by `kind`, have to begin with a verb or a noun."""

    file: str
    line: int
    words: str
    kind: Literal["docstring", "comment", "error", "other"] = "other"


@dataclass(frozen=True)
class Finding:
    """A broken rule: the advice, and the words."""

    text: Text
    advice: str
    words: str

    def __str__(self) -> str:
        return f"{self.text.file}:{self.text.line}: {self.advice}: {self.words!r}"


def findings(text: Text) -> Iterator[Finding]:
    """The findings in a text, one for each rule that it breaks."""
    words = _without_code(text.words)
    wrong = {"docstring": CLAUSES, "comment": LOOSE}.get(text.kind, set())
    if (first := words.split()[:1]) and first[0].strip(",:;.") in wrong:
        yield Finding(text, "begin with a verb or a noun", _short(words))
    for pattern, advice in PHRASES.items():
        for found in re.finditer(pattern, words, re.IGNORECASE):
            yield Finding(text, advice, _short(words[max(0, found.start() - 30) :]))
    if text.kind == "error" and "expected" in words and not _GOT.search(words):
        yield Finding(text, "say what came: got …", _short(words))
    for sentence in _sentences(words):
        count = len(sentence.split())
        if count > MAX_WORDS:
            yield Finding(text, f"{count} words: make two sentences", _short(sentence))


def texts(files: list[str]) -> Iterator[Text]:
    """The words in some files of the project."""
    for name in files:
        source = (ROOT / name).read_text(encoding="utf-8")
        if name.endswith(".md"):
            yield from _of_page(name, source)
        elif name.endswith(".py"):
            yield from _of_module(name, ast.parse(source))
            yield from _of_comments(name, source)


def tracked() -> list[str]:
    """The project's pages and product modules."""
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "*.md", "*.py"],
        capture_output=True,
        text=True,
        check=True,
    )
    return [
        name
        for name in listed.stdout.splitlines()
        if not name.startswith((*SKIPPED, "tests/")) and (ROOT / name).is_file()
    ]


def _of_page(name: str, source: str) -> Iterator[Text]:
    """Paragraphs, items and cells: no code, no formulas, no headings."""
    in_code = False
    paragraph: list[str] = []
    begun = 1
    for number, line in enumerate([*source.splitlines(), ""], start=1):
        if line.lstrip().startswith("```"):
            in_code = not in_code
        plain = line.strip()
        ends = in_code or not plain or plain[0] in "#|`<!" or line.startswith("    ")
        item = re.match(r"[*+-] |\d+\. |> ", plain)
        if (ends or item) and paragraph:
            yield Text(name, begun, " ".join(paragraph))
            paragraph = []
        if plain.startswith("|") and not in_code:
            cells = plain.strip("|").split("|")
            # The last column of the glossary has the words that are not used.
            for cell in cells[:2] if name == "docs/glossary.md" else cells:
                yield Text(name, number, cell.strip())
        if ends:
            continue
        if not paragraph:
            begun = number
        paragraph.append(plain)


def _of_module(name: str, tree: ast.Module) -> Iterator[Text]:
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            if (docstring := ast.get_docstring(node)) is not None:
                yield Text(name, node.body[0].lineno, docstring, "docstring")
        elif isinstance(node, ast.keyword) and node.arg in ("help", "description"):
            yield Text(name, node.value.lineno, _literal(node.value))
        elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for argument in node.exc.args:
                yield Text(name, argument.lineno, _literal(argument), "error")


def _of_comments(name: str, source: str) -> Iterator[Text]:
    """The comments, those of successive lines as one."""
    found: list[tuple[int, int, int, str]] = []  # first line, last line, column, words
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            (line, column), words = token.start, token.string.lstrip("#: ")
            if found and found[-1][1:3] == (line - 1, column):
                first, _, _, before = found.pop()
                found.append((first, line, column, f"{before} {words}"))
            else:
                found.append((line, line, column, words))
    for first, _, _, words in found:
        if not words.startswith(("noqa", "type:")):
            yield Text(name, first, words, "comment")


def _literal(node: ast.AST) -> str:
    """The constant words of a string, with `…` for each computed part."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else "…"
    if isinstance(node, ast.JoinedStr):
        return "".join(_literal(part) for part in node.values)
    if isinstance(node, ast.BinOp):
        return _literal(node.left) + _literal(node.right)
    return "…"


def _without_code(words: str) -> str:
    """The words with code, formulas and addresses as one word each."""
    words = re.sub(r"\$[^$]*\$|`[^`]*`", "CODE", words)
    words = re.sub(r"\]\([^)]*\)", "]", words)
    return re.sub(r"\S*://\S*", "ADDRESS", words)


def _sentences(words: str) -> list[str]:
    return re.split(r"(?<=[.;:!?])\s+|\n\s*\n|\n\s*[*-] ", words)


def _short(words: str) -> str:
    return " ".join(words.split())[:70]


def main() -> int:
    """Print the findings. Return 1 if there are any. Arguments: files, else the whole project."""
    found = [each for text in texts(sys.argv[1:] or tracked()) for each in findings(text)]
    print(*found, sep="\n" if found else "", end="\n" if found else "")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
