"""What the on-board computer is asked to solve, and when its answers are there."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from robot_node.onboard import ModelledComputer, OnBoardRefresh, OnBoardWindow
from shared.config.control_settings import CorrectionConfig, SwitchConfig
from shared.config.settings import RunConfig
from shared.wbc.answer import Projector, TimedProjector
from shared.wbc.contacts import ContactMode

MS = 1_000_000
LEFT, DOUBLE = ContactMode.LEFT_SUPPORT, ContactMode.DOUBLE_SUPPORT


class Switches:
    """A motion that only knows when its contact mode changes."""

    digest = bytes(8)

    def __init__(self, *times_ms):
        self.times = [round(time * MS) for time in times_ms]

    def next_switch(self, time_ns):
        return next((time for time in self.times if time > time_ns), None)

    def reference(self, time_ns):
        raise NotImplementedError


class Solver:
    """Stands for the full controller: answers at once with an empty projector."""

    def __init__(self):
        self.asked_for = []

    def __call__(self, q, v, time_ns):
        self.asked_for.append(time_ns)
        projector = Projector(DOUBLE, np.zeros((1, 1)), np.zeros(0, dtype=int))
        return TimedProjector(projector, time_ns, 2**62)


class Kept(list[Any]):
    """Stands for the cache of projectors: what it was given."""

    keep = list.append


def play(motion, until_ms, **settings):
    """(start [ms], solved for [ms], ready [ms]) of every solve up to a time."""
    config = dataclasses.replace(SwitchConfig(compute_time_scale=1.0), **settings)
    solver = Solver()
    computer = ModelledComputer(solver, ready_after_ns=config.ready_after_ns(config.compute_ns))
    cache: Any = Kept()
    window = OnBoardWindow(config, motion, computer, cache)
    solves: list[tuple[int, float]] = []
    ready: list[tuple[int, int]] = []
    for tick in range(until_ms):
        window.tick(np.zeros(1), np.zeros(1), time_ns=tick * MS, sequence=tick, stamp_ns=tick * MS)
        if len(solver.asked_for) > len(solves):
            solves.append((tick, solver.asked_for[-1] / MS))
        if len(cache) > len(ready):
            entry = cache[-1]
            assert entry.on_board
            assert entry.stamp_ns == entry.sequence * MS
            ready.append((entry.sequence, tick))
    assert len(cache) == len(ready)
    assert window.solves == len(solves)
    return solves, dict(ready)


def preparations(solves):
    return [(start, target) for start, target in solves if target > start]


def test_outside_the_window_nothing_is_solved():
    solves, _ = play(Switches(500), 440)
    assert solves == []


def test_in_the_window_the_present_mode_is_solved_every_period_and_the_coming_one_once():
    solves, _ = play(Switches(200), 300, prepare_ns=10 * MS, compute_ns=2 * MS)
    present = [start for start, target in solves if target == start]
    assert present[0] == 150
    assert present[-1] in range(246, 251)
    assert max(b - a for a, b in itertools.pairwise(present)) <= 10
    assert preparations(solves) == [(190, 200.0)]


@pytest.mark.parametrize("compute_ms", [1, 2.4, 5, 20, 60])
@pytest.mark.parametrize("double_support_ms", [3, 20, 200])
def test_every_switch_is_prepared_in_time_however_slow_the_computer(compute_ms, double_support_ms):
    motion = Switches(400, 400 + double_support_ms, 1200)
    solves, ready = play(motion, 1300, compute_ns=round(compute_ms * MS))
    prepared = preparations(solves)
    assert [target for _, target in prepared] == [400, 400 + double_support_ms, 1200]
    for start, target in prepared:
        assert ready[start] <= target


def test_one_solve_at_a_time():
    solves, ready = play(Switches(300, 320), 500, compute_ns=7 * MS)
    for (start, _), (following, _) in itertools.pairwise(solves):
        assert ready[start] <= following


def test_an_answer_is_ready_the_scaled_compute_time_after_its_state():
    config = SwitchConfig(compute_ns=2 * MS, compute_time_scale=3.0)
    assert config.ready_after_ns(1 * MS) == 6 * MS
    assert config.ready_after_ns(3 * MS) == 9 * MS
    _, ready = play(Switches(300), 400, compute_ns=2 * MS, compute_time_scale=3.0)
    assert {answered - asked for asked, answered in ready.items()} == {6}


@pytest.mark.parametrize("part", ["prepare_on_board", "solve_on_board"])
def test_each_part_can_be_turned_off(part):
    solves, _ = play(Switches(300), 400, **{part: False})
    prepared = preparations(solves)
    assert len(prepared) == (0 if part == "prepare_on_board" else 1)
    assert (len(solves) > len(prepared)) is (part == "prepare_on_board")


def test_without_a_switch_nothing_is_ever_solved():
    assert play(Switches(), 200)[0] == []


class Held(list[Any]):
    """Stands for the cache of factorisations: (sequence, on board) of what it was given."""

    def keep(self, factorisations, *, sequence, stamp_ns, on_board):
        assert factorisations == (LEFT,)
        self.append((sequence, on_board))


def refresh(wanted, *, until_ms=400, budget=0.1):
    config = RunConfig(
        switch=SwitchConfig(compute_ns=2 * MS, compute_time_scale=1.0),
        correction=CorrectionConfig(on_board_budget=budget),
    )
    computer = ModelledComputer(lambda q, v, mode: (ContactMode(mode),), ready_after_ns=2 * MS)
    cache: Any = Held()
    window = OnBoardRefresh(config, computer, cache, lambda: LEFT if wanted(tick) else None)
    for tick in range(until_ms):
        window.tick(np.zeros(1), np.zeros(1), time_ns=tick * MS, sequence=tick, stamp_ns=0)
    return window.solves, cache


def test_the_robot_factorises_itself_only_while_it_would_help():
    assert refresh(lambda tick: False) == (0, [])
    _, cache = refresh(lambda tick: 100 <= tick < 150)
    assert cache
    assert all(100 <= sequence < 150 and on_board for sequence, on_board in cache)


@pytest.mark.parametrize("budget", [0.02, 0.1, 1.0])
def test_factorising_on_board_keeps_within_its_budget_of_time(budget):
    solves, _ = refresh(lambda tick: True, budget=budget)
    assert 0.7 * budget * 400 <= 2 * solves <= budget * 400 + 2
