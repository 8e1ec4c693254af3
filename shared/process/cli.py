"""The command line of every entry point: its commands, one-line errors, the same exit codes.

Commands to a running stack have to be quick, so this module imports no settings. The options of a
run are in `shared/process/run_options.py`.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from shared.commands import wbc
from shared.errors import UserError, did_you_mean
from shared.process.entry import (
    EXIT_ERROR,
    EXIT_INTERRUPTED,
    end_at_interrupt,
    nothing_begun,
    raise_at_interrupt,
)

EXIT_STANDING = 0
EXIT_FELL = 3
_INVALID_CHOICE = re.compile(r"invalid choice: '(.*)' \(choose from (.*)\)")
_UNRECOGNIZED = re.compile(r"unrecognized arguments: (--[^ =]+)")
_OUTPUT_ERRORS = (errno.ENOSPC, errno.EIO, errno.EBADF)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, with the option or command that was meant."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: error: {self._explained(message)} (try --help)", file=sys.stderr)
        raise SystemExit(EXIT_ERROR)

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """Exit after a help or a version. Raise `OSError` if it could not be printed."""
        sys.stdout.flush()
        super().exit(status, message)

    def _explained(self, message: str) -> str:
        choice = _INVALID_CHOICE.search(message)
        if choice is not None:
            return message + did_you_mean(re.findall(r"'([^']*)'", choice[2]), choice[1])
        option = _UNRECOGNIZED.match(message)
        if option is not None:
            return message + did_you_mean(self._option_string_actions, option[1])
        return message


@dataclass(frozen=True)
class Subcommand:
    """A subcommand: its name, its help in a line, and the module that runs it.

    The module has `add_NAME_arguments(parser)` and `run_NAME(arguments)`. NAME is `stem`, or the
    command's name without one. The module is imported when the command is used.
    """

    name: str
    help: str
    module: str
    stem: str = ""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's options to a parser."""
        self._function("add_{}_arguments")(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Run the command. Return its exit code."""
        code: int = self._function("run_{}")(arguments)
        return code

    def _function(self, name: str) -> Callable[..., Any]:
        stem = self.stem or self.name.replace("-", "_")
        function: Callable[..., Any] = getattr(
            importlib.import_module(self.module), name.format(stem)
        )
        return function


@dataclass(frozen=True)
class Group:
    """Subcommands under a common name."""

    name: str
    help: str
    commands: Sequence[Subcommand]


def run_command(
    description: str | None,
    commands: Sequence[Subcommand | Group],
    *,
    group: str = "",
    version: str | None = None,
) -> int:
    """Parse the command line of `wbc`, or of a group of it, and run the command that it names."""
    # The import of the command's module takes most of the time.
    with nothing_begun():
        parser = command_parser(
            description, commands, group=group, version=version, typed=sys.argv[1:]
        )
    arguments, unknown = parser.parse_known_args()
    if unknown:
        arguments.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    code: int = arguments.run_command(arguments)
    return code


def command_parser(
    description: str | None,
    commands: Sequence[Subcommand | Group],
    *,
    group: str = "",
    version: str | None = None,
    typed: Sequence[str] | None = None,
) -> Parser:
    """Return the parser of a program with several commands.

    Only the command that is `typed` gets its options; None: all commands get them. The options of a
    command need its module, which takes long to import.
    """
    parser = Parser(prog=wbc(group), description=description)
    if version is not None:
        parser.add_argument("--version", action="version", version=f"wbc {version}")
    _add_commands(parser, commands, typed)
    return parser


def _add_commands(
    parser: argparse.ArgumentParser,
    commands: Sequence[Subcommand | Group],
    typed: Sequence[str] | None,
) -> None:
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    word = None if typed is None else typed[:1]
    # Help and errors name all commands. A parser for each takes longer than most commands.
    for command in [each for each in commands if word == [each.name]] or commands:
        subparser = subparsers.add_parser(command.name, help=command.help, description=command.help)
        subparser.set_defaults(parser=subparser)
        if word is not None and word != [command.name]:
            continue
        if isinstance(command, Group):
            _add_commands(subparser, command.commands, None if typed is None else typed[1:])
        else:
            command.add_arguments(subparser)
            subparser.set_defaults(run_command=command.run)


def run(main: Callable[[], int]) -> NoReturn:
    """Exit with the code that `main` returns; print a user's mistake as one line."""
    before = signal.getsignal(signal.SIGINT)
    # Before and after `main`, an interrupt ends the process silently: see `shared.process.entry`.
    silent = before not in (signal.SIG_IGN, signal.SIG_DFL, signal.default_int_handler)
    try:
        if silent:
            raise_at_interrupt()
        code = main()
        sys.stdout.flush()
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        code = EXIT_ERROR
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader of the output has left, so no message can reach it.
        _give_up_output()
        code = EXIT_ERROR
    except OSError as error:
        # A command turns the errors that it expects into user errors. Other errors come from the
        # machine.
        if error.filename is None and error.errno in _OUTPUT_ERRORS:
            _give_up_output()
            text = f"cannot write to standard output: {error.strerror}"
        else:
            text = f"{error.filename or 'the system refuses'}: {error.strerror or error}"
        print(f"error: {text}", file=sys.stderr)
        code = EXIT_ERROR
    except MemoryError:
        print(
            "error: expected more memory than this process may have; end other programs, raise "
            "ulimit -v, or try less (a shorter run, a smaller file)",
            file=sys.stderr,
        )
        code = EXIT_ERROR
    if threading.active_count() > 1 and _closes_a_bus():
        # Python would wait for this thread, or abort in it.
        _flush_output()
        os._exit(code)
    if silent:
        end_at_interrupt(code)
    raise SystemExit(code)


def _closes_a_bus() -> bool:
    """Return whether a thread still closes a session."""
    from shared.bus.base import CLOSING

    return any(thread.name == CLOSING for thread in threading.enumerate())


def _flush_output() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()


def _give_up_output() -> None:
    """Discard the text in standard output's buffer."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
