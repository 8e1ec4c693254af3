"""Identity of the code that plays a trial: a hash of syntax trees, and of the robots' files.

Comments, docstrings, arguments named `help` and layout do not change the identity. A constant or a
name does. Trials from before 2026-12 have hashes of the files' bytes in their `about.json` and
journals. `published_codes.toml` maps these hashes of published trials to identities. A test derives
both from the commit that the file names.
"""

from __future__ import annotations

import ast
import functools
import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from shared.robots import CATALOGUE, description_of
from shared.toml_file import read_toml

ROOT = Path(__file__).parents[2]
# The code that plays a trial. Studies and pictures can change without making trials void.
PARTS = ("shared", "robot_node", "edge_node", "netem", "experiments/lockstep.py")


@functools.cache
def code_version() -> str:
    """Identity of the sources that play a trial, read once in this process."""
    parts = [ROOT / name for name in PARTS]
    files: Iterable[Path] = (
        path for part in parts for path in ([part] if part.is_file() else part.rglob("*.py"))
    )
    sources = {path.relative_to(ROOT).as_posix(): path.read_bytes() for path in files}
    # The content of a robot file, without its comments.
    robots = {f"robots/{name}": description_of(name).stated.encode() for name in CATALOGUE}
    return identity(sources | robots)


def identity(sources: Mapping[str, bytes]) -> str:
    """Identity of Python sources by their path below the project's folder, and of other texts."""
    digest = hashlib.sha256()
    for name in sorted(sources, key=lambda path: path.split("/")):
        is_code = name.endswith(".py")
        content: Any = _content(ast.parse(sources[name])) if is_code else sources[name]
        digest.update(f"{name}\0{content}\0".encode())
    return digest.hexdigest()[:16]


def present_identity(code: str) -> str:
    """The identity for a code in a journal or an `about.json`, also for a hash of bytes."""
    return _published().get(code, code)


@functools.cache
def _published() -> dict[str, str]:
    table = read_toml(Path(__file__).with_name("published_codes.toml"), what="published codes")
    return {each["of_bytes"]: each["identity"] for each in table["code"]}


def _content(node: Any) -> Any:
    """A syntax tree without prose, positions and empty fields, the same for every Python."""
    if isinstance(node, list):
        return [_content(each) for each in node if not _is_help(each)]
    if not isinstance(node, ast.AST):
        return node
    fields = []
    for name, value in ast.iter_fields(node):
        if (
            name == "body"
            and isinstance(node, _DOCUMENTED)
            and ast.get_docstring(node, clean=False)
        ):
            value = value[1:]
        if value not in (None, []):
            fields.append((name, _content(value)))
    return (type(node).__name__, *fields)


def _is_help(node: Any) -> bool:
    """Return whether a node is the argument `help` of a call."""
    return isinstance(node, ast.keyword) and node.arg == "help"


_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
