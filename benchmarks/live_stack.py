"""A live stack for a benchmark: `./deploy/up` in a process, into a folder of the benchmark."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deploy.background.state import READY, StackFolder, StackState
from shared.errors import ConfigError, LinkError
from shared.process.entry import end_with_parent, python

_START_SECONDS = 120.0
# Writing files, and ending a viewer that does not answer.
_END_SECONDS = 240.0


class LiveStack:
    """A running `./deploy/up`, the process `up`. Its run is in the folder `run`."""

    def __init__(self, up: subprocess.Popen[bytes], run: Path, said: Path) -> None:
        self.up = up
        self.run = run
        self._said = said

    def ready(self) -> StackState:
        """Return the state of the stack once all services are ready.

        Raise `LinkError` if they do not become ready.
        """
        deadline = time.monotonic() + _START_SECONDS
        while time.monotonic() < deadline and ended_within(self.up, 0.1) is None:
            try:
                state = StackFolder(self.run).read()
            except ConfigError:
                continue  # Not there yet.
            if state.state == READY:
                return state
        raise LinkError(f"the stack was not ready in time; it said: {self.last_line()}")

    def last_line(self) -> str:
        """The last line that the stack has printed."""
        lines = self._said.read_text(encoding="utf-8", errors="replace").splitlines()
        return lines[-1] if lines else "nothing"


def ended_within(process: subprocess.Popen[bytes], seconds: float) -> int | None:
    """Return the exit code, or None if a process has not ended within a time."""
    try:
        return process.wait(timeout=seconds)
    except subprocess.TimeoutExpired:
        return None


@contextmanager
def live_stack(folder: Path, *arguments: str) -> Iterator[LiveStack]:
    """Run `./deploy/up` into `folder`/run, with its output in `folder`/said. End it with the
    context.
    """
    folder.mkdir(parents=True, exist_ok=True)
    run, said = folder / "run", folder / "said"
    with said.open("wb") as output:
        up = subprocess.Popen(
            [*python("-m", "deploy", "up", *arguments), "--out", str(run)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            preexec_fn=end_with_parent(),
        )
    try:
        yield LiveStack(up, run, said)
    finally:
        up.terminate()
        if ended_within(up, _END_SECONDS) is None:
            up.kill()
            up.wait()
