"""The command `wbc`: one for everything, typed as it says itself."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from remote_wbc import __version__, commands
from shared.process.cli import Group, command_parser
from shared.process.entry import python
from tests.processes import ROOT, Typed

EVERY = [
    f"{prefix}{command.name}"
    for prefix, of_prefix in [
        ("", [each for each in commands() if not isinstance(each, Group)]),
        *((f"{each.name} ", each.commands) for each in commands() if isinstance(each, Group)),
    ]
    for command in of_prefix
]
SHORT_FORMS = {
    "./deploy/ps": "ps",
    "./deploy/logs": "logs",
    "./deploy/restart": "restart",
    "./deploy/down": "down",
    "./deploy/python -m experiments new": "new",
    "./deploy/python -m deploy ps": "ps",
    "./deploy/python -m netem stats": "netem stats",
    "./deploy/python -m viewer open": "viewer open",
    "./deploy/python -m benchmarks core": "bench core",
}


def ran(typed: str, *, cwd: Path = ROOT, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", "-c", typed],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=300.0,
    )


@pytest.fixture(scope="module")
def bash_completion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The completion script for bash."""
    path = tmp_path_factory.mktemp("completion") / "wbc.bash"
    path.write_text(ran("./wbc completion bash").stdout)
    return path


def usage_of(output: str) -> str:
    """The first line of help, up to the options."""
    found = re.match(r"usage: (.*?)(?= \[-h\]| IN )", output)
    assert found is not None, output
    return found[1]


def test_it_says_its_version() -> None:
    assert ran("./wbc --version").stdout == f"wbc {__version__}\n"


@pytest.mark.parametrize("command", EVERY)
def test_a_usage_line_works_as_it_is_printed(typed: Typed, command: str) -> None:
    shown = typed(*command.split(), "--help")
    assert shown.returncode == 0, shown.stderr
    assert usage_of(shown.stdout) == f"./wbc {command}"


@pytest.mark.parametrize(("form", "command"), SHORT_FORMS.items())
def test_scripts_and_modules_are_short_forms_of_it(form: str, command: str) -> None:
    shown = ran(f"{form} --help")
    assert usage_of(shown.stdout) == f"./wbc {command}"


def test_it_is_typed_as_it_can_be_from_where_one_is(tmp_path: Path) -> None:
    assert usage_of(ran(f"{ROOT}/wbc ps --help", cwd=tmp_path).stdout) == f"{ROOT}/wbc ps"
    path = f"{ROOT}/.venv/bin:{os.environ['PATH']}"
    assert usage_of(ran("wbc ps --help", cwd=tmp_path, PATH=path).stdout) == "wbc ps"
    assert usage_of(ran("../wbc ps --help", cwd=ROOT / "docs").stdout) == f"{ROOT}/wbc ps"


@pytest.mark.parametrize(
    ("words", "command"),
    [
        ("trial --colour red", "trial"),
        ("--colour trial", "trial"),
        ("netem show", "netem show"),
        ("netem", "netem"),
        ("no-such", ""),
        ("", ""),
    ],
)
def test_a_mistake_is_one_line_of_the_command_it_is_in(
    typed: Typed, words: str, command: str
) -> None:
    refused = typed(*words.split())
    assert refused.returncode == 2
    assert refused.stdout == ""
    (line,) = refused.stderr.splitlines()
    assert line.startswith(f"./wbc {command}".rstrip() + ": error: ")
    assert line.endswith("(try --help)")


def _described(parser: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, object]]:
    """Yield each argument of a command and of its subcommands, with its help."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, of_word in action.choices.items():
                yield from _described(of_word, f"{name} {word}")
        else:
            yield f"{name} {'/'.join(action.option_strings) or action.dest}", action.help


def test_every_argument_of_every_command_has_a_help() -> None:
    described = dict(_described(command_parser(None, commands(), version=__version__), "wbc"))
    assert described["wbc netem show network"]
    assert [name for name, told in described.items() if not told] == []


def test_a_look_at_what_runs_loads_no_mathematics() -> None:
    code = (
        "import sys; sys.argv = ['wbc', 'ps', '--help']\n"
        "import remote_wbc\n"
        "try:\n"
        "    remote_wbc.main()\n"
        "except SystemExit:\n"
        "    print({'numpy', 'pinocchio', 'zenoh'} & sys.modules.keys(), file=sys.stderr)\n"
    )
    done = subprocess.run(python("-c", code), capture_output=True, text=True, check=False)
    assert done.stderr == "set()\n"


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_is_a_script_of_the_shell_without_a_fault(typed: Typed, shell: str) -> None:
    script = typed("completion", shell).stdout
    assert "viewer" in script
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    checked = subprocess.run([shell, "-n"], input=script, capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("wbc tr", {"trial"}),
        ("wbc netem conv", {"convert"}),
        ("wbc trial --contr", {"--controller"}),
        ("wbc viewer snapshot --an", {"--animation"}),
    ],
)
def test_bash_completes_commands_and_options(
    bash_completion: Path, line: str, offered: set[str]
) -> None:
    words = " ".join(f"'{word}'" for word in line.split())
    script = (
        f'eval "$(cat {bash_completion})"\n'
        f"COMP_WORDS=({words}); COMP_CWORD={len(line.split()) - 1}\n"
        "$(complete -p wbc | sed 's/.*-F \\([^ ]*\\).*/\\1/') wbc\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    completed = ran(script)
    assert {each.strip() for each in completed.stdout.split()} == offered, completed.stderr
