"""Commands and settings that the pages show are those that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from experiments.settings_page import PAGE, with_tables
from remote_wbc import commands
from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.process.cli import Group, Parser, command_parser
from shared.process.run_options import config_from
from tests.robots.biped import write_biped

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
SHOWN = r"\./(?:wbc|deploy)/?((?: ?(?:netem|viewer|bench|plant|robot))? ?[a-z][a-z-]*)"
# Of deploy/, what is no command of wbc.
SCRIPTS = {"docs", "lint", "python", "setup", "test", "compose"}


@pytest.fixture(scope="module")
def parser() -> Parser:
    """The parser of everything that wbc can do."""
    return command_parser(None, commands())


def shown_in_full():
    """Command lines of `sh` blocks, as arguments of wbc."""
    for page in PAGES:
        for block in re.findall(r"^ *```sh\n(.*?)^ *```", page.read_text(), re.DOTALL | re.M):
            for line in block.replace("\\\n", " ").splitlines():
                found = re.search(rf"(?<!\S){SHOWN}(?![\w/.])", line)
                if found and found[1].strip() not in SCRIPTS:
                    rest = shlex.split(line[found.end() :], comments=True)
                    typed = [*found[1].split(), *rest]
                    yield pytest.param(typed, id=f"{page.stem}: {found[1].strip()}")


@pytest.mark.parametrize("typed", shown_in_full())
def test_a_command_line_is_understood(parser, typed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_biped(tmp_path, name="mine")
    parsed = parser.parse_args(typed)
    if typed[0] in ("up", "trial") and parsed.config is None:
        config_from(parsed)


def test_a_command_that_is_mentioned_exists():
    names = {
        f"{prefix}{command.name}"
        for prefix, of_prefix in [("", commands()), *groups()]
        for command in of_prefix
    }
    unknown = [
        f"{page.name}: {found[0]}"
        for page in PAGES
        for found in re.finditer(rf"`{SHOWN}(?![\w/.])", page.read_text())
        if found[1].strip() not in names | SCRIPTS
    ]
    assert unknown == []


def groups():
    return [(f"{each.name} ", each.commands) for each in commands() if isinstance(each, Group)]


def test_the_page_of_settings_shows_those_that_there_are():
    page = (ROOT / "docs" / PAGE).read_text()
    up_to_date = page == with_tables(page)
    assert up_to_date, f"docs/{PAGE} is out of date: `./wbc settings` writes it anew"


def test_a_file_of_settings_that_a_page_shows_is_one(tmp_path):
    shown = tmp_path / "shown.toml"
    (block,) = re.findall(r"^```toml\n(.*?)^```", (ROOT / "docs" / PAGE).read_text(), re.S | re.M)
    shown.write_text(block)
    assert load_config(shown) != RunConfig()


def test_a_page_without_a_place_for_the_tables_is_refused():
    with pytest.raises(ConfigError, match="tables: begin"):
        with_tables("# Settings\n")
