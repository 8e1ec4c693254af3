"""Comparison of this checkout with another commit of the project, as ratios measured in one run.

The other commit is checked out into a temporary folder. A separate process in this environment
plays it. The two commits take turns, trial by trial, so that other work of the machine affects both
alike.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from benchmarks import in_loop
from benchmarks.start_up import start_up_ns
from benchmarks.timing import Ratio, header
from shared.commands import CHECKOUT
from shared.errors import UserError
from shared.output.text_table import aligned
from shared.process.entry import end_with_parent, python

TRIALS = (("balance", "pr"), ("balance", "la"), ("balance", "lc"), ("walk", "la"))
# Played whole, without a stopwatch; that takes longer, so less often.
WHOLE_TRIAL = ("walk", "la")
WHOLE_ROUNDS = 3
_TICK = ("measure", "receive", "command", in_loop.RECORD, in_loop.WHOLE, in_loop.EDGE)

# Durations by their names [ns].
Durations = dict[str, np.ndarray]


class _Side:
    """A checkout, with the process that plays its trials."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        script = Path(in_loop.__file__)
        command = [*python(str(script)), str(folder)]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=end_with_parent(),
        )

    def play(self, task: str, controller: str, *, seconds: float | None) -> Durations:
        """Play a trial of `seconds` with a stopwatch in it, or a whole one if `seconds` is None."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        asked = {"task": task, "controller": controller, "seconds": seconds}
        try:
            self.process.stdin.write(json.dumps(asked) + "\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        if not answer:
            raise UserError(f"{self.folder}: cannot play {task} with {controller}; see above")
        return {name: np.array(durations) for name, durations in json.loads(answer).items()}


def run(commit: str, *, rounds: int, seconds: float) -> str:
    """Measure, and return the table as text. Raise `UserError` if there is no such commit."""
    top = header()
    with ExitStack() as stack:
        identity, folder = stack.enter_context(_checked_out(commit))
        assert CHECKOUT is not None
        sides = [stack.enter_context(_side(each)) for each in (CHECKOUT, folder)]
        lines = [["this / other", "p50", "least–most", "p99"]]
        for task, controller in TRIALS:
            lines += _trial_lines(sides, task, controller, rounds=rounds, seconds=seconds)
        task, controller = WHOLE_TRIAL
        ours, others = _alternating(
            sides, lambda side: side.play(task, controller, seconds=None), WHOLE_ROUNDS
        )
        # A larger number is faster, so the ratio is inverted.
        name = f"{task} {controller.upper()}, whole trials a minute"
        lines.append([*_line(name, others["trial"], ours["trial"])[:-1], ""])
        ours, others = _alternating(
            sides,
            lambda side: {"cpu": np.array([start_up_ns("robot_node.__main__", side.folder)])},
            rounds,
        )
        lines.append([*_line("start of robot_node", ours["cpu"], others["cpu"])[:-1], ""])
    return "\n".join(
        [
            f"{top}; other: {identity}",
            f"{rounds} rounds of {seconds:g} s over {in_loop.NETWORK}, whole trials in "
            f"{WHOLE_ROUNDS}; processor time; p50: median of the rounds, p99: of all",
            "",
            *aligned(lines, left=1),
        ]
    )


@contextmanager
def _side(folder: Path) -> Iterator[_Side]:
    side = _Side(folder)
    with side.process:
        try:
            yield side
        finally:
            side.process.kill()


@contextmanager
def _checked_out(commit: str) -> Iterator[tuple[str, Path]]:
    """A commit's identity, and a temporary folder with it."""
    if CHECKOUT is None:
        raise UserError("--against: expected a checkout of the project, got an installed package")
    identity = _git("rev-parse", "--short", "--verify", "--end-of-options", f"{commit}^{{commit}}")
    with tempfile.TemporaryDirectory(prefix="benchmark-") as name:
        folder = Path(name).resolve() / "other"
        _git("worktree", "add", "--detach", str(folder), identity)
        try:
            yield identity, folder
        finally:
            _git("worktree", "remove", "--force", str(folder))


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(CHECKOUT), *arguments], capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        raise UserError("--against: expected git, found none") from None
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or ["nothing said"]
        raise UserError(f"--against: git {arguments[0]}: {said[-1]}")
    return done.stdout.strip()


def _alternating(
    sides: list[_Side], take: Callable[[_Side], Durations], rounds: int
) -> list[dict[str, list[np.ndarray]]]:
    """Call `take` for the sides in turn. Return per side and name the batches of all rounds."""
    taken: list[dict[str, list[np.ndarray]]] = [{} for _ in sides]
    for _ in range(rounds):
        for side, batches in zip(sides, taken, strict=True):
            for name, durations in take(side).items():
                batches.setdefault(name, []).append(durations)
    return taken


def _trial_lines(
    sides: list[_Side], task: str, controller: str, *, rounds: int, seconds: float
) -> list[list[str]]:
    ours, others = _alternating(
        sides, lambda side: side.play(task, controller, seconds=seconds), rounds
    )
    return [
        _line(f"{task} {controller.upper()}, {name}", ours[name], others[name])
        for name in _TICK
        # LC receives few messages.
        if np.median(np.concatenate(others[name])) > 0
    ]


def _line(name: str, ours: list[np.ndarray], others: list[np.ndarray]) -> list[str]:
    ratio = Ratio.of(ours, others)
    return [name, f"{ratio.p50:.2f}", f"{ratio.least:.2f}–{ratio.most:.2f}", f"{ratio.p99:.2f}"]
