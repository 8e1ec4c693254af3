"""The command `wbc`, and the start of every command: `begin(__name__)` before other imports.

This module is at the top level because no other program uses its name. A folder `shared` or
`deploy` in the caller's folder or in PYTHONPATH may hide the project's until `begin` has returned.
"""

from __future__ import annotations

import contextlib
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
    "./deploy/… and python -m … are other forms of the same commands."
)


# Commands to a running stack, which may fill all cores at real-time priority.
_AT_ONCE = {"push", "link", "go", "drive", "controller"}
_AT_ONCE |= {"pause", "step", "speed", "resume", "reset"}


def _hurry() -> None:
    """Ask for the lowest real-time priority, below that of every service, for a short command."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def begin(name: str) -> None:
    """Make this process independent of its caller's environment, if `name` is `__main__`.

    If Python is not in isolated mode (`-I`), it starts again in it: without the current folder,
    PYTHONPATH and other PYTHON… variables, and the user's own packages. Then this calls
    `shared.process.entry.enter`.
    """
    if name != "__main__":
        return
    # A Ctrl-C is held back until `enter` handles it, also while Python starts again.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    if not sys.flags.isolated:
        # The first entry of sys.path is the current folder.
        if os.path.dirname(os.path.abspath(__file__)) not in sys.path[1:]:
            sys.exit(_not_installed())
        os.execv(sys.executable, [sys.executable, "-I", *sys.orig_argv[1:]])
    from shared.process.entry import enter

    enter()


def _not_installed() -> int:
    print(
        f"error: expected a Python in which this project is installed, got {sys.executable}; "
        "run ./deploy/setup and use .venv/bin/python",
        file=sys.stderr,
    )
    return 2


def main() -> NoReturn:
    """Run the command `wbc`."""
    if sys.argv[1:2] and sys.argv[1] in _AT_ONCE:
        _hurry()
    begin("__main__")
    from shared.process.cli import run, run_command

    run(lambda: run_command(_DESCRIPTION, commands(), version=__version__))


def add_completion_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh"), help="the shell")
    parser.description = (
        'Print a completion script: eval "$(wbc completion bash)" in ~/.bashrc, or wbc completion '
        "zsh > _wbc in a folder of $fpath."
    )


def run_completion(arguments: argparse.Namespace) -> int:
    """Print the completion script. Return 0."""
    import shtab

    from shared.process.cli import command_parser

    parser = command_parser(_DESCRIPTION, commands(), version=__version__)
    parser.prog = "wbc"
    print(shtab.complete(parser, arguments.shell))
    return 0


def add_link_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of both commands named `link`; the next word decides which one runs."""
    from deploy.operate import add_link_arguments as add_change_arguments
    from deploy.operate import add_stack_arguments
    from shared.wire.operator.texts import LINK_WORDS

    if sys.argv[1:2] == ["link"] and sys.argv[2:3] and sys.argv[2] in LINK_WORDS:
        # The study takes long to import.
        add_change_arguments(parser)
        return
    # A study is no short command.
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    from experiments.link import add_link_arguments as add_study_arguments

    parser.description = (
        f"Try each controller over the whole link NETWORK. Or change the link of a running stack, "
        f"if NETWORK is one of {', '.join(LINK_WORDS)}: wbc link cut, wbc link delay 80ms, wbc "
        "link loss 10%, wbc link profile factory/011, wbc link outage 300ms. A file of such a name "
        "needs its folder: ./cut."
    )
    add_study_arguments(parser)
    parser.add_argument(
        "value", metavar="VALUE", nargs="?", help="value of a change to a running stack, as in 80ms"
    )
    add_stack_arguments(parser.add_argument_group("a change to a running stack"))


def run_link(arguments: argparse.Namespace) -> int:
    """Change the link of a running stack, or play the study of a link."""
    from deploy.operate import send_link
    from shared.wire.operator.texts import LINK_WORDS

    change = getattr(arguments, "change", None) or arguments.network
    if change in LINK_WORDS:
        return send_link(change, arguments.value, arguments)
    if arguments.value is not None:
        arguments.parser.error(f"unrecognized arguments: {arguments.value}")
    from experiments.link import run_link as run_study

    return run_study(arguments)


def commands() -> list[Subcommand | Group]:
    """Return every command and group of commands of `wbc`."""
    from benchmarks.__main__ import COMMANDS as BENCHMARKS
    from deploy.__main__ import COMMANDS as DEPLOY
    from experiments.__main__ import COMMANDS as EXPERIMENTS
    from experiments.__main__ import PLANT_COMMANDS as PLANT
    from experiments.__main__ import ROBOT_COMMANDS as ROBOT
    from netem.__main__ import COMMANDS as NETEM
    from shared.process.cli import Group, Subcommand
    from viewer.__main__ import COMMANDS as VIEWER

    # The word after `link` decides between the command of `deploy` and that of `experiments`.
    link = Subcommand(
        "link", "change a running stack's link; or try controllers over a whole link", "remote_wbc"
    )
    return [
        *(link if each.name == "link" else each for each in DEPLOY),
        *(each for each in EXPERIMENTS if each.name != "link"),
        Group("plant", "check your own plant", PLANT),
        Group("robot", "check your own robot", ROBOT),
        Group("netem", "the emulated link: profiles, importers, the shim", NETEM),
        Group("viewer", "watch a run, or look at finished runs", VIEWER),
        Group("bench", "benchmarks of speed and accuracy on this machine", BENCHMARKS),
        Subcommand("completion", "completion for bash or zsh", "remote_wbc"),
    ]


if __name__ == "__main__":
    main()
