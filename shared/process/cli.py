"""The command line of every entry point: the same flags, one-line errors, the same exit codes."""

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
from functools import partial
from typing import Any, NoReturn

from shared.bus.base import CLOSING
from shared.commands import wbc
from shared.config.quantities import parse_duration_ns, parse_seconds
from shared.config.setting import Setting
from shared.config.settings import SETTINGS, RunConfig
from shared.errors import ConfigError, UserError, did_you_mean
from shared.extensions import Names
from shared.process.entry import EXIT_ERROR, EXIT_INTERRUPTED, end_at_interrupt

EXIT_STANDING = 0
EXIT_FELL = 3
_FLAGGED = {key: each for key, each in SETTINGS.items() if each.flag}
_VIEW = "view"
_ASKS_FOR_HELP = {"-h", "--help"}
_INVALID_CHOICE = re.compile(r"invalid choice: '(.*)' \(choose from (.*)\)")
_UNRECOGNIZED = re.compile(r"unrecognized arguments: (--[^ =]+)")
_OUTPUT_ERRORS = (errno.ENOSPC, errno.EIO, errno.EBADF)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, with the option or command that was meant."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: error: {self._explained(message)} (try --help)", file=sys.stderr)
        raise SystemExit(EXIT_ERROR)

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
    parser = command_parser(description, commands, group=group, version=version, typed=sys.argv[1:])
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
    for command in commands:
        subparser = subparsers.add_parser(command.name, help=command.help, description=command.help)
        subparser.set_defaults(parser=subparser)
        if typed is not None and typed[:1] != [command.name]:
            continue
        if isinstance(command, Group):
            _add_commands(subparser, command.commands, None if typed is None else typed[1:])
        else:
            command.add_arguments(subparser)
            subparser.set_defaults(run_command=command.run)


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe a run. Each overrides the configuration file."""
    group = parser.add_argument_group("the run (flags override --config)")
    group.add_argument("--config", metavar="FILE.toml", help="settings; see docs/configuration.md")
    walk = parser.add_argument_group("the walk (with --task walk or go)")
    for key, each in _FLAGGED.items():
        if key != _VIEW:
            _add_flag(walk if key.startswith("walk.") else group, each)
    walk.add_argument(
        "--on-board-delay",
        metavar="25ms",
        help="time from a state to its full QP's solution on board (Table III: the link's delay)",
    )


def add_view_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option for the live view."""
    _add_flag(parser, SETTINGS[_VIEW])


def _add_flag(group: argparse._ActionsContainer, setting: Setting) -> None:
    text = setting.help + (f" [{setting.unit}]" if setting.unit else "")
    if isinstance(setting.choices, Names):
        # To find the names of installed packages takes long.
        names = setting.choices.names() if _ASKS_FOR_HELP & set(sys.argv) else setting.choices.own
        text += f"; one of {', '.join(names)}, {setting.choices.forms}"
    elif setting.words:
        text += f"; one of {', '.join(setting.words)}"
    options: dict[str, Any] = {"help": text.replace("%", "%%")}
    if setting.kind is bool:
        options |= {"action": argparse.BooleanOptionalAction}
    elif setting.kind is tuple:
        options["help"] += "; repeatable; or none"
        options |= {"action": "append", "metavar": setting.metavar}
    else:
        options |= {"type": _reader(setting), "metavar": setting.metavar}
    group.add_argument(*setting.flags, **options)


def _reader(setting: Setting) -> Callable[[str], Any]:
    """Return the function that makes the setting's value from its text on the command line."""
    if isinstance(setting.choices, Names):
        return partial(_extension, setting.choices)
    if setting.words:
        return str.lower  # all words of the settings are in lower case
    seconds = setting.kind is float and setting.unit == "s"
    read = setting.read or (parse_seconds if seconds else None)
    if read is None:
        return setting.kind

    def value(text: str) -> Any:
        try:
            return read(text)
        except ConfigError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return value


def _extension(choices: Names, text: str) -> str:
    return text.lower() if text.lower() in choices.own else text


def _given(arguments: argparse.Namespace, key: str, setting: Setting) -> Any:
    """Return the value of a setting on the command line; None if its flag is not given."""
    value = getattr(arguments, setting.flag.removeprefix("--").replace("-", "_"), None)
    if setting.kind is not tuple or value is None or "none" not in value:
        return value
    if len(value) > 1:
        raise ConfigError(f"{key}: expected none by itself, got {' and '.join(value)}")
    return []


def config_from(arguments: argparse.Namespace) -> RunConfig:
    """Return the settings of the run that the arguments describe."""
    from shared.config.config_file import load_config

    given = {key: _given(arguments, key, each) for key, each in _FLAGGED.items()}
    overrides = {key: value for key, value in given.items() if value is not None}
    delay = getattr(arguments, "on_board_delay", None)
    if delay is not None:
        overrides["switch.compute_ns"] = parse_duration_ns(delay)
        overrides["switch.compute_time_scale"] = 1.0
    config = load_config(arguments.config, overrides)
    walking = [key for key in overrides if key.startswith(("walk.", "switch."))]
    if walking and not config.walks:
        raise ConfigError(f"{walking[0]}: only a walk has this setting; add --task walk")
    if "walk.goal" in overrides and config.task != "go":
        raise ConfigError("walk.goal: only the task go has a goal; add --task go")
    return config


def run(main: Callable[[], int]) -> NoReturn:
    """Exit with the code that `main` returns; print a user's mistake as one line."""
    before = signal.getsignal(signal.SIGINT)
    # Before and after `main`, an interrupt ends the process silently: see `shared.process.entry`.
    silent = before not in (signal.SIG_IGN, signal.SIG_DFL, signal.default_int_handler)
    try:
        if silent:
            signal.signal(signal.SIGINT, signal.default_int_handler)
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
        # A command makes user errors of those that it expects. The rest is of the machine.
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
    if any(thread.name == CLOSING for thread in threading.enumerate()):
        # Python would wait for this thread, or abort in it.
        _flush_output()
        os._exit(code)
    if silent:
        end_at_interrupt(code)
    raise SystemExit(code)


def _flush_output() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()


def _give_up_output() -> None:
    """Discard the rest of standard output's buffer."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
