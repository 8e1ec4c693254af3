"""Commands to a running stack: push the robot, change its link, its controller or its pace.

They go over the stack's control socket, which only this user can reach, and on from there over its
telemetry hub, never over the link under test. The stack answers each with the time at which it
takes effect, and records it in the run's folder. This module imports little, so that a command
reaches the stack at once.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from deploy.background.control_client import StackClient
from deploy.background.registry import running_stacks
from deploy.background.state import StackFolder
from deploy.services import EDGE, NETEM, ROBOT
from shared.commands import wbc
from shared.errors import ConfigError, LinkError
from shared.process.cli import EXIT_STANDING
from shared.wire.operator.commands import Command, EdgeCommand, LinkCommand
from shared.wire.operator.texts import LINK_WORDS, parse_command


def add_push_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("force", metavar="FORCE", help="force, as in 120N")
    way = parser.add_mutually_exclusive_group(required=True)
    way.add_argument(
        "direction",
        metavar="DIRECTION",
        nargs="?",
        help="direction in the world: ±x, ±y, ±z or ±x±y",
    )
    for name in ("-x", "-y", "-z", "-x+y", "-x-y"):
        # Otherwise argparse takes them for options that it does not know.
        way.add_argument(
            name, action="store_const", const=name, dest="direction", help=argparse.SUPPRESS
        )
    parser.add_argument(
        "--for", dest="lasts", metavar="0.2s", default="0.2s", help="duration (default 0.2s)"
    )
    add_stack_arguments(parser)


def run_push(arguments: argparse.Namespace) -> int:
    """Push the robot's base."""
    return _send(f"push {arguments.force} {arguments.direction} --for {arguments.lasts}", arguments)


def add_link_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "change", metavar="CHANGE", help=f"change of the link, one of {', '.join(LINK_WORDS)}"
    )
    parser.add_argument(
        "value", metavar="VALUE", nargs="?", help="value of the change, as in delay 80ms, loss 10%%"
    )
    add_stack_arguments(parser)


def run_link(arguments: argparse.Namespace) -> int:
    """Change the link."""
    return send_link(arguments.change, arguments.value, arguments)


def send_link(change: str, value: str | None, arguments: argparse.Namespace) -> int:
    """Send a change of the link to the stack that the arguments select. Return 0."""
    return _send(f"link {change} {value or ''}", arguments)


def add_controller_arguments(parser: argparse.ArgumentParser) -> None:
    # Imported here: no other command needs the tables of names.
    from shared.config.extensions import CONTROLLERS

    names = ", ".join(CONTROLLERS.own)
    parser.add_argument(
        "controller", metavar="NAME", help=f"controller: one of {names}, or your own"
    )
    add_stack_arguments(parser)


def run_controller(arguments: argparse.Namespace) -> int:
    """Change the robot's controller."""
    return _send(f"controller {arguments.controller}", arguments)


def add_step_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "ticks",
        metavar="TICKS",
        nargs="?",
        default="1",
        help="number as in 10, or time as in 20ms (default 1)",
    )
    add_stack_arguments(parser)


def run_step(arguments: argparse.Namespace) -> int:
    """Let simulated time go on for some ticks, and then stand still."""
    return _send(f"step {arguments.ticks}", arguments)


def add_speed_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("factor", metavar="FACTOR", help="speed, × real time, 0.01 to 1")
    add_stack_arguments(parser)


def run_speed(arguments: argparse.Namespace) -> int:
    """Slow simulated time down, or let it run in real time again."""
    return _send(f"speed {arguments.factor}", arguments)


def add_go_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("x", metavar="X", help="place in the plan's frame, forward [m]")
    parser.add_argument("y", metavar="Y", help="place in the plan's frame, to the left [m]")
    parser.add_argument("yaw", metavar="YAW", help="heading [rad], or as in 90deg")
    add_stack_arguments(parser)


def run_go(arguments: argparse.Namespace) -> int:
    """Let the robot walk to a place."""
    return _send(f"go {arguments.x} {arguments.y} {arguments.yaw}", arguments)


def add_drive_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "velocity",
        metavar="NUMBER",
        nargs="*",
        help="forward, to the left [m/s], turning to the left [rad/s], for a second; without "
        "numbers by keys, or by a gamepad if there is one, until Ctrl-C",
    )
    add_stack_arguments(parser)


def run_drive(arguments: argparse.Namespace) -> int:
    """Drive the robot at a velocity, or by keys."""
    if arguments.velocity:
        return _send(f"drive {' '.join(arguments.velocity)}", arguments)
    from deploy.drive import drive

    drive(_client(parse_command("drive 0 0 0"), arguments))
    return EXIT_STANDING


def add_stack_arguments(parser: argparse._ActionsContainer) -> None:
    """Add the options that select a running stack."""
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--name", help="the stack of the robot with this name")
    which.add_argument("--run", metavar="DIR", type=Path, help="the stack of this run's folder")


add_pause_arguments = add_resume_arguments = add_reset_arguments = add_stack_arguments


def run_pause(arguments: argparse.Namespace) -> int:
    """Let simulated time stand still."""
    return _send("pause", arguments)


def run_resume(arguments: argparse.Namespace) -> int:
    """Let simulated time go on."""
    return _send("resume", arguments)


def run_reset(arguments: argparse.Namespace) -> int:
    """Let the robot stand as at the beginning of its task."""
    return _send("reset", arguments)


def _send(text: str, arguments: argparse.Namespace) -> int:
    """Send a command to the stack that the arguments select, and print its answer. Return 0."""
    command = parse_command(text)
    answer = _client(command, arguments).send(command)
    note = f"; {answer.note}" if answer.note else ""
    print(f"{command}: from {answer.time_ns * 1e-9:.3f} s of the task on{note}")
    return EXIT_STANDING


def _client(command: Command, arguments: argparse.Namespace) -> StackClient:
    """Return a client of the stack that the arguments select for a command."""
    return StackClient(_stack_for(command, run=arguments.run, robot=arguments.name))


def service_of(command: Command) -> str:
    """Return the name of the service that carries a command out."""
    if isinstance(command, LinkCommand):
        return NETEM
    return EDGE if isinstance(command, EdgeCommand) else ROBOT


def _stack_for(command: Command, *, run: Path | None, robot: str | None) -> StackFolder:
    """Return the stack that a command is for; raise `ConfigError` if there is none, or if there are
    several.
    """
    if run is not None:
        folder = StackFolder(run)
        found = [(folder, folder.read())] if folder.alive else []
    else:
        found = running_stacks(robot=robot)
    start = f"start one with {wbc('up')}"
    if not found:
        whose = f" in {run}" if run is not None else f" of {robot}" if robot is not None else ""
        raise ConfigError(f"no stack{whose} runs; {start}")
    service = service_of(command)
    having = [each for each in found if service in each[1].named]
    if not having:
        raise ConfigError(
            f"{command}: expected a stack with {service}, "
            f"got {found[0][0].run} with {', '.join(found[0][1].named)}; {start}"
        )
    if len(having) > 1:
        runs = ", ".join(str(stack.run) for stack, _ in having)
        raise ConfigError(f"several stacks run: {runs}; select one with --name or --run")
    stack = having[0][0]
    if not stack.control.exists():
        raise LinkError(f"{command}: the stack takes no commands yet; try again")
    return stack
