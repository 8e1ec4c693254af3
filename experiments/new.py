"""Make a package to begin from, with a controller, task, robot or plant, and its test."""

from __future__ import annotations

import argparse
import re
import shutil
from pathlib import Path

from shared.errors import ConfigError, writing
from shared.process.cli import EXIT_STANDING

_TEMPLATES = Path(__file__).with_name("templates")
# The templates of each kind, of which a later one replaces files of an earlier one: a plant is that
# of a robot.
KINDS = {
    "controller": ("controller",),
    "task": ("task",),
    "robot": ("robot",),
    "plant": ("robot", "plant"),
}
# The placeholders of the name in the files of a template and in their names: in lower case, and as
# a class name.
_NAME, _CLASS = "NAME", "CLASS"
_ALLOWED = re.compile(r"[a-z][a-z0-9_]*")


def add_new_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `new`."""
    parser.add_argument("kind", choices=list(KINDS), help="the content of the package")
    parser.add_argument("name", help="name of package and folder, as in my_controller")


def run_new(arguments: argparse.Namespace) -> int:
    """Make the folder NAME in the current one, and print the next steps. Return 0."""
    make(arguments.kind, arguments.name, Path(arguments.name))
    print(
        f"{arguments.name}: made. Install it into this environment with pip install -e "
        f"{arguments.name}, then run pytest {arguments.name} and read its README.md"
    )
    return EXIT_STANDING


def make(kind: str, name: str, folder: Path) -> None:
    """Make a folder from the template of a kind.

    Raise `ConfigError` for a name that no package can have, and if the folder exists.
    """
    if not _ALLOWED.fullmatch(name):
        raise ConfigError(
            f"new: expected a name of a-z, 0-9 and _ that begins with a letter, got {name!r}"
        )
    if folder.exists():
        raise ConfigError(
            f"new: expected a name without a folder, got {folder}, which exists; try another"
        )
    names = {_NAME: name, _CLASS: "".join(part.capitalize() for part in name.split("_"))}
    with writing(folder, what="new"):
        for name_in_folder, source in _files(kind).items():
            made = folder / _filled(name_in_folder, names)
            made.parent.mkdir(parents=True, exist_ok=True)
            # The Python files of a template are no code of this project.
            made = made.with_name(made.name.removesuffix(".txt"))
            made.write_text(_filled(source.read_text(encoding="utf-8"), names), encoding="utf-8")
            shutil.copymode(source, made)


def _files(kind: str) -> dict[str, Path]:
    """The files of a kind's templates, by their path in the folder."""
    return {
        path.relative_to(_TEMPLATES / template).as_posix(): path
        for template in KINDS[kind]
        for path in sorted((_TEMPLATES / template).rglob("*"))
        if path.is_file()
    }


def _filled(text: str, names: dict[str, str]) -> str:
    for placeholder, name in names.items():
        text = text.replace(placeholder, name)
    return text
