"""Commands and settings that the pages show are those that there are."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import benchmarks.__main__
import deploy.background.control
import deploy.up
import experiments.__main__
import netem.__main__
import viewer.__main__
from experiments.settings_page import PAGE, with_tables
from shared.config.config_file import load_config
from shared.config.settings import RunConfig
from shared.errors import ConfigError
from shared.process.cli import Parser, config_from

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/**/*.md"))]
PROGRAMS = {
    "experiments": experiments.__main__._COMMANDS,
    "netem": netem.__main__._COMMANDS,
    "benchmarks": benchmarks.__main__._COMMANDS,
    "viewer": viewer.__main__._COMMANDS,
    "deploy": deploy.background.control._COMMANDS,
}
MODULE = r"python -m (experiments|netem|benchmarks|viewer) ([a-z-]+)"
SHOWN = rf"{MODULE}|\./(deploy)/(up|ps|logs|restart|down)\b"


def shown_in_full():
    """Command lines of `sh` blocks: the program, the command and its arguments."""
    for page in PAGES:
        for block in re.findall(r"^ *```sh\n(.*?)^ *```", page.read_text(), re.DOTALL | re.M):
            for line in block.replace("\\\n", " ").splitlines():
                if found := re.search(SHOWN, line):
                    program, name = (each for each in found.groups() if each is not None)
                    rest = shlex.split(line[found.end() :], comments=True)
                    yield pytest.param(program, name, rest, id=f"{page.stem}: {name}")


@pytest.mark.parametrize(("program", "name", "arguments"), shown_in_full())
def test_a_command_line_is_understood(program, name, arguments):
    if name == "up":
        parser = deploy.up._parser("")
    else:
        (command,) = [each for each in PROGRAMS[program] if each.name == name]
        parser = Parser()
        command.add_arguments(parser)
    parsed = parser.parse_args(arguments)
    if name in ("up", "trial") and parsed.config is None:
        config_from(parsed)


def test_a_command_that_is_mentioned_exists():
    unknown = [
        f"{page.name}: {found[0]}"
        for page in PAGES
        for found in re.finditer(MODULE, page.read_text())
        if found[2] not in [command.name for command in PROGRAMS[found[1]]]
    ]
    assert unknown == []


def test_the_page_of_settings_shows_those_that_there_are():
    page = (ROOT / "docs" / PAGE).read_text()
    up_to_date = page == with_tables(page)
    assert up_to_date, (
        f"docs/{PAGE} is out of date: `python -m experiments settings` writes it anew"
    )


def test_a_file_of_settings_that_a_page_shows_is_one(tmp_path):
    shown = tmp_path / "shown.toml"
    (block,) = re.findall(r"^```toml\n(.*?)^```", (ROOT / "docs" / PAGE).read_text(), re.S | re.M)
    shown.write_text(block)
    assert load_config(shown) != RunConfig()


def test_a_page_without_a_place_for_the_tables_is_refused():
    with pytest.raises(ConfigError, match="tables: begin"):
        with_tables("# Settings\n")
