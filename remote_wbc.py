"""The command `wbc`, and the beginning of every command: `begin(__name__)`, before other imports.

This module is at the top because its name is the project's own: a folder `shared` or `deploy` of
the caller's, or one in PYTHONPATH, may hide ours until `begin` has returned.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    import argparse

    from shared.process.cli import Group, Subcommand

__version__ = "0.1.0"
_DESCRIPTION = (
    "Whole-body control from the edge, over a link that stalls. Each command has a --help; "
    "./deploy/… and python -m … are other ways to say the same."
)


def begin(name: str) -> None:
    """Make this process independent of its caller's environment, if `name` is `__main__`.

    Python starts again in isolated mode (`-I`) if it is not in it: without the current folder,
    PYTHONPATH and other PYTHON… variables, and the user's own packages. Then
    `shared.process.entry.enter`.
    """
    if name != "__main__":
        return
    if not sys.flags.isolated:
        # The first place is the current folder's.
        if os.path.dirname(os.path.abspath(__file__)) not in sys.path[1:]:
            sys.exit(_not_installed())
        # A Ctrl-C that comes while Python starts is kept until it can be answered.
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        os.execv(sys.executable, [sys.executable, "-I", *sys.orig_argv[1:]])
    from shared.process.entry import enter

    enter()


def _not_installed() -> int:
    print(
        f"error: expected a Python that this project is installed in, got {sys.executable}; "
        "./deploy/setup installs it into .venv: use .venv/bin/python",
        file=sys.stderr,
    )
    return 2


def main() -> NoReturn:
    """The command `wbc`."""
    begin("__main__")
    from shared.process.cli import run, run_command

    run(lambda: run_command(_DESCRIPTION, commands(), version=__version__))


def add_completion_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh"))
    parser.description = (
        'Print what completes wbc in a shell: eval "$(wbc completion bash)" in ~/.bashrc, or '
        "wbc completion zsh > _wbc in a folder of $fpath."
    )


def run_completion(arguments: argparse.Namespace) -> int:
    """Print the script; 0."""
    import shtab

    from shared.process.cli import command_parser

    parser = command_parser(_DESCRIPTION, commands(), version=__version__)
    parser.prog = "wbc"
    print(shtab.complete(parser, arguments.shell))
    return 0


def commands() -> list[Subcommand | Group]:
    """Everything that `wbc` can do."""
    from benchmarks.__main__ import COMMANDS as BENCHMARKS
    from deploy.__main__ import COMMANDS as DEPLOY
    from experiments.__main__ import COMMANDS as EXPERIMENTS
    from netem.__main__ import COMMANDS as NETEM
    from shared.process.cli import Group, Subcommand
    from viewer.__main__ import COMMANDS as VIEWER

    return [
        *DEPLOY,
        *EXPERIMENTS,
        Group("netem", "the emulated link: profiles, importers, the shim", NETEM),
        Group("viewer", "watch a run, or runs that are over", VIEWER),
        Group("bench", "speed and exactness on this machine", BENCHMARKS),
        Subcommand("completion", "completion for bash or zsh", "remote_wbc"),
    ]


if __name__ == "__main__":
    main()
