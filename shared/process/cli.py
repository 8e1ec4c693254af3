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

from shared.config.controllers import CONTROLLERS
from shared.config.quantities import parse_angle, parse_duration_ns
from shared.config.settings import COM_PLANS, TASKS, VIEWS, RunConfig
from shared.errors import ConfigError, UserError
from shared.process.entry import EXIT_ERROR, EXIT_INTERRUPTED, end_at_interrupt

EXIT_STANDING = 0
EXIT_FELL = 3
_OUTPUT_ERRORS = (errno.ENOSPC, errno.EIO, errno.EBADF)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: error: {message} (try --help)", file=sys.stderr)
        raise SystemExit(EXIT_ERROR)


@dataclass(frozen=True)
class Command:
    """A subcommand: its name, what it does in a line, its options, and what runs it."""

    name: str
    told: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]


def run_command(prog: str, description: str | None, commands: Sequence[Command]) -> int:
    """Parse the command line of a program of several commands and run the one that it names."""
    parser = Parser(prog=prog, description=description)
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in commands:
        subparser = subparsers.add_parser(command.name, help=command.told)
        command.add_arguments(subparser)
        subparser.set_defaults(run_command=command.run)
    arguments = parser.parse_args()
    code: int = arguments.run_command(arguments)
    return code


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that describe a run; each overrides the configuration file."""
    # Imported here: a look at a stack that runs should not wait for numpy.
    from shared.robots import CATALOGUE

    group = parser.add_argument_group("the run (flags override --config)")
    group.add_argument("--config", metavar="FILE.toml", help="settings; see docs/configuration.md")
    group.add_argument("--task", help=f"one of {', '.join(TASKS)}")
    group.add_argument("--robot", help=f"one of {', '.join(CATALOGUE)}")
    group.add_argument("--controller", help=f"one of {', '.join(CONTROLLERS)}")
    group.add_argument(
        "--network",
        help="a shipped profile (factory/003), a .npz or .csv file, constant:ROUND_TRIP "
        "(constant:30ms), constant:UP/DOWN, generated:factory/SEED; capacity: before any of them "
        "replays the link behind it; or direct",
    )
    group.add_argument("--duration", type=float, help="seconds of simulated time")
    group.add_argument("--seed", type=int, help="of noise, loss and the profile's starting point")
    group.add_argument(
        "--push",
        action="append",
        metavar="100N@1.0s:0.2s:+y",
        help="force on the base, start, duration, direction; repeatable; none for no push",
    )
    group.add_argument("--noise", type=float, help="standard deviation of joint positions [rad]")
    group.add_argument("--loss", type=float, help="probability of losing a message, each way")
    group.add_argument(
        "--outage",
        action="append",
        metavar="389ms@1.2s",
        help="nothing passes the link for so long from then on; cut@4s: for ever; repeatable",
    )
    walk = parser.add_argument_group("the walk (with --task walk)")
    walk.add_argument("--steps", type=int, help="how many; the last brings the feet together")
    walk.add_argument("--step-length", type=float, help="[m], negative: backward")
    walk.add_argument("--step-sideways", type=float, help="[m] per step, positive: to the left")
    walk.add_argument("--step-turn", help="per step, 15deg or 0.26rad, positive: to the left")
    walk.add_argument("--step-width", type=float, help="[m] between the soles; 0: as standing")
    walk.add_argument("--step-duration", type=float, help="[s]")
    walk.add_argument("--double-support", type=float, help="[s] of a step on both feet")
    walk.add_argument("--swing-height", type=float, help="[m]")
    walk.add_argument("--com-plan", help=f"one of {', '.join(COM_PLANS)}")
    walk.add_argument(
        "--on-board-delay",
        metavar="25ms",
        help="a full QP on board is ready that long after its state (Table III: as the link's)",
    )


def add_view_argument(parser: argparse.ArgumentParser) -> None:
    """The choice of a live view."""
    parser.add_argument("--view", help=f"one of {', '.join(VIEWS)} (default auto)")


_KEYS = {
    "task": "task",
    "robot": "robot.name",
    "controller": "controller",
    "duration": "duration",
    "seed": "seed",
    "view": "view",
    "network": "link.network",
    "loss": "link.loss",
    "noise": "sensors.joint_position_noise",
    "outage": "link.outage",
}
_WALK_KEYS = {
    name: f"walk.{name}"
    for name in (
        "steps",
        "step_length",
        "step_sideways",
        "step_turn",
        "step_width",
        "step_duration",
        "double_support",
        "swing_height",
        "com_plan",
    )
}


def config_from(arguments: argparse.Namespace) -> RunConfig:
    """The run that the arguments describe."""
    from shared.config.config_file import load_config

    overrides: dict[str, Any] = {}
    for name, key in (_KEYS | _WALK_KEYS).items():
        value = getattr(arguments, name, None)
        if value is not None:
            overrides[key] = parse_angle(value) if name == "step_turn" else value
    delay = getattr(arguments, "on_board_delay", None)
    if delay is not None:
        overrides["switch.compute_ns"] = parse_duration_ns(delay)
        overrides["switch.compute_time_scale"] = 1.0
    pushes = getattr(arguments, "push", None)
    if pushes is not None:
        if "none" in pushes and len(pushes) > 1:
            raise ConfigError(f"push: expected either none or pushes, got {' and '.join(pushes)}")
        overrides["push"] = [] if pushes == ["none"] else pushes
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
