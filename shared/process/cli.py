"""The command line of every entry point: the same flags, one-line errors, the same exit codes."""

from __future__ import annotations

import argparse
import errno
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from shared.config.quantities import parse_duration_ns
from shared.config.setting import Setting
from shared.config.settings import SETTINGS, RunConfig
from shared.errors import ConfigError, UserError
from shared.process.entry import EXIT_ERROR, EXIT_INTERRUPTED, end_at_interrupt

EXIT_STANDING = 0
EXIT_FELL = 3
_FLAGGED = {key: each for key, each in SETTINGS.items() if each.flag}
_VIEW = "view"
_OUTPUT_ERRORS = (errno.ENOSPC, errno.EIO, errno.EBADF)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: error: {message} (try --help)", file=sys.stderr)
        raise SystemExit(EXIT_ERROR)


@dataclass(frozen=True)
class Subcommand:
    """A subcommand: its name, what it does in a line, its options, and what runs it."""

    name: str
    help: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def run_command(prog: str, description: str | None, commands: Sequence[Subcommand]) -> int:
    """Parse the command line of a program of several commands and run the one that it names."""
    parser = Parser(prog=prog, description=description)
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in commands:
        subparser = subparsers.add_parser(command.name, help=command.help)
        command.add_arguments(subparser)
        subparser.set_defaults(run_command=command.run)
    arguments = parser.parse_args()
    code: int = arguments.run_command(arguments)
    return code


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that describe a run; each overrides the configuration file."""
    group = parser.add_argument_group("the run (flags override --config)")
    group.add_argument("--config", metavar="FILE.toml", help="settings; see docs/configuration.md")
    walk = parser.add_argument_group("the walk (with --task walk)")
    for key, each in _FLAGGED.items():
        if key != _VIEW:
            _add_flag(walk if key.startswith("walk.") else group, each)
    walk.add_argument(
        "--on-board-delay",
        metavar="25ms",
        help="a full QP on board is ready that long after its state (Table III: as the link's)",
    )


def add_view_argument(parser: argparse.ArgumentParser) -> None:
    """The choice of a live view."""
    _add_flag(parser, SETTINGS[_VIEW])


def _add_flag(group: argparse._ActionsContainer, setting: Setting) -> None:
    text = setting.help + (f" [{setting.unit}]" if setting.unit else "")
    if setting.words:
        text += f"; one of {', '.join(setting.words)}"
    options: dict[str, Any] = {"help": text.replace("%", "%%")}
    if setting.kind is bool:
        options |= {"action": argparse.BooleanOptionalAction}
    elif setting.kind is tuple:
        options["help"] += "; repeatable; or none"
        options |= {"action": "append", "metavar": setting.metavar}
    else:
        options |= {"type": setting.read or setting.kind, "metavar": setting.metavar}
    group.add_argument(setting.flag, **options)


def _given(arguments: argparse.Namespace, key: str, setting: Setting) -> Any:
    """The value of a setting on the command line; None where its flag is not given."""
    value = getattr(arguments, setting.flag.removeprefix("--").replace("-", "_"), None)
    if setting.kind is not tuple or value is None or "none" not in value:
        return value
    if len(value) > 1:
        raise ConfigError(f"{key}: expected none by itself, got {' and '.join(value)}")
    return []


def config_from(arguments: argparse.Namespace) -> RunConfig:
    """The run that the arguments describe."""
    from shared.config.config_file import load_config

    given = {key: _given(arguments, key, each) for key, each in _FLAGGED.items()}
    overrides = {key: value for key, value in given.items() if value is not None}
    delay = getattr(arguments, "on_board_delay", None)
    if delay is not None:
        overrides["switch.compute_ns"] = parse_duration_ns(delay)
        overrides["switch.compute_time_scale"] = 1.0
    config = load_config(arguments.config, overrides)
    walking = [key for key in overrides if key.startswith(("walk.", "switch."))]
    if walking and config.task != "walk":
        raise ConfigError(f"{walking[0]}: only a walk has it; add --task walk")
    return config


def run(main: Callable[[], int]) -> NoReturn:
    """Exit with what `main` returns; a user's mistake is one line on standard error."""
    before = signal.getsignal(signal.SIGINT)
    # So far, and after `main`, an interrupt ends the process silently: see `shared.process.entry`.
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
        # Whoever read our output has left; nothing more can be said.
        _give_up_output()
        code = EXIT_ERROR
    except OSError as error:
        # One of a file is the user's mistake in words by now: this is of the output itself.
        if error.filename is not None or error.errno not in _OUTPUT_ERRORS:
            raise
        _give_up_output()
        print(f"error: cannot write to standard output: {error.strerror}", file=sys.stderr)
        code = EXIT_ERROR
    if silent:
        end_at_interrupt(code)
    raise SystemExit(code)


def _give_up_output() -> None:
    """Let what is left in standard output's buffer go nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
