"""Duration of a trial's computations within the trial, call by call.

In a separate loop the same calls take half as long. Here the rest of the trial has displaced them
from the caches, as on a robot. The trials are in lockstep, and the calls are those of their nodes.

`python -I benchmarks/in_loop.py FOLDER` plays trials of another checkout of the project, for
`benchmarks.against`. It prints a line of JSON for each line that it reads. It therefore imports
nothing of the project before the checkout is known, and uses only names that old checkouts have
too.
"""

from __future__ import annotations

import gc
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

NETWORK = "constant:25ms"
WHOLE, RECORD, EDGE = "tick", "record", "edge step"
# Ticks left out of every trial: until then caches and branch predictors are cold.
_WARM_UP = 100
# Calls of a node in a tick, once or more often; `ADVANCE` ends it.
_ADVANCE, _PLANT = "advance", "plant"
_EDGE_RECEIVE, _EDGE_STEP = "edge: receive", "edge: step"
_CONFIG_FILES = ("shared.config.config_file", "shared.config_file")


Clock = Callable[[], int]
# The names of the calls that it was in and its own, and its duration [ns].
Call = tuple[tuple[str, ...], int]


@dataclass(frozen=True)
class Part:
    """A function or method to time: the place `where` a call looks it up, and its name here."""

    where: str
    name: str

    def find(self) -> tuple[Any, str]:
        """Return the owner, a module or a class, and the name in it."""
        module, _, path = self.where.partition(":")
        owner = importlib.import_module(module)
        *classes, name = path.split(".")
        for each in classes:
            owner = getattr(owner, each)
        return owner, name


NODES = (
    Part("robot_node.node:RobotNode.measure", "measure"),
    Part("robot_node.node:RobotNode.receive", "receive"),
    Part("robot_node.node:RobotNode.command", "command"),
    Part("robot_node.node:RobotNode.advance", _ADVANCE),
    Part("robot_node.plant:MujocoPlant.step", _PLANT),
    Part("edge_node.node:EdgeNode.receive", _EDGE_RECEIVE),
    Part("edge_node.node:EdgeNode.step", _EDGE_STEP),
)
# Old checkouts have the row filled from outside.
_OLD_RECORD = Part("robot_node.node:RobotNode.record", RECORD)


class Stopwatch:
    """Every timed call with its duration by a clock, in the order in which the calls ended."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.calls: list[Call] = []
        self._within: tuple[str, ...] = ()

    @contextmanager
    def on(self, parts: Sequence[Part]) -> Iterator[None]:
        """Time `parts` in all objects, until the context ends."""
        with ExitStack() as undo:
            for part in parts:
                owner, name = part.find()
                original = vars(owner)[name]
                undo.callback(setattr, owner, name, original)
                setattr(owner, name, self._timed(original, part.name))
            yield

    def _timed(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        clock = self._clock

        def timed(*args: Any, **kwargs: Any) -> Any:
            before = self._within
            self._within = (*before, name)
            started = clock()
            try:
                return function(*args, **kwargs)
            finally:
                self.calls.append((self._within, clock() - started))
                self._within = before

        return timed


def ticks(calls: Sequence[Call]) -> dict[str, np.ndarray]:
    """Durations per tick [ns], from the calls of `NODES`: measure, receive, command, record and the
    sum, and the edge's steps.

    *Record* covers the end of a tick except the plant's step.
    """
    ended: dict[str, list[int]] = {}
    tick: dict[str, int] = {}
    edge = 0
    for path, duration in calls:
        name = path[-1]
        if name in (_EDGE_RECEIVE, _EDGE_STEP):
            edge += duration
            if name == _EDGE_STEP:
                ended.setdefault(EDGE, []).append(edge)
                edge = 0
            continue
        if path not in ((name,), (_ADVANCE, _PLANT)):
            continue
        tick[name] = tick.get(name, 0) + duration
        if name == _ADVANCE:
            parts = {each: tick.get(each, 0) for each in ("measure", "receive", "command")}
            parts[RECORD] = tick.get(RECORD, 0) + duration - tick.get(_PLANT, 0)
            for each, total in {**parts, WHOLE: sum(parts.values())}.items():
                ended.setdefault(each, []).append(total)
            tick = {}
    return {name: np.array(durations[_WARM_UP:]) for name, durations in ended.items()}


def make_trial(task: str, controller: str, *, seconds: float | None) -> Callable[[], Any]:
    """Build a trial of `seconds`, or to the end of its task if None. Return the function that plays
    it.
    """
    given: dict[str, Any] = {"task": task, "controller": controller, "link.network": NETWORK}
    if seconds is not None:
        given["duration"] = seconds
    config = _load_config()(None, given)
    lockstep = importlib.import_module("experiments.lockstep").Lockstep(
        config, all_active_sets=False
    )
    run: Callable[[], Any] = lockstep.run
    return run


def timed_calls(
    parts: Sequence[Part], task: str, controller: str, *, seconds: float, clock: Clock
) -> list[Call]:
    """Play a trial with a stopwatch in `parts`, and return the calls."""
    stopwatch = Stopwatch(clock)
    run = make_trial(task, controller, seconds=seconds)
    gc.collect()
    gc.disable()
    with stopwatch.on(parts):
        run()
    gc.enable()
    return _without_idle_steps(stopwatch.calls)


def _without_idle_steps(calls: list[Call]) -> list[Call]:
    """Leave out the edge's looks for a state at which none had come."""
    kept, received = [], False
    for path, duration in calls:
        if path == (_EDGE_STEP,) and not received:
            continue
        if path in ((_EDGE_RECEIVE,), (_EDGE_STEP,)):
            received = path == (_EDGE_RECEIVE,)
        kept.append((path, duration))
    return kept


def whole_trial(task: str, controller: str) -> int:
    """Processor time of a whole trial as a sweep plays it, without a stopwatch [ns]."""
    started = time.process_time_ns()
    make_trial(task, controller, seconds=None)()
    return time.process_time_ns() - started


def _load_config() -> Callable[..., Any]:
    for name in _CONFIG_FILES:
        try:
            load_config: Callable[..., Any] = importlib.import_module(name).load_config
        except ModuleNotFoundError:
            continue
        return load_config
    raise ModuleNotFoundError(f"expected one of {', '.join(_CONFIG_FILES)}")


def _answer(asked: Mapping[str, Any]) -> dict[str, list[int]]:
    if asked["seconds"] is None:
        return {"trial": [whole_trial(asked["task"], asked["controller"])]}
    parts = list(NODES)
    owner, name = _OLD_RECORD.find()
    if hasattr(owner, name):
        parts.append(_OLD_RECORD)
    # The load of other processes is not counted.
    calls = timed_calls(parts, **asked, clock=time.thread_time_ns)
    return {name: durations.tolist() for name, durations in ticks(calls).items()}


def _serve(folder: str) -> None:
    checkout = str(Path(__file__).parents[1])
    sys.path[:] = [folder, *(each for each in sys.path if each != checkout)]
    for line in sys.stdin:
        print(json.dumps(_answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    _serve(sys.argv[1])
