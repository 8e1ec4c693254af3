"""Write the tables of all settings into `docs/configuration.md`: `./wbc settings`."""

from __future__ import annotations

import argparse
import inspect
import json
from pathlib import Path

from shared.config.setting import Section, Setting
from shared.config.settings import SECTIONS
from shared.errors import ConfigError, writing
from shared.extensions import Names
from shared.process.cli import EXIT_STANDING

PAGE = "configuration.md"
BEGIN, END = "<!-- tables: begin -->", "<!-- tables: end -->"


def add_settings_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `settings`."""
    parser.add_argument(
        "--docs", type=Path, default=Path("docs"), metavar="DIR", help="folder of the page"
    )


def run_settings(arguments: argparse.Namespace) -> int:
    """Write the tables into the page. Return 0."""
    page = arguments.docs / PAGE
    with writing(page, what="docs"):
        page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")
    print(page)
    return EXIT_STANDING


def with_tables(page: str) -> str:
    """The page with its tables replaced; `ConfigError` for a page without the two markers."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ConfigError(f"docs: expected {BEGIN} and {END} in {PAGE}, got none; add them")
    tables = "\n\n".join(_in_markdown(section) for section in SECTIONS)
    return f"{before}{BEGIN}\n\n{tables}\n\n{END}{after}"


def _in_markdown(section: Section) -> str:
    """A heading, the docstring of the section, and a line for each of its settings."""
    heading = f"`[{section.name}]`" if section.name else "On top"
    lines = [_line(key, each) for key, each in section.settings.items()]
    rows = [("setting, flag", "default", "allowed", ""), ("---",) * 4, *lines]
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"### {heading}\n\n{inspect.getdoc(section.cls)}\n\n{table}"


def _line(key: str, setting: Setting) -> tuple[str, ...]:
    name = ", ".join(f"`{each}`" for each in (key.rpartition(".")[2], *setting.flags))
    default = f"`{json.dumps(setting.default)}` {setting.unit}".rstrip()
    words = [f"`{word}`" for word in setting.words]
    if isinstance(setting.choices, Names):
        words.append(f"[your own]({setting.choices.page.removeprefix('docs/')})")
    bounds = [f"{sign} {bound:g}" for sign, bound in setting.bounds]
    infinite = ["`inf`"] if setting.may_be_infinite else []
    return name, default, ", ".join([*words, *bounds, *infinite]), setting.help
