"""The commands for stacks in the background: `ps`, `logs`, `restart` and `down`.

They act on the stacks that `up -d` started from this copy of the project. With `--run` they act on
the stack of any run's folder, also if its `up` runs in another terminal.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from deploy.background.control_client import request_restart
from deploy.background.registry import Registry
from deploy.background.state import (
    ENDED,
    StackFolder,
    StackState,
    exit_in_words,
)
from deploy.console.terminal import Terminal, service_line
from deploy.process_stat import process_started
from deploy.services import load_services
from shared.bus.security import robot_name
from shared.commands import wbc
from shared.errors import ConfigError, LinkError, one_of
from shared.process.cli import EXIT_STANDING
from shared.process.entry import EXIT_ERROR, EXIT_INTERRUPTED

_POLL_SECONDS = 0.1
# Added to the time that the services themselves may take to start or to end.
_PATIENCE_SECONDS = 120.0

Found = list[tuple[StackFolder, StackState]]


def _add_stack_arguments(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--name", type=robot_name, help="only the stack of the robot with this name")
    which.add_argument("--run", metavar="DIR", type=Path, help="the stack of this run's folder")


def add_ps_arguments(parser: argparse.ArgumentParser) -> None:
    _add_stack_arguments(parser)
    parser.add_argument(
        "--format",
        choices=("text", "json"),
        default="text",
        help="json: a list of the stacks, each with its run folder and an `alive` flag",
    )


def add_down_arguments(parser: argparse.ArgumentParser) -> None:
    _add_stack_arguments(parser)


def add_logs_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-f", "--follow", action="store_true", help="print new lines until the stack ends"
    )
    parser.add_argument(
        "service", nargs="?", metavar="SERVICE", help="print only the output of this service"
    )
    _add_stack_arguments(parser)


def add_restart_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("service", metavar="SERVICE", help="the service to restart")
    _add_stack_arguments(parser)


def _stacks(arguments: argparse.Namespace) -> Found:
    """Return the stacks that the arguments select: all running ones, or else the one that ended
    last.
    """
    if arguments.run is not None:
        stack = StackFolder(arguments.run)
        return [(stack, stack.read())]
    return Registry().current(robot=arguments.name)


def _one_with(service: str | None, arguments: argparse.Namespace) -> tuple[StackFolder, StackState]:
    """Return the stack that the arguments select.

    Raise `ConfigError` if there is none, or if there are several.
    """
    found = _stacks(arguments)
    if not found:
        raise ConfigError(f"no stack was started in the background; {wbc('up -d')} starts one")
    declared = load_services()
    if service is not None and service not in declared:
        raise ConfigError(f"service: {one_of(declared, service)}")
    having = [each for each in found if service is None or service in each[1].named]
    if not having:
        named = dict.fromkeys(name for _, state in found for name in state.named)
        raise ConfigError(f"service: {one_of(named, service)}")
    if len(having) > 1:
        runs = ", ".join(str(stack.run) for stack, _ in having)
        raise ConfigError(f"several stacks run: {runs}; select one with --name or --run")
    return having[0]


def _ended(stack: StackFolder, state: StackState) -> StackState:
    """Return the state of a stack; if it was killed as a whole, write its run's summary first."""
    if stack.alive or state.state == ENDED:
        return state
    # Imported here: only the end of a run needs them.
    from deploy.outcome import is_running, summarise
    from shared.config.config_file import load_config
    from shared.output.summary import summary_in_words

    if is_running(stack.run):
        return state
    outcome = "its supervisor was killed"
    result = None
    # The folder may lack its settings by now.
    with contextlib.suppress(ConfigError):
        result = summarise(stack.run, load_config(stack.run / "config.toml"), print)
    if result is not None:
        words = summary_in_words(result)
        print(words)
        outcome += f"; {words.splitlines()[0]}"
    state = dataclasses.replace(
        state, state=ENDED, since=time.time(), outcome=outcome, exit_code=EXIT_ERROR
    )
    stack.write(state)
    return state


def run_ps(arguments: argparse.Namespace) -> int:
    """Print every stack that runs and its services; if none runs, how the last one ended."""
    found = [(stack, _ended(stack, state)) for stack, state in _stacks(arguments)]
    if arguments.format == "json":
        stacks = [
            {"run": str(stack.run), "alive": stack.alive, **dataclasses.asdict(state)}
            for stack, state in found
        ]
        print(json.dumps(stacks, indent=2))
        return EXIT_STANDING
    if not any(stack.alive for stack, _ in found):
        print("nothing is running")
    for stack, state in found:
        print(*_in_words(stack, state, alive=stack.alive, now=time.time()), sep="\n")
    return EXIT_STANDING


def _in_words(stack: StackFolder, state: StackState, *, alive: bool, now: float) -> list[str]:
    """Return the lines that describe a stack, and a table of its services."""
    since = _time_of_day(state.since, now)
    if alive:
        degraded = f" ({', '.join(state.degraded)} degraded)" if state.degraded else ""
        lines = [
            f"{stack.run}: {state.robot}, {state.state}{degraded} since {since}, pid {state.pid}"
        ]
    elif state.state == ENDED:
        lines = [f"{stack.run}: ended {since} (exit {state.exit_code}): {state.outcome}"]
    else:
        lines = [f"{stack.run}: its supervisor was killed; its services end with it"]
    lines.append(f"  {'SERVICE':<8} {'PID':>7}  {'STATE':<18} {'SINCE':<26} RESTARTS")
    started = {service.name: service for service in state.services}
    for name in state.named:
        service = started.get(name)
        if service is None:
            lines.append(f"  {name:<8} {'-':>7}  not started")
            continue
        ended = service.state == ENDED or not alive
        code = service.exit_code
        exited = ENDED if code is None else f"{ENDED} ({exit_in_words(code)})"
        lines.append(
            f"  {name:<8} {'-' if ended else service.pid:>7}  "
            f"{exited if ended else service.state + ', degraded' * service.degraded:<18} "
            f"{_time_of_day(service.since, now):<26} {service.restarts}"
        )
    return lines


def _time_of_day(seconds: float, now: float) -> str:
    ago = max(0, round(now - seconds))
    parts = [(ago // 86400, "d"), (ago // 3600 % 24, "h"), (ago // 60 % 60, "min"), (ago % 60, "s")]
    text = [f"{value} {unit}" for value, unit in parts if value][:2] or ["0 s"]
    return f"{time.strftime('%H:%M:%S', time.localtime(seconds))} ({' '.join(text)} ago)"


def run_logs(arguments: argparse.Namespace) -> int:
    """Print the output of a stack, or of one of its services."""
    # With --follow, a line has to appear at once.
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    stack, _ = _one_with(arguments.service, arguments)
    service = arguments.service
    file = stack.log if service is None else stack.run / f"{service}.log"
    terminal = Terminal()
    for line in _lines(file, stack if arguments.follow else None):
        text = service_line(line) if service is None else (service, line)
        if text is None:
            terminal.tell(line)
        else:
            terminal.say(*text)
    return EXIT_STANDING


def _lines(file: Path, following: StackFolder | None) -> Iterator[str]:
    """Yield the lines of a file; while the stack `following` lives, also lines added later."""
    while following is not None and following.alive and not file.exists():
        time.sleep(_POLL_SECONDS)
    rest = ""
    with contextlib.suppress(FileNotFoundError), file.open(encoding="utf-8") as reader:
        while True:
            # Asked before reading, so that the last lines of a stack are still read.
            alive = following is not None and following.alive
            for chunk in reader:
                rest += chunk
                if rest.endswith("\n"):
                    yield rest.rstrip("\n")
                    rest = ""
            if not alive:
                break
            time.sleep(_POLL_SECONDS)
    if rest:
        yield rest


def run_restart(arguments: argparse.Namespace) -> int:
    """End one service and start it again; return when it is ready."""
    stack, _ = _one_with(arguments.service, arguments)
    if not stack.alive:
        raise ConfigError(f"nothing is running; {wbc('up -d')} starts a stack")
    service = load_services()[arguments.service]
    patience = service.stop_seconds + service.ready_seconds + _PATIENCE_SECONDS
    request_restart(stack, service.name, within_seconds=patience)
    print(f"{service.name} is ready again")
    return EXIT_STANDING


def run_down(arguments: argparse.Namespace) -> int:
    """End every stack. Return 0, or 3 if a robot fell, or 2 if a stack ended by an error."""
    found = _stacks(arguments)
    running = [each for each in found if each[0].alive]
    if not running:
        print("nothing is running")
    for stack, state in running:
        # A robot that has run for an hour takes minutes to write its measurements.
        print(f"{stack.run}: stopping")
        # The number alone could be another process's.
        if state.started not in (None, process_started(state.pid)):
            raise LinkError(
                f"down: {stack.folder / 'lock'} is held, and not by the stack (pid {state.pid}); "
                "end the process that holds it"
            )
        with contextlib.suppress(ProcessLookupError):
            os.kill(state.pid, signal.SIGTERM)
    codes = [EXIT_STANDING]
    for stack, state in found:
        _wait_for_end(stack, state)
        state = _ended(stack, stack.read())
        print(_in_words(stack, state, alive=False, now=time.time())[0])
        if state.state != ENDED:
            codes.append(EXIT_ERROR)
        # An end by this command is no failure.
        elif state.exit_code not in (None, EXIT_INTERRUPTED):
            codes.append(state.exit_code)
    return max(codes)


def _wait_for_end(stack: StackFolder, state: StackState) -> None:
    patience = _PATIENCE_SECONDS + max(each.stop_seconds for each in load_services().values())
    deadline = time.monotonic() + patience
    while stack.alive:
        if time.monotonic() > deadline:
            raise LinkError(
                f"{stack.run} (pid {state.pid}) does not end within {patience:g} s; "
                f"kill -9 {state.pid} ends it with its services"
            )
        time.sleep(_POLL_SECONDS)
