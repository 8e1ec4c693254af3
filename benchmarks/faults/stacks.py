"""Live stacks that a fault happens to, and the truth about them afterwards."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pyarrow as pa

from deploy.background.state import ENDED, READY, StackFolder, StackState
from deploy.outcome import STEMS, SUMMARY
from deploy.process_stat import process_stat
from shared.errors import ConfigError, LinkError
from shared.file_lock import is_locked
from shared.process.entry import python
from shared.telemetry.parquet import read_parquet
from shared.telemetry.row_log import read_rows

# A hang has to end, and a slow machine has to be waited for.
_PATIENCE_SECONDS = 300.0
_POLL_SECONDS = 0.05
_ROOT = Path(__file__).parents[2]
Found = TypeVar("Found")


def until(happened: Callable[[], Found], what: str) -> Found:
    """Return what `happened()` returns as soon as it is true; raise `LinkError` if it never is."""
    deadline = time.monotonic() + _PATIENCE_SECONDS
    while not (found := happened()):
        if time.monotonic() > deadline:
            raise LinkError(f"expected {what} within {_PATIENCE_SECONDS:g} s, got nothing")
        time.sleep(_POLL_SECONDS)
    return found


class Command:
    """A command of the project as a separate process; its output is in a file.

    `prefix` comes before the command line. `limits` are resource limits, each with its number.
    """

    def __init__(
        self,
        output: Path,
        *arguments: str,
        prefix: tuple[str, ...] = (),
        limits: dict[int, int] | None = None,
        user: int | None = None,
    ) -> None:
        def limit() -> None:
            import resource

            for which, number in (limits or {}).items():
                resource.setrlimit(which, (number, number))

        self._name = " ".join(arguments[:4])
        self._output = output
        with output.open("wb") as file:
            self.popen = subprocess.Popen(
                [*prefix, *python("-m", *arguments)],
                cwd=_ROOT,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=limit if limits else None,
                user=user,
                extra_groups=None if user is None else [],
            )

    @property
    def output(self) -> str:
        """Return the output so far."""
        return self._output.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, text: str) -> None:
        """Wait until the process has printed `text`. Raise `LinkError` if it ends before."""

        def said() -> bool:
            over = self.popen.poll() is not None
            if text in self.output:
                return True
            if over:
                last = (self.output.splitlines() or ["no output"])[-1]
                raise LinkError(f"{self._name} ended without {text!r}: {last}")
            return False

        until(said, f"{text!r} from {self._name}")

    def wait(self) -> int:
        """Return the exit code, once the process has ended."""
        until(lambda: self.popen.poll() is not None, f"the end of {self._name}")
        return self.popen.returncode

    def signal(self, number: int) -> None:
        """Send a signal to the process, if it runs."""
        if self.popen.poll() is None:
            os.kill(self.popen.pid, number)

    @property
    def says_errors_in_one_line(self) -> bool:
        """Return whether there is no traceback, and one line for an error at most."""
        lines = self.output.splitlines()
        errors = [line for line in lines if line.startswith("error: ")]
        return "Traceback" not in self.output and len(errors) <= 1

    def end(self) -> None:
        """Kill the process, if it runs, and its group."""
        if self.popen.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.popen.pid, signal.SIGKILL)
        self.popen.wait()


class Stacks:
    """The stacks and commands of one live case, with their files in `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.commands: list[Command] = []

    def start(
        self,
        *arguments: str,
        prefix: tuple[str, ...] = (),
        limits: dict[int, int] | None = None,
        user: int | None = None,
    ) -> Command:
        """Start a command of the project."""
        output = self.folder / f"output.{len(self.commands)}"
        command = Command(output, *arguments, prefix=prefix, limits=limits, user=user)
        self.commands.append(command)
        return command

    def play(self, *arguments: str, user: int | None = None) -> tuple[int, str]:
        """Run a command to its end. Return its exit code and its output."""
        command = self.start(*arguments, user=user)
        return command.wait(), command.output

    def end(self) -> None:
        """Kill the processes that are left."""
        for command in reversed(self.commands):
            command.end()
        for pid in self.left():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def left(self) -> list[int]:
        """Return the processes whose command line names a file of this case."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                if str(self.folder).encode() in path.read_bytes():
                    found.append(int(path.parent.name))
        return found


@contextlib.contextmanager
def stacks(folder: Path) -> Iterator[Stacks]:
    """Open the stacks of a case, and kill their last processes at the end."""
    them = Stacks(folder)
    try:
        yield them
    finally:
        them.end()


def state_of(run: Path) -> StackState | None:
    """Return the state of a run; None if there is none."""
    try:
        return StackFolder(run).read()
    except ConfigError:
        return None


def pid_of(run: Path, service: str) -> int:
    """Return the process of a service, once it is ready."""

    def ready() -> int | None:
        state = state_of(run)
        each = {} if state is None else {service.name: service for service in state.services}
        return each[service].pid if service in each and each[service].state == READY else None

    return until(ready, f"{service} ready") or 0


def lives(pid: int) -> bool:
    """Return whether a process runs. A killed process that its parent has not waited for does not
    count as running.
    """
    try:
        return process_stat(pid)[0] not in "ZX"
    except OSError:
        return False


def rows_in(file: Path) -> int:
    """Return the number of rows that a service has written so far."""
    try:
        return len(read_rows(file)[1])
    except (OSError, ValueError):
        return 0


def agrees_while_running(run: Path) -> bool:
    """Return whether, before long, every service that is said to be ready is a living process."""

    def agrees() -> bool:
        state = state_of(run)
        return (
            state is not None
            and state.state == READY
            and bool(state.services)
            and all(each.state == READY and lives(each.pid) for each in state.services)
        )

    try:
        return until(agrees, "a state that agrees")
    except LinkError:
        return False


def agrees_after(run: Path, *, code: int | None) -> bool:
    """Return whether the state says that the run has ended, with this exit code if it is given."""
    stack, state = StackFolder(run), state_of(run)
    return (
        state is not None
        and not stack.alive
        and state.state == ENDED
        and all(each.state == ENDED or not lives(each.pid) for each in state.services)
        and (code is None or state.exit_code == code)
    )


def is_readable(run: Path) -> bool:
    """Return whether all results of a run can be read."""
    try:
        for file in (*run.glob("*.json"), *run.glob("stack/state")):
            json.loads(file.read_text(encoding="utf-8"))
        for file in run.glob("*.parquet"):
            read_parquet(file)
        for file in run.glob("*.rows"):
            read_rows(file)
    except (OSError, ValueError, pa.ArrowException):
        return False
    return True


def is_clean(them: Stacks, *runs: Path) -> bool:
    """Return whether, before long, no process, lock or socket is left."""

    def nothing_left() -> bool:
        return not them.left() and not any(
            StackFolder(run).alive
            or any(is_locked(run / f"{stem}.rows") for stem in STEMS)
            or (run / "stack/control").is_socket()
            for run in runs
        )

    try:
        return until(nothing_left, "nothing left")
    except LinkError:
        return False


def has_fallen(run: Path) -> bool | None:
    """Return whether the robot fell, as the summary says; None without a summary."""
    try:
        fell: bool | None = json.loads((run / SUMMARY).read_text(encoding="utf-8"))["fell"]
    except (OSError, ValueError, KeyError):
        return None
    return fell
